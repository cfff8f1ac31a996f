"""Ctrl-C and SIGTERM: raised wherever the program stands, held while a worker process starts, and never lost."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, cast

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_ENDING = (signal.SIGINT, signal.SIGTERM)

#: After this the code that could not raise (a finalizer, a callback) has returned; if not, it is tried once more.
_AGAIN_AFTER_S = 0.01


class InterruptedRunError(BaseException):
    """Ctrl-C or SIGTERM: unwinds everything, so that half-written files are removed; nobody swallows it."""

    def __init__(self, number: signal.Signals) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def raised_interrupts() -> Iterator[None]:
    """Within the block, Ctrl-C and SIGTERM raise :class:`InterruptedRunError` in the main thread, of which this is.

    A signal may arrive in a finalizer, in the callback of a weak reference or in one that compiled code calls. From
    there nothing can be raised: Python prints it and goes on. Here it is not printed, and raised a moment later.
    """
    hook = sys.unraisablehook
    before = {number: signal.signal(number, _interrupt) for number in _ENDING}
    sys.unraisablehook = _raising_again(hook)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        _restore(before)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise InterruptedRunError(signal.Signals(number))


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
        signal.pthread_kill(cast("int", threading.main_thread().ident), number)  # wakes it from what it waits for
    else:
        _thread.interrupt_main(number)


@contextmanager
def held_interrupts() -> Iterator[None]:
    """Within the block, Ctrl-C and SIGTERM wait: they do what they would have done when it ends.

    For what must not be left half done, such as handing a new process what it begins with. Processes that start within
    never see Ctrl-C, which a terminal sends to all of them: to end them is the business of who started them. In other
    threads than the main one nothing needs to be held, as no signal is raised there.
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
    """Block Ctrl-C for this thread, which its new processes inherit; the signals blocked before, None on Windows."""
    if not hasattr(signal, "pthread_sigmask"):
        return None
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}))


def _restore(before: dict[signal.Signals, Any]) -> None:
    for number, handler in before.items():
        if handler is not None:  # None: set by other means than Python's
            signal.signal(number, handler)
