"""Work that is shared with copies of this process, which start at once with all that it holds."""

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

Item = TypeVar("Item")
Result = TypeVar("Result")

#: In a copy: the function and the items that it inherited.
_inherited: list[Any] = []


def shared(function: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None) -> Iterator[Result]:
    """Apply ``function`` to each item in copies of this process and yield the results in the order of the items.

    A copy needs no imports and is sent no data, which pays for work of seconds;
    :mod:`metafab.core.parallel.executor` is for
    all that is longer. Only results travel. Where a process cannot be copied safely (other threads run in it, or the
    system is not Linux), and for one worker, the work is done here; the results are the same.

    Args:
        function: changes nothing in this process that anybody waits for; must not start compiled parallel loops.
        items: what it is applied to.
        workers: processes; None for all cores.
    """
    count = min(default_workers() if workers is None else workers, len(items))
    if count < 2 or sys.platform != "linux" or threading.active_count() > 1:
        yield from map(function, items)
        return
    copied = multiprocessing.get_context("fork")
    # What a copy is initialised with it inherits; it is not sent.
    with ProcessPoolExecutor(count, mp_context=copied, initializer=_inherit, initargs=(function, items)) as pool:
        yield from pool.map(_apply, range(len(items)))


def _inherit(function: Callable[[Any], Any], items: Sequence[Any]) -> None:
    _inherited[:] = function, items
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C, which reaches all of a terminal's, is the parent's business
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # what was inherited stays: looking through it for garbage would copy its pages, too


def _apply(index: int) -> Any:
    function, items = _inherited
    return function(items[index])
