"""Executor over the workers of a Dask cluster, and the watch over its scheduler and its workers."""

from __future__ import annotations

import logging
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Generic, TypeVar, cast

from metafab.core.errors import ClusterLostError, InputError, MissingToolError
from metafab.core.parallel.memory import keep_freed_memory
from metafab.core.parallel.progress import Progress, silent

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Wanted time (s) and size (bytes) of one call, which set the number of its items. Dask spends 15 ms of processor time
#: on a call, on client, scheduler and worker: as much as a tile of a mask takes.
_CALL_S, _CALL_BYTES = 0.2, 8e6
#: Time without any worker after which a warning is logged (s).
PATIENCE_S = 30.0
#: Time between two looks at the number of workers (s).
_LOOK_EVERY_S = 2.0
#: Longest wait for a scheduler to confirm that the connection closes (s).
_CLOSE_S = 3.0

#: Loggers that report a lost connection with a traceback, Dask's client first.
_THEIR_LOGS = ("distributed.client", "distributed.core", "distributed.utils", "tornado.application", "asyncio")

_log = logging.getLogger(__name__)


class ClusterExecutor(Executor):
    """Executor over the workers of a Dask cluster; the caller closes the ``distributed.Client``."""

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

    def in_order(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Generator[Result]:
        """Apply ``function`` to each item and yield the results in order; quick items share a call.

        Two calls per slot are in flight: results that a worker has not yet handed over die with it.
        """
        submit, ahead, source = self.submit_with(partial(_timed, function)), 2 * self.slots, iter(items)
        pending: deque[Future[_Timed[Result]]] = deque()
        count = 1
        try:
            while True:
                while len(pending) < ahead and (batch := tuple(islice(source, count))):
                    pending.append(submit(batch))
                if not pending:
                    return
                done = pending.popleft().result()
                load = max(done.seconds / _CALL_S, done.bytes / _CALL_BYTES)
                count = max(1, int(min(2.0 * count, len(done.results) / load)))
                yield from done.results
        finally:
            for future in pending:
                future.cancel()

    @property
    def slots(self) -> int:
        """Number of calls that can run at the same time."""
        return max(1, int(sum(self._client.nthreads().values())))


def _same(function: Callable[[Item], Result]) -> Callable[[Item], Result]:
    return function


def _call(function: Callable[[Item], Result], item: Item) -> Result:
    keep_freed_memory()
    return function(item)


@dataclass(frozen=True)
class _Timed(Generic[Result]):
    """Results of a call of several items."""

    results: tuple[Result, ...]
    seconds: float  #: Time of the call.
    bytes: int  #: Size of items and results on their way.


def _timed(function: Callable[[Item], Result], items: Sequence[Item]) -> _Timed[Result]:
    start, arrays = time.perf_counter(), list[pickle.PickleBuffer]()
    results = tuple(function(item) for item in items)
    seconds = time.perf_counter() - start
    rest = len(pickle.dumps((items, results), protocol=5, buffer_callback=arrays.append))
    return _Timed(results, seconds, rest + sum(array.raw().nbytes for array in arrays))


@contextmanager
def open_cluster(address: str, progress: Progress = silent) -> Iterator[ClusterExecutor]:
    """Open an executor over the Dask scheduler at ``address``.

    While the cluster has no worker, calls wait for one; after :data:`PATIENCE_S`, a warning is logged and the wait is
    reported as progress.

    Raises:
        MissingToolError: dask distributed is not installed.
        InputError: no scheduler answers at the address.
        ClusterLostError: the scheduler goes away within the block.
    """
    try:
        import distributed
    except ImportError as error:
        raise MissingToolError("`--cluster` needs Dask: pip install 'metafab[cluster]'") from error
    try:
        client: Any = distributed.Client(address)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        expected = "the address of a running Dask scheduler"
        remedy = "start one with `dask scheduler` and give the address that it prints"
        raise InputError.single("--cluster", "address", expected, f"{address} ({error})", remedy) from error
    their_logs = [logging.getLogger(name) for name in _THEIR_LOGS]
    level, ended = their_logs[0].level, threading.Event()
    for log in their_logs:
        log.addFilter(_is_no_lost_connection)
    threading.Thread(target=_watch_workers, args=(client, address, progress, ended), daemon=True).start()
    try:
        yield ClusterExecutor(client)
    except (CancelledError, OSError, RuntimeError) as error:
        # Dask cancels all futures as soon as the connection to the scheduler closes, and then refuses calls.
        if client.status == "running":
            raise
        their_logs[0].setLevel(logging.CRITICAL)  # Dask's client logs as an error that it cannot connect again.
        raise ClusterLostError(address) from error
    finally:
        ended.set()
        with suppress(TimeoutError, OSError):
            client.close(timeout=_CLOSE_S)
        for log in their_logs:
            log.removeFilter(_is_no_lost_connection)
        their_logs[0].setLevel(level)


def _is_no_lost_connection(record: logging.LogRecord) -> bool:
    """Whether a log record of Dask is about anything but a lost connection, which the command reports itself."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, OSError)


def _watch_workers(client: Any, address: str, progress: Progress, ended: threading.Event) -> None:
    """Report the time without any worker, until ``ended`` is set."""
    step = "waiting for a worker"
    since, warned = time.monotonic(), False
    while not ended.wait(_LOOK_EVERY_S):
        try:
            has_workers = bool(client.nthreads())
        except Exception:  # Dask raises many types for a lost scheduler; the caller raises ClusterLostError.
            return
        if has_workers:
            if warned:
                progress(step, 1.0, 1.0)
                _log.warning("the cluster at %s has workers again", address)
            since, warned = time.monotonic(), False
            continue
        waited_s = time.monotonic() - since
        if waited_s >= PATIENCE_S and not warned:
            warned = True
            remedy = "start some with `dask worker %s`, or end this with Ctrl-C: what is finished is kept"
            _log.warning("the cluster at %s has had no worker for %.0f s; " + remedy, address, waited_s, address)
        if warned:
            progress(step, waited_s, 2.0 * waited_s)
