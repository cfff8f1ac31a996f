"""Worker processes of this machine: a worker that dies is replaced, and its work is done again.

A dead worker breaks its pool, and all pieces in flight are lost with it; which of them ended the worker is unknown. The
first time they all start again in a new pool. A piece that is lost twice goes on alone, in a pool of one worker. A
piece that is lost there too ends in :class:`metafab.core.errors.WorkerLostError`, which names it.

Workers are forked where that is safe, which saves each a second of imports, and otherwise spawned. They end when their
parent is gone, however it ended. Where the system refuses some of them, the others do the work, or this process.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import connection
from typing import Any, TypeVar

from metafab.core.errors import WorkerLostError
from metafab.core.parallel.interrupts import held_interrupts

#: Exit code of a worker without its parent.
_ORPHANED = 3
_PR_SET_PDEATHSIG = 1
Result = TypeVar("Result")
_log = logging.getLogger(__name__)

#: Losses after which a piece is given up.
MOST_LOSSES = 3
#: Largest length of a piece's name in messages (characters).
_LONGEST_NAME = 160


def end_with_parent() -> None:
    """End this worker process as soon as its parent is gone.

    A daemon thread waits on the pipe that the parent holds open. A process that multiprocessing did not start is left
    as it is.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_wait_for_end, args=(parent.sentinel,), daemon=True).start()


def end_with_forking_thread() -> None:
    """Let Linux kill this forked worker when the thread that forked it ends; needs no thread of its own."""
    parent = multiprocessing.parent_process()
    if parent is None or sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent.pid:  # It ended before the call.
        os._exit(_ORPHANED)


def _wait_for_end(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(_ORPHANED)


class _Piece(Future[Any]):
    """Future of a call (the function with its arguments), in whichever pool it runs."""

    def __init__(self, call: partial[Any]) -> None:
        super().__init__()
        self.call = call
        self.losses = 0
        self.running_in: Future[Any] | None = None

    def cancel(self) -> bool:
        """Cancel the call if it has not begun."""
        inner = self.running_in
        return (inner is None or inner.cancel()) and super().cancel()


class WorkerProcesses(Executor):
    """Pool of ``count`` processes, each with one thread of BLAS, that replaces workers that die."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._lock = threading.RLock()
        self._pool: ProcessPoolExecutor | None = None
        self._has_begun = False  # whether the pool has taken a piece
        self._smaller: list[ProcessPoolExecutor] = []  # pools that were refused further processes
        self._lone_pool: ProcessPoolExecutor | None = None
        self._alone: deque[_Piece] = deque()
        self._closed = False

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Submit a call; the first one starts the processes; RuntimeError if the pool is shut down."""
        piece = _Piece(partial(fn, *args, **kwargs))
        with self._lock:
            if self._closed:
                raise RuntimeError("cannot schedule new futures after shutdown")
            self._start(piece)
        return piece

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers, after the work in progress if ``wait``."""
        with self._lock:
            self._closed = True
            pools = [pool for pool in (self._pool, self._lone_pool, *self._smaller) if pool is not None]
        for pool in pools:
            pool.shutdown(wait=wait, cancel_futures=cancel_futures)

    def _start(self, piece: _Piece) -> None:
        """Start a piece among the others; the lock is held."""
        while self._count:
            if self._pool is None:
                self._pool, self._has_begun = self._new_pool(self._count), False
            try:
                with held_interrupts(), none_left_of_refused():
                    inner = self._pool.submit(piece.call)
            except BrokenProcessPool:  # it broke just now
                self._pool = None
                continue
            except (OSError, RuntimeError) as error:  # no room for so many processes, or for the pool's thread
                if self._has_begun:  # the processes that it has finish what they were given
                    self._smaller.append(self._pool)
                self._pool, self._count = None, self._count - 1
                _log.warning("the system refuses a worker process (%s): work goes on with fewer", error)
                continue
            self._has_begun = True
            self._follow(piece, inner, self._pool)
            return
        try:
            piece.set_result(piece.call())
        except Exception as error:  # as a pool would: the future carries it
            piece.set_exception(error)

    def _start_alone(self) -> None:
        """Start the first of the pieces that run alone, unless one is running; the lock is held."""
        piece = self._alone[0]
        if self._lone_pool is None:
            self._lone_pool = self._new_pool(1)
        with held_interrupts():
            inner = self._lone_pool.submit(piece.call)
        self._follow(piece, inner, self._lone_pool)

    def _new_pool(self, count: int) -> ProcessPoolExecutor:
        if can_fork():
            return ProcessPoolExecutor(count, multiprocessing.get_context("fork"), initializer=_begin_forked)
        return ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=_begin_spawned)

    def _follow(self, piece: _Piece, inner: Future[Any], pool: ProcessPoolExecutor) -> None:
        piece.running_in = inner
        inner.add_done_callback(partial(self._ended, piece, pool))

    def _ended(self, piece: _Piece, pool: ProcessPoolExecutor, inner: Future[Any]) -> None:
        if inner.cancelled():
            Future.cancel(piece)
            piece.set_running_or_notify_cancel()
            return
        error = inner.exception()
        lost = isinstance(error, BrokenProcessPool)
        if lost:
            self._lose(piece, pool)
        elif error is not None:
            piece.set_exception(error)
        else:
            piece.set_result(inner.result())
        with self._lock:
            if self._alone and self._alone[0] is piece and not (lost and piece.losses < MOST_LOSSES):
                self._alone.popleft()
                if self._alone and not self._closed:
                    self._start_alone()

    def _lose(self, piece: _Piece, pool: ProcessPoolExecutor) -> None:
        """Start a piece again whose pool broke, or give it up."""
        with self._lock:
            if pool is self._pool:
                self._pool = None
            if pool is self._lone_pool:
                self._lone_pool = None
            piece.losses += 1
            if piece.losses < MOST_LOSSES and not self._closed:
                if piece.losses == 1:
                    self._start(piece)
                    return
                self._alone.append(piece)
                if self._alone[0] is piece:
                    self._start_alone()
                return
        piece.set_exception(WorkerLostError(call_name(piece.call), piece.losses))


@contextmanager
def none_left_of_refused() -> Iterator[None]:
    """End the processes that the block has started if it fails.

    A pool that is refused one of its processes leaves the others without a manager: this process would wait for them at
    its end.
    """
    before = set(multiprocessing.active_children())
    try:
        yield
    except (OSError, RuntimeError):
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
            process.join()
        raise


def can_fork() -> bool:
    """Whether this process may be copied: on Linux, and without other threads, whose locks a copy would inherit."""
    return sys.platform == "linux" and threading.active_count() == 1


def begin_copy() -> None:
    """Initialise a forked process: the parent handles Ctrl-C, SIGTERM ends it, and it has no life without its parent.

    Garbage collections leave what it inherited alone; they would touch, and so copy, every page.
    """
    end_with_forking_thread()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to the whole group
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()


def _begin_forked() -> None:
    begin_copy()
    _limit_threads()


def _begin_spawned() -> None:
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _limit_threads()


def _limit_threads() -> None:
    """Use one thread of BLAS."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def call_name(call: partial[Any]) -> str:
    """Function and arguments of a call for messages, shortened."""
    function = call.func
    while isinstance(function, partial):
        function = function.func
    arguments = ", ".join(repr(argument) for argument in call.args)
    text = f"{getattr(function, '__name__', repr(function))}({arguments})"
    return text if len(text) <= _LONGEST_NAME else text[: _LONGEST_NAME - 3] + "..."
