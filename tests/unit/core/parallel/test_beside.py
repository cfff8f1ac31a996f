"""A call in a copy of this process: the same result and the same exception, whatever becomes of the copy."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from metafab.core.parallel.beside import begin_beside

alone = pytest.mark.skipif("threading.active_count() > 1", reason="beside other threads nothing is copied")


@alone
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


@alone
def test_its_failure_is_raised_here() -> None:
    copy = begin_beside(lambda: 1 // 0, workers=2)
    assert copy is not None
    with pytest.raises(ZeroDivisionError):
        copy.result()


@alone
def test_a_call_whose_copy_was_killed_is_done_here() -> None:
    mine = os.getpid()
    copy = begin_beside(lambda: mine if os.getpid() == mine else os.kill(os.getpid(), 9), workers=2)
    assert copy is not None
    assert copy.result() == mine


@alone
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
