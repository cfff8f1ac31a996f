"""A pool of long-lived workers, one a core, with finished runs kept on disk."""

from __future__ import annotations

import os
import threading
import time
import zipfile
from collections.abc import Callable, Sequence
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path

import numpy as np

from metafab.cell.meep import finding
from metafab.cell.meep.protocol import Job, Reply, Worker
from metafab.core.errors import InputError, SolverError
from metafab.core.parallel.executor import default_workers
from metafab.core.storage.files import file_sha256, fingerprint, whole_file

#: Environment variable with the folder of finished runs; empty keeps none.
FOLDER_VARIABLE = "METAFAB_MEEP_JOBS"


def own_folder() -> Path | None:
    """Folder of this user's finished runs: ``METAFAB_MEEP_JOBS``, or ``metafab/meep`` in the user's cache."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named is not None:
        return Path(named) if named else None
    caches = os.environ.get("XDG_CACHE_HOME")
    return (Path(caches) if caches else Path.home() / ".cache") / "metafab" / "meep"


class KeptReplies:
    """Replies of finished jobs, one .npz file each; any number of processes may share the folder.

    Args:
        folder: folder of the files; made when the first one is kept.
        program: identity of the program that runs the jobs (worker's source, version of Meep).
    """

    def __init__(self, folder: Path, program: str) -> None:
        self._folder = folder
        self._program = program

    def find(self, job: Job) -> Reply | None:
        """Return the reply of an equal finished job, or None. A damaged file counts as none, and is replaced."""
        try:
            with np.load(self._path(job), allow_pickle=False) as content:
                return {name: np.array(content[name]) for name in content.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def keep(self, job: Job, reply: Reply) -> None:
        """Write a reply, whole or not at all."""
        with whole_file(self._path(job)) as part, part.open("wb") as stream:
            np.savez(stream, **reply)  # type: ignore[arg-type]

    def _path(self, job: Job) -> Path:
        return self._folder / f"{fingerprint(self._program, job)[:40]}.npz"


class Pool:
    """Workers that run several jobs at once; a context manager, safe to share between threads.

    Workers start when they are first needed. A worker that failed is replaced for the next job.

    Args:
        workers: processes, one thread each; by default one a core.
        command: the worker's program; by default the first interpreter that has Meep.
        jobs_per_worker: jobs after which a worker is replaced, as Meep does not return all of its memory.
        limit_s: time limit of one job.
        keep: folder of finished jobs, of this process or an earlier one; an equal job is answered from it.
    """

    def __init__(
        self,
        workers: int | None = None,
        *,
        command: Sequence[str] | None = None,
        jobs_per_worker: int = 64,
        limit_s: float = 3600.0,
        keep: Path | None = None,
    ) -> None:
        self.size = default_workers() if workers is None else workers
        if self.size < 1:
            raise InputError.single("meep", "workers", "a whole number from 1", str(self.size))
        self._command = command
        self._jobs_per_worker = jobs_per_worker
        self._limit_s = limit_s
        self._keep = keep
        self._kept: KeptReplies | None = None
        self._slots = threading.BoundedSemaphore(self.size)
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._all: set[Worker] = set()

    def run(self, job: Job, report: Callable[[float], None] | None = None) -> Reply:
        """Run one job on a free worker, waiting for one if need be, unless its reply was kept.

        Args:
            job: the FDTD run.
            report: callback with the simulated time in um / c.

        Returns:
            The worker's arrays, and ``seconds``, the time of the run when it was made.

        Raises:
            SolverError: as :meth:`Worker.run`.
            MissingToolError: no interpreter has Meep.
        """
        with self._slots:
            kept = self._replies()
            if kept is not None and (known := kept.find(job)) is not None:
                return known
            worker = self._take()
            start = time.perf_counter()
            try:
                reply = worker.run(job, limit_s=self._limit_s, report=report)
            finally:
                self._give(worker)
            reply["seconds"] = np.array(time.perf_counter() - start)
            if kept is not None:
                kept.keep(job, reply)
            return reply

    def run_to_decay(self, job: Job, report: Callable[[float], None] | None = None) -> Reply:
        """Run one job whose fields must decay within its longest time; arguments and result as of :meth:`run`.

        Raises:
            SolverError: the fields did not decay, or as :meth:`run`.
            MissingToolError: no interpreter has Meep.
        """
        reply = self.run(job, report)
        if not np.isfinite(reply["tail"]):
            periods = job.longest_time / job.wavelength_um
            raise SolverError(
                f"Meep: the fields had not begun to decay after {periods:g} optical periods; "
                "give more by `longest_periods`"
            )
        return reply

    def close(self) -> None:
        """End all workers. The pool can be used again: it starts new ones."""
        with self._lock:
            workers, self._idle = list(self._all), []
            self._all.clear()
        for worker in workers:
            worker.close()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _replies(self) -> KeptReplies | None:
        if self._keep is None:
            return None
        with self._lock:
            if self._kept is None:
                program = finding.best().version if self._command is None else " ".join(self._command)
                self._kept = KeptReplies(self._keep, f"{program} {file_sha256(finding.WORKER)}")
            return self._kept

    def _take(self) -> Worker:
        with self._lock:
            if self._idle:
                return self._idle.pop()
        worker = Worker(self._command)
        with self._lock:
            self._all.add(worker)
        return worker

    def _give(self, worker: Worker) -> None:
        with self._lock:
            if worker in self._all and worker.alive and worker.jobs_done < self._jobs_per_worker:
                self._idle.append(worker)
                return
            self._all.discard(worker)
        worker.close()


@cache
def own_pool() -> Pool:
    """The one-worker pool of this process for single cells; it ends with the process and keeps its finished runs."""
    pool = Pool(1, keep=own_folder())
    # Unlike atexit, this also runs at the end of a process that multiprocessing started.
    Finalize(None, pool.close, exitpriority=100)
    return pool
