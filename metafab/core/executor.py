"""One executor interface for tiles and library points: in this process, on this machine, or on a cluster.

The interface is that of :mod:`concurrent.futures`; a Dask client offers the same two methods.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from metafab.core.errors import InputError, MissingToolError

Item = TypeVar("Item")
Result = TypeVar("Result")

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
            yield client.get_executor()
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
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_single_threaded)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def stream(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = 8
) -> Iterator[tuple[Item, Result]]:
    """Apply ``function`` to each item and yield (item, result) pairs as they finish, few in flight at a time.

    Memory stays bounded however many items there are: at most ``ahead`` are submitted and not yet yielded.
    """
    source = iter(items)
    pending: dict[Future[Result], Item] = {}
    while True:
        for item in islice(source, ahead - len(pending)):
            pending[executor.submit(function, item)] = item
        if not pending:
            return
        done, _ = wait(pending, return_when=FIRST_COMPLETED)
        for future in done:
            yield pending.pop(future), future.result()


def in_order(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = 8
) -> Iterator[Result]:
    """Apply ``function`` to each item and yield the results in the order of the items, few in flight at a time."""
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
