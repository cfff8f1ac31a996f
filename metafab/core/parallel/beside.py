"""A call in a forked copy of this process, which goes on with other work meanwhile."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.interrupts import held_interrupts
from metafab.core.parallel.processes import begin_copy, can_fork

Result = TypeVar("Result")


class Beside(Generic[Result]):
    """A call that has begun in a copy of this process; OSError where the system has no room for one.

    The copy inherits the memory, so that only the result is pickled. It ends with this process, however that ends.
    """

    def __init__(self, call: Callable[[], Result]) -> None:
        context = multiprocessing.get_context("fork")
        self._call = call
        self._answers, end = context.Pipe(duplex=False)
        self._process = context.Process(target=_answer, args=(call, end))
        try:
            with held_interrupts():
                self._process.start()
        finally:
            end.close()

    def result(self) -> Result:
        """Wait for the result; if the copy failed or was killed, do the call here, with its exception and traceback."""
        try:
            return self._answers.recv()  # type: ignore[no-any-return]
        except (EOFError, OSError):  # OSError within an answer
            pass
        finally:
            self.kill()
        return self._call()

    def kill(self) -> None:
        """End the copy; what it has not answered is lost."""
        self._process.kill()
        self._process.join()
        self._answers.close()


def begin_beside(call: Callable[[], Result], workers: int | None = None) -> Beside[Result] | None:
    """Begin a call in a copy of this process.

    None for one worker (``workers`` None is all cores), beside other threads, on systems other than Linux, and where
    the system has no room for a process: do the call later, then.
    """
    if (workers or default_workers()) < 2 or not can_fork() or multiprocessing.current_process().daemon:
        return None
    try:
        return Beside(call)
    except OSError:
        return None


def _answer(call: Callable[[], Any], end: Connection) -> None:
    begin_copy()
    with suppress(Exception):  # `result` does the call again.
        end.send(call())
