"""Work shared with forked copies of this process, which inherit its memory."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, TypeVar

from metafab.core.errors import WorkerLostError
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.processes import MOST_LOSSES, begin_copy, call_name, can_fork, none_left_of_refused

Item = TypeVar("Item")
Result = TypeVar("Result")

#: In a forked process: the inherited function and items.
_inherited: list[Any] = []


def shared(function: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None) -> Iterator[Result]:
    """Apply ``function`` to each item in forked processes and yield the results in the order of the items.

    A fork starts without imports and without sending data, which pays for work of a few seconds; use
    :mod:`metafab.core.parallel.executor` for longer work. Only results are pickled. The work is done in this process,
    with the same results, for one worker, with other threads running, or on systems other than Linux. Work of a process
    that is killed is done again; WorkerLostError if three in a row end on one item. Where the system refuses a process,
    this one does the work that is left.

    ``function`` has no side effects in this process and starts no compiled parallel loop. ``workers`` None is all
    cores.
    """
    count = min(default_workers() if workers is None else workers, len(items))
    if count < 2 or not can_fork():
        yield from map(function, items)
        return
    context = multiprocessing.get_context("fork")
    done = losses = 0
    while done < len(items):
        workers = 1 if losses == MOST_LOSSES - 1 else count  # alone, the next item is the one that is lost
        try:
            # With the fork context, the arguments of the initialiser are inherited, not pickled.
            with ProcessPoolExecutor(workers, context, initializer=_inherit, initargs=(function, items)) as pool:
                try:
                    with none_left_of_refused():
                        results = pool.map(_apply, range(done, len(items)))
                except OSError:
                    results = map(function, items[done:])
                for result in results:
                    done, losses = done + 1, 0
                    yield result
        except BrokenProcessPool:
            losses += 1
            if losses == MOST_LOSSES:
                raise WorkerLostError(call_name(partial(function, items[done])), losses) from None


def _inherit(function: Callable[[Any], Any], items: Sequence[Any]) -> None:
    begin_copy()
    _inherited[:] = function, items


def _apply(index: int) -> Any:
    function, items = _inherited
    return function(items[index])
