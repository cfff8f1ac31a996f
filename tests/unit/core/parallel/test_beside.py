"""A call in a copy of this process: the same result and the same exception, whatever becomes of the copy."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from metafab.core.parallel.beside import begin_beside


@pytest.mark.alone
def test_a_call_runs_while_this_process_goes_on(tmp_path: Path) -> None:
    seen = tmp_path / "seen"

    def call() -> int:
        while not seen.exists():  # written by this process after the call has begun
            time.sleep(0.01)
        return os.getpid()

    copy = begin_beside(call, workers=2)
    assert copy is not None
    seen.touch()
    assert copy.result() != os.getpid()


class UncopiedError(Exception):
    """An exception that cannot be made again from its message."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def _failing() -> None:
    raise UncopiedError("of two ", "parts")


@pytest.mark.alone
def test_its_failure_is_raised_here_with_its_own_place() -> None:
    copy = begin_beside(_failing, workers=2)
    assert copy is not None
    with pytest.raises(UncopiedError, match="of two parts") as failure:
        copy.result()
    assert failure.traceback[-1].name == "_failing"


@pytest.mark.alone
def test_a_call_whose_copy_was_killed_is_done_here() -> None:
    mine = os.getpid()
    copy = begin_beside(lambda: mine if os.getpid() == mine else os.kill(os.getpid(), 9), workers=2)
    assert copy is not None
    assert copy.result() == mine


@pytest.mark.alone
def test_a_copy_that_is_killed_within_its_answer_is_no_answer() -> None:
    answer = bytes(1 << 20)  # more than a pipe holds
    copy = begin_beside(lambda: answer, workers=2)
    assert copy is not None
    assert copy._answers.poll(60.0)
    copy._process.kill()
    copy._process.join()
    assert copy.result() is answer


@pytest.mark.alone
def test_a_copy_that_is_not_needed_ends_at_once() -> None:
    copy = begin_beside(lambda: time.sleep(600.0), workers=2)
    assert copy is not None
    began_s = time.monotonic()
    copy.kill()
    assert time.monotonic() - began_s < 60.0


def test_one_worker_copies_nothing() -> None:
    assert begin_beside(os.getpid, workers=1) is None


def test_beside_other_threads_nothing_is_copied() -> None:
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        assert begin_beside(os.getpid, workers=2) is None
    finally:
        stop.set()
        thread.join()
