"""Long-lived workers, one a core, replaced before their memory grows; what they finished is not run again."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from metafab.cell.meep import finding
from metafab.cell.meep.kept import KeptReplies, own_folder
from metafab.cell.meep.protocol import Job, Reply, Worker
from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers
from metafab.core.storage.files import file_sha256

Item = TypeVar("Item")
Result = TypeVar("Result")


class Pool:
    """Runs jobs on several workers at once; a context manager, safe to share between threads.

    Workers start when they are first needed. One that has failed is replaced for the next job.

    Args:
        workers: processes, one thread each; by default as many as there are cores.
        command: the worker's program; by default the first interpreter that has Meep.
        jobs_per_worker: a worker is replaced after so many jobs, as Meep does not give back all of its memory.
        limit_s: time limit of one job.
        keep: folder of finished jobs; an equal job, this process' or an earlier one's, is answered from it.
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

        Returns:
            The worker's arrays, and ``seconds``, what the run took when it was made.

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

    def stream(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[tuple[Item, Result]]:
        """Apply ``function``, which calls :meth:`run`, to each item, as many at once as there are workers.

        Pairs (item, result) come as they finish. The first failure, or leaving early, ends all workers.
        """
        todo = iter(items)
        pending: dict[Future[Any], Item] = {}
        with ThreadPoolExecutor(self.size) as threads:
            try:
                while True:
                    while len(pending) < self.size and (item := next(todo, None)) is not None:
                        pending[threads.submit(function, item)] = item
                    if not pending:
                        return
                    for future in wait(pending, return_when=FIRST_COMPLETED).done:
                        yield pending.pop(future), future.result()
            finally:
                if pending:
                    self.close()

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
    """The one worker of this process, for cells that are solved one by one; it ends with the process.

    It keeps what it finished in :func:`metafab.cell.meep.kept.own_folder`.
    """
    pool = Pool(1, keep=own_folder())
    # Unlike atexit, this also runs at the end of a process that multiprocessing started.
    Finalize(None, pool.close, exitpriority=100)
    return pool
