"""Executors for tiles and library points: in this process, on this machine, or on a Dask cluster.

All have the interface of :class:`concurrent.futures.Executor`.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import partial
from itertools import islice
from typing import Any, TypeVar, cast

from metafab.core.errors import InputError, MissingToolError
from metafab.core.parallel.orphans import end_with_parent
from metafab.core.parallel.processes import WorkerProcesses

Item = TypeVar("Item")
Result = TypeVar("Result")

_kept_threads: ContextVar[ThreadPoolExecutor | None] = ContextVar("_kept_threads", default=None)

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


class ClusterExecutor(Executor):
    """Executor over the workers of a Dask cluster.

    Args:
        client: a ``distributed.Client``; the caller closes it.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._calls = client.get_executor()

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Call ``fn`` on a worker; Dask repeats a call whose worker dies."""
        return cast("Future[Result]", self._calls.submit(fn, *args, **kwargs))

    def submit_with(self, function: Callable[[Item], Result]) -> Callable[[Item], Future[Result]]:
        """Return a callable that submits ``function`` of an item and sends ``function`` to each worker only once.

        ``function`` is held as a task result, which Dask recomputes if every worker that holds it dies.
        """
        shared = self._client.submit(_same, function, pure=False)
        return partial(self.submit, _call, shared)

    @property
    def slots(self) -> int:
        """Number of calls that can run at the same time."""
        return max(1, int(sum(self._client.nthreads().values())))


def _same(function: Callable[[Item], Result]) -> Callable[[Item], Result]:
    return function


def _call(function: Callable[[Item], Result], item: Item) -> Result:
    return function(item)


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _single_threaded() -> None:
    """Initialise a worker: one thread of BLAS and numba, Ctrl-C is left to the parent, and no life without it."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import numba
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    # Not by its variable: numba refuses another value of it in the parent, once its threads run there.
    numba.set_num_threads(1)


@contextmanager
def open_executor(workers: int | None = None, cluster: str | None = None) -> Iterator[Executor]:
    """Open an executor over ``workers`` processes, or over the Dask scheduler at ``cluster``.

    Raises:
        InputError: ``workers`` is below one.
        MissingToolError: ``cluster`` is given but dask distributed is not installed.
    """
    if cluster is not None:
        try:
            import distributed
        except ImportError as error:
            raise MissingToolError("`--cluster` needs Dask: pip install 'metafab[cluster]'") from error
        try:
            client: Any = distributed.Client(cluster)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            raise InputError.single(
                "--cluster",
                "address",
                "the address of a running Dask scheduler",
                f"{cluster} ({error})",
                "start one with `dask scheduler` and give the address that it prints",
            ) from error
        try:
            yield ClusterExecutor(client)
        finally:
            client.close()
        return
    count = default_workers() if workers is None else workers
    if count < 1:
        raise InputError.single("--workers", "workers", "a whole number from 1", str(count))
    if count == 1:
        yield SerialExecutor()
        return
    saved = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    context = multiprocessing.get_context("spawn")
    pool = WorkerProcesses(count, context, _single_threaded)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def open_threads(workers: int | None = None, cluster: str | None = None) -> AbstractContextManager[Executor]:
    """Open an executor over threads of this process (for work that releases the interpreter lock), or a cluster.

    Raises:
        InputError, MissingToolError: as :func:`open_executor`.
    """
    return ThreadPoolExecutor(workers or default_workers()) if cluster is None else open_executor(cluster=cluster)


@contextmanager
def kept_threads() -> Iterator[ThreadPoolExecutor]:
    """Open a thread pool for many short jobs; a nested block reuses the pool of the outer one.

    Starting and ending threads takes a millisecond. A job must not wait for another job of the same pool.
    """
    kept = _kept_threads.get()
    if kept is not None:
        yield kept
        return
    with ThreadPoolExecutor(max(2, default_workers())) as threads:
        token = _kept_threads.set(threads)
        try:
            yield threads
        finally:
            _kept_threads.reset(token)


def _submitter(executor: Executor, function: Callable[[Item], Result]) -> Callable[[Item], Future[Result]]:
    """Return a callable that submits ``function`` of an item."""
    if isinstance(executor, ClusterExecutor):
        return executor.submit_with(function)
    return lambda item: executor.submit(function, item)


def stream(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = 8
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
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = 8
) -> Iterator[Result]:
    """Apply ``function`` to each item and yield the results in the order of the items, at most ``ahead`` in flight.

    On a cluster, two calls per slot are in flight, and ``function`` is sent to each worker once.
    """
    submit = _submitter(executor, function)
    if isinstance(executor, ClusterExecutor):
        ahead = 2 * executor.slots  # results that a worker has not yet handed over die with it
    source = iter(items)
    pending: deque[Future[Result]] = deque()
    try:
        for item in islice(source, ahead):
            pending.append(submit(item))
        while pending:
            result = pending.popleft().result()
            for item in islice(source, 1):
                pending.append(submit(item))
            yield result
    finally:
        for future in pending:
            future.cancel()
