"""Executors for tiles and library points: in this process, on this machine, or on a Dask cluster.

All have the interface of :class:`concurrent.futures.Executor`.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice, pairwise
from threading import Lock
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from metafab.core.errors import InputError
from metafab.core.parallel.cluster import ClusterExecutor, open_cluster
from metafab.core.parallel.processes import WorkerProcesses
from metafab.core.parallel.progress import Progress, silent

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")

_kept_threads: ContextVar[KeptThreads | None] = ContextVar("_kept_threads", default=None)

#: Pieces of work that are submitted and not yet yielded, unless a caller says otherwise.
AHEAD = 8

#: Work of a compiled loop, in seconds, from which a second thread pays: to hand it over takes 50 us.
_WORTH_A_THREAD_S = 2e-4
#: Seconds for each element of its arrays that each compiled loop, a function of a module, took the last time.
_seconds_of_element: dict[Callable[..., None], float] = {}

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class SerialExecutor(Executor):
    """Executor that runs each call immediately in this process: for one worker, and for debugging."""

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Call ``fn`` now and return its finished future."""
        future: Future[Result] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # as a pool would: the future carries it
            future.set_exception(error)
        return future


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


@contextmanager
def open_executor(
    workers: int | None = None, cluster: str | None = None, progress: Progress = silent
) -> Iterator[Executor]:
    """Open an executor over ``workers`` processes, or over the Dask scheduler at ``cluster``.

    Args:
        workers: number of processes; None for all cores.
        cluster: address of the scheduler; None for this machine.

    Raises:
        InputError: ``workers`` is below one, or no scheduler answers.
        MissingToolError, ClusterLostError: as :func:`metafab.core.parallel.cluster.open_cluster`.
    """
    if cluster is not None:
        with open_cluster(cluster, progress) as calls:
            yield calls
        return
    count = default_workers() if workers is None else workers
    if count < 1:
        raise InputError.single("--workers", "workers", "a whole number from 1", str(count))
    if count == 1:
        yield SerialExecutor()
        return
    saved = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    pool = WorkerProcesses(count)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def open_threads(
    workers: int | None = None, cluster: str | None = None, progress: Progress = silent
) -> AbstractContextManager[Executor]:
    """Open an executor over threads of this process (for work that releases the interpreter lock), or a cluster.

    Errors as :func:`open_executor`.
    """
    if cluster is not None:
        return open_executor(cluster=cluster, progress=progress)
    return ThreadPoolExecutor(workers or default_workers())


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit the BLAS libraries of this process to one thread each; they are looked up at the first call alone.

    The limit holds for the whole process, from the first of blocks that overlap, in this thread or others, to the end
    of the last. If each restored what it found, the limit could stay, or end within a block.
    """
    with _blas_lock:
        _blas_limits.append(None if _blas_limits else _blas().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _blas_lock:
            first = _blas_limits[0]
            _blas_limits.pop()
            if not _blas_limits:
                first.restore_original_limits()


_blas_lock = Lock()
#: One entry for each block that asks for one thread; the first restores what was before.
_blas_limits: list[Any] = []


@cache
def _blas() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  its BLAS is not NumPy's: one that is loaded later would not be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class SharedJob(Generic[Result]):
    """A call that was handed to a kept thread."""

    def __init__(self, threads: ThreadPoolExecutor, function: Callable[..., Result], *arguments: Any) -> None:
        self._call = partial(function, *arguments)
        self._future = threads.submit(self._call)

    def result(self) -> Result:
        """Return the call's result; a call that no thread has begun is made by the thread that asks."""
        return self._call() if self._future.cancel() else self._future.result()


