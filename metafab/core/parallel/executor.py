"""One executor interface for tiles and library points: in this process, on this machine, or on a cluster.

The interface is that of :mod:`concurrent.futures`; a Dask client offers the same two methods.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import partial
from itertools import islice
from typing import Any, TypeVar, cast

from metafab.core.errors import InputError, MissingToolError
from metafab.core.parallel.interrupts import held_interrupts

Item = TypeVar("Item")
Result = TypeVar("Result")

_kept_threads: ContextVar[ThreadPoolExecutor | None] = ContextVar("_kept_threads", default=None)

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class SerialExecutor(Executor):
    """Runs each call at once, in this process; for one worker and for debugging."""

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Call ``fn`` now and return its finished future."""
        future: Future[Result] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # what a pool would hand over, too
            future.set_exception(error)
        return future


class ClusterExecutor(Executor):
    """Runs calls on the workers of a Dask client.

    Args:
        client: of ``distributed``; stays open.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._calls = client.get_executor()

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Call ``fn`` on a worker; a call whose worker dies is made again by another."""
        return cast("Future[Result]", self._calls.submit(fn, *args, **kwargs))

    def submit_with(self, function: Callable[[Item], Result]) -> Callable[[Item], Future[Result]]:
        """What submits ``function`` of an item: the function travels to each worker once, and not with each item.

        The function is itself the result of a call, which Dask makes again should every worker that holds it die.
        """
        shared = self._client.submit(_same, function, pure=False)
        return partial(self.submit, _call, shared)

    @property
    def slots(self) -> int:
        """Calls that can run at the same time."""
        return max(1, int(sum(self._client.nthreads().values())))


def _same(function: Callable[[Item], Result]) -> Callable[[Item], Result]:
    return function


def _call(function: Callable[[Item], Result], item: Item) -> Result:
    return function(item)


class _Processes(ProcessPoolExecutor):
    """Worker processes that an interrupt of this one finds whole or not at all."""

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """As any executor; the first call starts the processes."""
        with held_interrupts():
            return super().submit(fn, *args, **kwargs)


def default_workers() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _single_threaded() -> None:
    """In a worker process: one BLAS thread each, all cores by processes; Ctrl-C is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


@contextmanager
def open_executor(workers: int | None = None, cluster: str | None = None) -> Iterator[Executor]:
    """An executor over ``workers`` processes, or over the Dask scheduler at ``cluster``.

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
    pool = _Processes(count, mp_context=context, initializer=_single_threaded)
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
    """Threads of this process, for work that leaves them free to run and shares what it holds; or a cluster.

    Raises:
        InputError, MissingToolError: as :func:`open_executor`.
    """
    return ThreadPoolExecutor(workers or default_workers()) if cluster is None else open_executor(cluster=cluster)


@contextmanager
def kept_threads() -> Iterator[ThreadPoolExecutor]:
    """Threads for many small jobs one after the other: within another such block, those of that block.

    To start and end threads takes a millisecond. Jobs must not wait for other jobs of the same threads.
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
    """What submits ``function`` of an item."""
    if isinstance(executor, ClusterExecutor):
        return executor.submit_with(function)
    return lambda item: executor.submit(function, item)


def stream(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = 8
) -> Iterator[tuple[Item, Result]]:
    """Apply ``function`` to each item and yield (item, result) pairs as they finish, few in flight at a time.

    Memory stays bounded however many items there are: at most ``ahead`` are submitted and not yet yielded.
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
    """Apply ``function`` to each item and yield the results in the order of the items, few in flight at a time.

    On a cluster there are as many in flight as keep it busy, and ``function`` is sent to each worker once.
    """
    submit = _submitter(executor, function)
    if isinstance(executor, ClusterExecutor):
        ahead = 2 * executor.slots  # what a worker has finished and not handed over dies with it
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
