"""Worker processes that are killed: their work is done again, and a piece that kills every worker is named."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from metafab.core.errors import WorkerLostError
from metafab.core.parallel import processes
from metafab.core.parallel.executor import in_order, open_executor, stream
from metafab.core.parallel.processes import MOST_LOSSES


@pytest.fixture(params=[True, False], ids=["forked", "spawned"], autouse=True)
def start(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of starting workers; the first only where this process has no other threads."""
    if not request.param:
        monkeypatch.setattr(processes, "can_fork", lambda: False)


def _squared(value: int) -> int:
    return value * value


def _dies_at_first(job: tuple[int, Path]) -> int:
    """Kill this worker the first time that a job with a mark file comes."""
    value, mark = job
    if value == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return value * value


def _dies_at(value: int) -> int:
    if value == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return value * value


def test_the_work_of_a_killed_worker_is_done_again(tmp_path: Path) -> None:
    jobs = [(value, tmp_path / "mark") for value in range(12)]
    with open_executor(2) as executor:
        assert list(in_order(executor, _dies_at_first, jobs)) == [value * value for value in range(12)]
        assert (tmp_path / "mark").exists()
        assert executor.submit(_squared, 7).result() == 49


def test_a_piece_that_kills_every_worker_is_named_and_all_others_are_done() -> None:
    done: dict[int, int] = {}
    with open_executor(2) as executor:
        pieces = {value: executor.submit(_dies_at, value) for value in range(10)}
        for value, piece in pieces.items():
            if value == 5:
                with pytest.raises(
                    WorkerLostError, match=r"3 worker processes ended.*_dies_at\(5\).*--workers"
                ) as lost:
                    piece.result()
                assert lost.value.losses == MOST_LOSSES
            else:
                done[value] = piece.result()
    assert done == {value: value * value for value in range(10) if value != 5}


def test_a_stream_stops_at_the_piece_and_leaves_no_process() -> None:
    with pytest.raises(WorkerLostError), open_executor(2) as executor:
        for _ in stream(executor, _dies_at, [5, 5, 5, 5]):
            pass


def test_pieces_that_have_not_begun_can_be_cancelled() -> None:
    with open_executor(2) as executor:
        pieces = [executor.submit(time.sleep, 0.2) for _ in range(20)]
        assert pieces[-1].cancel() and pieces[-1].cancelled()
        executor.shutdown(wait=True, cancel_futures=True)
    assert all(piece.done() for piece in pieces)
