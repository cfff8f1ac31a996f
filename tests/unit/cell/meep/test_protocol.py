"""The worker protocol against fake workers that do everything wrong that a program can do."""

from __future__ import annotations

import os
import signal
import textwrap
import threading
import time
from pathlib import Path

import pytest

from metafab.cell.meep.protocol import Worker
from metafab.core.errors import SolverError
from tests.fake_worker import HONEST, Fake, small_job


def test_a_job_goes_out_and_its_arrays_come_back(fake: Fake) -> None:
    seen: list[float] = []
    with Worker(fake(HONEST)) as worker:
        first = worker.run(small_job(6), limit_s=30.0, report=seen.append)
        second = worker.run(small_job(8), limit_s=30.0)
    assert (first["answer"][0], second["answer"][0]) == (6, 8)
    assert first["answer"][1] == second["answer"][1], "one process serves both"
    assert seen == [1.5]
    assert not worker.alive


def test_complex_numbers_travel_as_pairs(fake: Fake) -> None:
    check = "assert job['epsilon_in'][0] == [1.0, 0.0], job['epsilon_in']\nsay(id=name, done=True, seconds=0.0)\n"
    with Worker(fake(check)) as worker:
        worker.run(small_job(), limit_s=30.0)


def test_a_reported_failure_is_quoted_and_the_worker_stays_usable(fake: Fake) -> None:
    behaviour = """
        if job["n_x"] == 2:
            say(id=name, error="RuntimeError: source outside the cell")
        else:
            say(id=name, done=True, seconds=0.0)
    """
    with Worker(fake(behaviour)) as worker:
        with pytest.raises(SolverError, match="source outside the cell"):
            worker.run(small_job(2), limit_s=30.0)
        assert worker.alive
        assert worker.run(small_job(4), limit_s=30.0)["answer"][0] == 4


def test_a_death_in_the_middle_of_a_job_quotes_the_tail_of_stderr(fake: Fake) -> None:
    behaviour = """
        for i in range(40):
            print("line", i, file=sys.stderr, flush=True)
        os._exit(7)
    """
    with Worker(fake(behaviour)) as worker, pytest.raises(SolverError) as error:
        worker.run(small_job(), limit_s=30.0)
    text = str(error.value)
    assert "exit status 7" in text
    assert "line 39" in text
    assert "line 27\n" not in text, "only the tail"
    assert not worker.alive


@pytest.mark.parametrize(
    "garbage",
    ["print('Initializing structure...', flush=True)", "say(id='another', done=True)", "print('[1, 2]', flush=True)"],
)
def test_garbage_on_stdout_is_not_taken_for_an_answer(fake: Fake, garbage: str) -> None:
    with Worker(fake(garbage + "\n" + textwrap.dedent(HONEST))) as worker:
        with pytest.raises(SolverError, match="unexpected answer"):
            worker.run(small_job(), limit_s=30.0)
        assert not worker.alive


def test_arrays_that_cannot_be_read_are_a_failure(fake: Fake) -> None:
    behaviour = "open(arrays, 'wb').write(b'PK no')\nsay(id=name, done=True, seconds=0.0)\n"
    with Worker(fake(behaviour)) as worker, pytest.raises(SolverError, match="arrays cannot be read"):
        worker.run(small_job(), limit_s=30.0)


def _gone(pid: int, wait_s: float = 5.0) -> bool:
    deadline = time.monotonic() + wait_s
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.02)
    return False


def test_a_time_limit_ends_the_worker_and_all_that_it_started(fake: Fake, tmp_path: Path) -> None:
    note = tmp_path / "child"
    behaviour = f"""
        import signal
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        open({str(note)!r}, "w").write(str(child.pid))
        time.sleep(600)
    """
    with Worker(fake(behaviour)) as worker, pytest.raises(SolverError, match="longer than 2 s"):
        worker.run(small_job(), limit_s=2.0)
    assert not worker.alive
    assert _gone(int(note.read_text()))


def test_an_interrupt_leaves_nothing_running(fake: Fake) -> None:
    # Tests that a script runs in the background begin with Ctrl-C ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with Worker(fake("time.sleep(600)\n")) as worker:
            threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                worker.run(small_job(), limit_s=60.0)
            assert not worker.alive
    finally:
        signal.signal(signal.SIGINT, before)
