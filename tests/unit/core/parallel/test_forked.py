"""Work shared with copies of this process: same results, in order, whoever did them."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

from metafab.core.errors import WorkerLostError
from metafab.core.parallel.forked import shared
from metafab.core.parallel.interrupts import raised_interrupts


def test_results_come_in_order_from_other_processes() -> None:
    captured = {"offset": 10}  # A closure cannot be pickled: nothing but results travels.
    found = list(shared(lambda item: (captured["offset"] + item, os.getpid()), range(7), workers=2))
    assert [value for value, _ in found] == [10, 11, 12, 13, 14, 15, 16]
    if threading.active_count() == 1:
        assert os.getpid() not in {pid for _, pid in found}


def test_copies_leave_interrupts_to_the_parent_and_can_be_ended() -> None:
    numbers = [signal.SIGINT, signal.SIGTERM]
    with raised_interrupts():
        found = list(shared(lambda _: (os.getpid(), [signal.getsignal(number) for number in numbers]), range(2), 2))
    copies = [handlers for pid, handlers in found if pid != os.getpid()]
    assert all(handlers == [signal.SIG_IGN, signal.SIG_DFL] for handlers in copies)
    assert copies or threading.active_count() > 1


@pytest.mark.parametrize("workers", [1, 3])
def test_a_failure_reaches_the_caller(workers: int) -> None:
    with pytest.raises(ZeroDivisionError):
        list(shared(lambda item: 1 // item, [2, 1, 0], workers=workers))


def test_beside_other_threads_nothing_is_copied() -> None:
    """A copy would inherit the locks that the other threads hold."""
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        assert set(shared(lambda item: os.getpid(), range(4), workers=2)) == {os.getpid()}
    finally:
        stop.set()
        thread.join()


def test_files_written_by_copies_are_there(tmp_path: Path) -> None:
    list(shared(lambda item: (tmp_path / str(item)).write_text(str(item)), range(5), workers=2))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "1", "2", "3", "4"]


@pytest.mark.alone
def test_the_work_of_a_killed_process_is_done_again(tmp_path: Path) -> None:
    mark, parent = tmp_path / "killed", os.getpid()

    def squared(value: int) -> int:
        if value == 2 and not mark.exists() and os.getpid() != parent:
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return value * value

    assert list(shared(squared, range(6), workers=2)) == [value * value for value in range(6)]
    assert mark.exists()


@pytest.mark.alone
def test_an_item_that_ends_every_process_is_named() -> None:
    parent = os.getpid()

    def squared(value: int) -> int:
        if value == 2 and os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return value * value

    found: list[int] = []
    with pytest.raises(WorkerLostError, match=r"squared\(2\)"):
        found.extend(shared(squared, range(6), workers=2))