@dataclass(frozen=True)
class KeptThreads:
    """Threads for many short calls, which the thread that waits for a result makes as well."""

    threads: ThreadPoolExecutor  #: One less than the cores, at least one.

    def submit(self, function: Callable[..., Result], *arguments: Any) -> SharedJob[Result]:
        """Hand a call to a thread; it must not wait for other calls of the same threads."""
        return SharedJob(self.threads, function, *arguments)

    def map(self, function: Callable[..., Result], *items: Iterable[Any]) -> list[Result]:
        """Call ``function`` for each item on all cores and return the results in the order of the items.

        A single item is computed by this thread alone, whose :func:`spread` then finds the other threads free. After an
        exception, Ctrl-C included, no further calls begin.
        """
        calls = list(enumerate(zip(*items, strict=True)))
        left, results = iter(calls), dict[int, Result]()

        def work() -> None:
            try:
                for number, arguments in left:
                    results[number] = function(*arguments)
            finally:
                deque(left, maxlen=0)  # None are left, except after an exception.

        jobs = [self.submit(work) for _ in range(min(default_workers(), len(calls)) - 1)]
        try:
            work()
        finally:
            for job in jobs:
                job.result()
        return [results[number] for number, _ in calls]


@contextmanager
def kept_threads() -> Iterator[KeptThreads]:
    """Open threads for many short jobs; a nested block reuses those of the outer one.

    Starting and ending threads takes a millisecond. Meanwhile BLAS has one thread: its own would wait in busy loops on
    the cores of these.
    """
    kept = _kept_threads.get()
    if kept is not None:
        yield kept
        return
    with one_blas_thread(), ThreadPoolExecutor(max(1, default_workers() - 1)) as threads:
        kept = KeptThreads(threads)
        token = _kept_threads.set(kept)
        try:
            yield kept
        finally:
            _kept_threads.reset(token)


def spread(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Call ``kernel(first, stop, *arguments)`` for parts of ``range(count)``, in parallel on the kept threads.

    There is one part on one core, without :func:`kept_threads`, inside one of its jobs, and where the kernel took so
    little time for each element of its arrays, the last time, that a thread would not pay. The kernel is compiled;
    results of items do not depend on each other.
    """
    threads = _kept_threads.get()
    size = max(1, sum(getattr(one, "size", 0) for one in arguments))
    pays = threads is not None and _seconds_of_element.get(kernel, math.inf) * size > _WORTH_A_THREAD_S
    parts = max(1, min(count, default_workers())) if pays else 1
    edges = [count * part // parts for part in range(parts + 1)]
    jobs = [] if threads is None else [threads.submit(kernel, *edge, *arguments) for edge in pairwise(edges[1:])]
    started = time.perf_counter()
    kernel(edges[0], edges[1], *arguments)
    if edges[1]:
        _seconds_of_element[kernel] = (time.perf_counter() - started) * parts / size
    for job in jobs:
        job.result()


def _submitter(executor: Executor, function: Callable[[Item], Result]) -> Callable[[Item], Future[Result]]:
    """Return a callable that submits ``function`` of an item."""
    if isinstance(executor, ClusterExecutor):
        return executor.submit_with(function)
    return lambda item: executor.submit(function, item)


def stream(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = AHEAD
) -> Iterator[tuple[Item, Result]]:
    """Apply ``function`` to each item and yield (item, result) pairs as they finish.

    Memory stays bounded for any number of items: at most ``ahead`` are submitted and not yet yielded.
    """
    submit = _submitter(executor, function)
    source = iter(items)
    pending: dict[Future[Result], Item] = {}
    while True:
        for item in islice(source, ahead - len(pending)):
            pending[submit(item)] = item
        if not pending:
            return
        done, _ = wait(pending, return_when=FIRST_COMPLETED)
        for future in done:
            yield pending.pop(future), future.result()


def in_order(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = AHEAD
) -> Generator[Result]:
    """Apply ``function`` to each item and yield the results in the order of the items, at most ``ahead`` in flight.

    A cluster has its own way (:meth:`metafab.core.parallel.cluster.ClusterExecutor.in_order`).
    """
    if isinstance(executor, ClusterExecutor):
        yield from executor.in_order(function, items)
        return
    source = iter(items)
    pending: deque[Future[Result]] = deque()
    try:
        for item in islice(source, ahead):
            pending.append(executor.submit(function, item))
        while pending:
            result = pending.popleft().result()
            for item in islice(source, 1):
                pending.append(executor.submit(function, item))
            yield result
    finally:
        for future in pending:
            future.cancel()
