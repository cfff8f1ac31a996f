"""Results that a stopped build keeps: which calls are made again, and what comes back."""

from __future__ import annotations

from pathlib import Path

import pytest

from metafab.core.parallel.executor import SerialExecutor
from metafab.core.parallel.progress import silent
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.library.sweep.kept import kept_results


def test_a_second_start_makes_the_calls_that_the_first_one_lacks(tmp_path: Path) -> None:
    made: list[int] = []

    def tenth(task: int) -> float:
        made.append(task)
        if len(made) == 3:
            raise KeyboardInterrupt
        return task / 10.0

    def results(tasks: list[int], first: int) -> list[float]:
        with Checkpoint(tmp_path / "kept", "inputs") as record:
            return kept_results(
                SerialExecutor(),
                tenth,
                tasks,
                record,
                first,
                lambda result: (complex(result),),
                lambda task, numbers: numbers[0].real,
                "tenths",
                silent,
            )

    with pytest.raises(KeyboardInterrupt):
        results([1, 2, 3, 4], 5)
    assert made == [1, 2, 3]
    assert results([1, 2, 3, 4], 5) == [0.1, 0.2, 0.3, 0.4]
    assert made == [1, 2, 3, 3, 4]
    assert results([7, 8], 9) == [0.7, 0.8]
    assert results([1, 2, 3, 4], 5) == [0.1, 0.2, 0.3, 0.4]
    assert made == [1, 2, 3, 3, 4, 7, 8]
