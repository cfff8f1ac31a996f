"""Worker processes that are killed: their work is done again, and a piece that kills every worker is named."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from benchmarks.pipeline.faults import processes_of
from metafab.core.errors import WorkerLostError
from metafab.core.parallel import processes
from metafab.core.parallel.executor import in_order, open_executor, stream
from metafab.core.parallel.forked import shared
from metafab.core.parallel.processes import MOST_LOSSES
from tests.main_job import ROOT

_POOL = """
import threading
import time
from metafab.core.parallel.executor import open_executor
if __name__ == "__main__":
    if {spawned}:
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    with open_executor(2) as executor:
        waits = [executor.submit(time.sleep, 0.01) for _ in range(8)]
        print([wait.result() for wait in waits], flush=True)
        {then}
"""
_FORKED = """
import time
from metafab.core.parallel.forked import shared
def work(item):
    print(item, flush=True)
    time.sleep(60)
if __name__ == "__main__":
    list(shared(work, [1, 2], 2))
"""
_WORK = "[wait.result() for wait in [executor.submit(time.sleep, 60)] * 2]"
PROGRAMS = {
    "spawned, idle": _POOL.format(spawned=True, then="time.sleep(60)"),
    "spawned, at work": _POOL.format(spawned=True, then=_WORK),
    "pool of copies, at work": _POOL.format(spawned=False, then=_WORK),
    "forked": _FORKED,
}


@pytest.fixture(params=[True, False], ids=["forked", "spawned"])
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


@pytest.mark.usefixtures("start")
def test_the_work_of_a_killed_worker_is_done_again(tmp_path: Path) -> None:
    jobs = [(value, tmp_path / "mark") for value in range(12)]
    with open_executor(2) as executor:
        assert list(in_order(executor, _dies_at_first, jobs)) == [value * value for value in range(12)]
        assert (tmp_path / "mark").exists()
        assert executor.submit(_squared, 7).result() == 49


@pytest.mark.usefixtures("start")
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


@pytest.mark.usefixtures("start")
def test_a_stream_stops_at_the_piece_and_leaves_no_process() -> None:
    with pytest.raises(WorkerLostError), open_executor(2) as executor:
        for _ in stream(executor, _dies_at, [5, 5, 5, 5]):
            pass


@pytest.mark.usefixtures("start")
def test_pieces_that_have_not_begun_can_be_cancelled() -> None:
    with open_executor(2) as executor:
        pieces = [executor.submit(time.sleep, 0.2) for _ in range(20)]
        assert pieces[-1].cancel() and pieces[-1].cancelled()
        executor.shutdown(wait=True, cancel_futures=True)
    assert all(piece.done() for piece in pieces)


@pytest.mark.alone
@pytest.mark.usefixtures("start")
@pytest.mark.parametrize("room", [0, 1, 2])
def test_work_goes_on_where_the_system_refuses_processes(room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pool without one of its processes would leave the others, for which this process waits at its end."""
    begin = BaseProcess.start

    def start(process: BaseProcess) -> None:
        if len(multiprocessing.active_children()) >= room:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        begin(process)

    monkeypatch.setattr(BaseProcess, "start", start)
    for call in (lambda: in_order(executor, _squared, range(12)), lambda: shared(_squared, range(12), 3)):
        with open_executor(3) as executor:
            assert list(call()) == [value * value for value in range(12)]
        assert not multiprocessing.active_children()


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS.keys())
def test_no_process_outlives_its_killed_parent(program: str, tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(program)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, env=environment, start_new_session=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.3)
    try:
        assert len(processes_of(process.pid)) > 2
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        end = time.monotonic() + 2.0
        while (left := processes_of(process.pid)) and time.monotonic() < end:
            time.sleep(0.05)
        assert left == []
    finally:
        for pid in processes_of(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.stdout.close()
