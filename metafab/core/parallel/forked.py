"""Work shared with forked copies of this process, which inherit its memory."""

from __future__ import annotations

import gc
import multiprocessing
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.orphans import end_with_forking_thread

Item = TypeVar("Item")
Result = TypeVar("Result")

#: In a forked process: the inherited function and items.
_inherited: list[Any] = []


def shared(function: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None) -> Iterator[Result]:
    """Apply ``function`` to each item in forked processes and yield the results in the order of the items.

    A fork starts without imports and without sending data, which pays for work of a few seconds; use
    :mod:`metafab.core.parallel.executor` for longer work. Only results are pickled. The work is done in this process,
    with the same results, for one worker, with other threads running, or on systems other than Linux.

    Args:
        function: has no side effects in this process and starts no compiled parallel loop.
        items: arguments of ``function``.
        workers: processes; None for all cores.
    """
    count = min(default_workers() if workers is None else workers, len(items))
    if count < 2 or sys.platform != "linux" or threading.active_count() > 1:
        yield from map(function, items)
        return
    context = multiprocessing.get_context("fork")
    # With the fork context, the arguments of the initialiser are inherited, not pickled.
    with ProcessPoolExecutor(count, mp_context=context, initializer=_inherit, initargs=(function, items)) as pool:
        yield from pool.map(_apply, range(len(items)))


def _inherit(function: Callable[[Any], Any], items: Sequence[Any]) -> None:
    end_with_forking_thread()
    _inherited[:] = function, items
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to the whole group; the parent handles it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # a collection would touch, and so copy, every inherited page


def _apply(index: int) -> Any:
    function, items = _inherited
    return function(items[index])
