"""A pool of long-lived workers, one a core, with finished runs kept on disk."""

from __future__ import annotations

import os
import threading
import time
import zipfile
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from multiprocessing.util import Finalize
from pathlib import Path

import numpy as np

from metafab.cell.meep import finding
from metafab.cell.meep.protocol import Job, Reply, Worker, load_reply
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
        self._slots = threading.BoundedSemaphore(self.size)
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._all: set[Worker] = set()

    def run(self, job: Job, report: Callable[[float], None] | None = None) -> Reply:
        """Run one job on a free worker, waiting for one if need be, unless its reply was kept.

        ``report`` is called with the simulated time in um / c. Returns the worker's arrays, and ``seconds``, the time
        of the run when it was made. SolverError as :meth:`Worker.run`; MissingToolError if no interpreter has Meep.
        """
        with self._slots:
            kept = self._kept(job)
            if kept is not None and (finished := _finished(kept)) is not None:
                return finished
            worker = self._take()
            start = time.perf_counter()
            try:
                reply = worker.run(job, limit_s=self._limit_s, report=report)
            finally:
                self._give(worker)
            reply["seconds"] = np.array(time.perf_counter() - start)
            if kept is not None:
                with whole_file(kept) as part, part.open("wb") as stream:
                    np.savez(stream, **reply)  # type: ignore[arg-type]
            return reply

    def run_to_decay(self, job: Job, report: Callable[[float], None] | None = None) -> Reply:
        """Run one job whose fields must decay within its longest time, else SolverError; otherwise as :meth:`run`."""
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

    @cached_property
    def _program(self) -> str:
        """Identity of the program that runs the jobs: version of Meep, and the worker's source."""
        program = finding.best().version if self._command is None else " ".join(self._command)
        return f"{program} {file_sha256(finding.WORKER)}"

    def _kept(self, job: Job) -> Path | None:
        """File of the finished job, named by the hash of all that decides its reply."""
        return None if self._keep is None else self._keep / f"{fingerprint(self._program, job)[:40]}.npz"

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


def _finished(path: Path) -> Reply | None:
    """The reply in a file; None where there is none, or a damaged one, which is then replaced."""
    try:
        return load_reply(path)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None


@cache
def own_pool() -> Pool:
    """The one-worker pool of this process for single cells; it ends with the process and keeps its finished runs."""
    pool = Pool(1, keep=own_folder())
    # Unlike atexit, this also runs at the end of a process that multiprocessing started.
    Finalize(None, pool.close, exitpriority=100)
    return pool
