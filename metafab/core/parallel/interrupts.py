"""Ctrl-C and SIGTERM: raised in the main thread, deferred while a worker process starts, never lost."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_ENDING = (signal.SIGINT, signal.SIGTERM)

#: Delay before a signal is sent again (s): by then the code that it must not end has usually returned.
_AGAIN_AFTER_S = 0.01

#: Code that waits for a thread: before Python 3.13, an exception there marks a thread that still runs as ended.
_JOINS = tuple(
    method.__code__
    for name in ("_wait_for_tstate_lock", "_stop")
    if (method := getattr(threading.Thread, name, None)) is not None
)


class InterruptedRunError(BaseException):
    """Ctrl-C or SIGTERM; unwinds the whole stack, so that half-written files are removed."""

    def __init__(self, number: signal.Signals) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def raised_interrupts() -> Iterator[None]:
    """Raise :class:`InterruptedRunError` on Ctrl-C and SIGTERM within the block; call it in the main thread.

    A signal may arrive in a finalizer or in a callback, where Python prints an exception and goes on, or while a thread
    is joined, where Python would take it for ended. Such a signal is sent again after 10 ms. Where it arrives within a
    class body or the import of a compiled module, another exception takes its place: after a signal, any exception that
    ends the block becomes the signal's.
    """
    arrived: list[signal.Signals] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        arrived.append(signal.Signals(number))
        if frame is not None and frame.f_code in _JOINS:
            _thread.start_new_thread(_send_later, (arrived[-1],))
            return
        raise InterruptedRunError(arrived[-1])

    hook = sys.unraisablehook
    before = {number: signal.signal(number, interrupt) for number in _ENDING}
    sys.unraisablehook = _raising_again(hook)
    try:
        yield
    except Exception as error:
        if arrived:
            raise InterruptedRunError(arrived[-1]) from error
        raise
    finally:
        sys.unraisablehook = hook
        _restore(before)


def _raising_again(hook: Callable[[UnraisableHookArgs], Any]) -> Callable[[UnraisableHookArgs], None]:
    def again(unraisable: UnraisableHookArgs) -> None:
        error = unraisable.exc_value
        if isinstance(error, InterruptedRunError):
            # threading.Thread takes locks that the interrupted code may hold; this takes none.
            _thread.start_new_thread(_send_later, (error.number,))
        else:
            hook(unraisable)

    return again


def _send_later(number: signal.Signals) -> None:
    time.sleep(_AGAIN_AFTER_S)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(cast("int", threading.main_thread().ident), number)  # interrupts a blocking wait
    else:
        _thread.interrupt_main(number)


@contextmanager
def held_interrupts() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM to the end of the block.

    Used for actions that must not stop halfway, such as starting a process and sending its first message. A process
    started within the block ignores Ctrl-C, which a terminal sends to all processes of the group; its parent ends it.
    Outside the main thread the block has no effect, because signals are raised only there.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before: dict[signal.Signals, Any] = {}
    mask = _hide_from_new_processes()
    try:
        for number in _ENDING:
            before[number] = signal.signal(number, lambda number, frame: arrived.append(number))
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        _restore(before)
        for late in arrived:
            signal.raise_signal(late)


def _hide_from_new_processes() -> set[int] | None:
    """Block Ctrl-C for this thread and its new processes; return the previous signal mask, None on Windows."""
    if not hasattr(signal, "pthread_sigmask"):
        return None
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}))


def _restore(before: dict[signal.Signals, Any]) -> None:
    for number, handler in before.items():
        if handler is not None:  # None: set by other means than Python's
            signal.signal(number, handler)
