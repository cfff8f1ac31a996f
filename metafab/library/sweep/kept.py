"""Results of long calls that a stopped build keeps beside its points, so that it does not make them again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import TypeVar

from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress
from metafab.library.sweep.checkpoint import Checkpoint, SolvedPoint

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

#: Numbers that a result is kept as.
Numbers = tuple[complex, ...]


def kept_results(
    calls: Executor,
    function: Callable[[_Task], _Result],
    tasks: Sequence[_Task],
    record: Checkpoint,
    first: int,
    numbers_of: Callable[[_Result], Numbers],
    result_of: Callable[[_Task, Numbers], _Result],
    step: str,
    progress: Progress,
) -> list[_Result]:
    """Results of all tasks in order: those of an earlier start from ``record``, each other one recorded as it arrives.

    Args:
        calls: makes the calls.
        function: called with each task that has no result yet.
        tasks: the tasks.
        record: holds the numbers of each result as a point.
        first: number under which the first task is recorded; the others follow. Calls that share a record need ranges
            that do not overlap.
        numbers_of: numbers of a result, any count.
        result_of: inverse of ``numbers_of``, given the task too.
        step: name of the calls for ``progress``.
        progress: called with the number of results.

    What ``function`` raises comes through; results that arrived before stay in ``record``.
    """
    kept = {point.number: point.amplitudes for point in record.points}
    results = {number: result_of(task, kept[number]) for number, task in enumerate(tasks, first) if number in kept}
    left = [(number, task) for number, task in enumerate(tasks, first) if number not in kept]
    progress(step, len(results), len(tasks))
    ahead = 1 if isinstance(calls, SerialExecutor) else len(tasks)
    for (number, _), (result, seconds) in stream(calls, partial(_timed, function), left, ahead=ahead):
        results[number] = result
        record.add([SolvedPoint(number, numbers_of(result), 0.0, seconds)])
        progress(step, len(results), len(tasks))
    return [results[number] for number in range(first, first + len(tasks))]


def _timed(function: Callable[[_Task], _Result], task: tuple[int, _Task]) -> tuple[_Result, float]:
    """Result and time of a call with a numbered task."""
    started = time.perf_counter()
    result = function(task[1])
    return result, time.perf_counter() - started
