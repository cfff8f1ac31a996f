"""The worker protocol against fake workers that do everything wrong that a program can do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from metafab.cell.meep import Pool, finding
from metafab.cell.meep.pool import own_folder
from metafab.cell.meep.protocol import Job, Worker
from metafab.core.errors import MissingToolError, SolverError

#: Starts a fake worker that behaves like the given lines.
Fake = Callable[[str], list[str]]

_PRELUDE = """
import json, os, subprocess, sys, time
import numpy as np
def say(**message):
    print(json.dumps(message), flush=True)
open(f"{sys.argv[0]}.{os.getpid()}", "w").close()
for line in sys.stdin:
    message = json.loads(line)
    name, job, arrays = message["id"], message["job"], message["arrays"]
    np.savez(arrays, answer=np.array([job["n_x"], os.getpid()]))
"""

_HONEST = """
    say(id=name, progress=1.5)
    say(id=name, done=True, seconds=0.0)
"""


def _job(n_x: int = 2) -> Job:
    one = (1.0 + 0.0j,) * 3
    return Job(
        pixel_um=0.1,
        n_x=n_x,
        n_y=2,
        n_z=40,
        absorber_nodes=8,
        source_node=11,
        monitor_nodes=(14, 28),
        wavelength_um=1.0,
        polarisation="x",
        components=("x",),
        orders=((0, 0),),
        weight=(1.0, 1.0),
        epsilon_in=one,
        blocks=(),
        smooth=False,
        mirrors=(),
        decay=1e-3,
        longest_time=10.0,
    )


@pytest.fixture
def fake(tmp_path: Path) -> Fake:
    """A command that starts a fake worker with this behaviour, indented by four."""

    def write(behaviour: str) -> list[str]:
        script = tmp_path / f"fake_{len(list(tmp_path.iterdir()))}.py"
        script.write_text(_PRELUDE + textwrap.indent(textwrap.dedent(behaviour), "    "))
        return [sys.executable, "-I", str(script)]

    return write


def test_a_job_goes_out_and_its_arrays_come_back(fake: Fake) -> None:
    seen: list[float] = []
    with Worker(fake(_HONEST)) as worker:
        first = worker.run(_job(6), limit_s=30.0, report=seen.append)
        second = worker.run(_job(8), limit_s=30.0)
    assert (first["answer"][0], second["answer"][0]) == (6, 8)
    assert first["answer"][1] == second["answer"][1], "one process serves both"
    assert seen == [1.5]
    assert not worker.alive


def test_complex_numbers_travel_as_pairs(fake: Fake) -> None:
    check = "assert job['epsilon_in'][0] == [1.0, 0.0], job['epsilon_in']\nsay(id=name, done=True, seconds=0.0)\n"
    with Worker(fake(check)) as worker:
        worker.run(_job(), limit_s=30.0)


def test_a_reported_failure_is_quoted_and_the_worker_stays_usable(fake: Fake) -> None:
    behaviour = """
        if job["n_x"] == 2:
            say(id=name, error="RuntimeError: source outside the cell")
        else:
            say(id=name, done=True, seconds=0.0)
    """
    with Worker(fake(behaviour)) as worker:
        with pytest.raises(SolverError, match="source outside the cell"):
            worker.run(_job(2), limit_s=30.0)
        assert worker.alive
        assert worker.run(_job(4), limit_s=30.0)["answer"][0] == 4


def test_a_death_in_the_middle_of_a_job_quotes_the_tail_of_stderr(fake: Fake) -> None:
    behaviour = """
        for i in range(40):
            print("line", i, file=sys.stderr, flush=True)
        os._exit(7)
    """
    with Worker(fake(behaviour)) as worker, pytest.raises(SolverError) as error:
        worker.run(_job(), limit_s=30.0)
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
    with Worker(fake(garbage + "\n" + textwrap.dedent(_HONEST))) as worker:
        with pytest.raises(SolverError, match="it answered with"):
            worker.run(_job(), limit_s=30.0)
        assert not worker.alive


def test_arrays_that_cannot_be_read_are_a_failure(fake: Fake) -> None:
    behaviour = "open(arrays, 'wb').write(b'PK no')\nsay(id=name, done=True, seconds=0.0)\n"
    with Worker(fake(behaviour)) as worker, pytest.raises(SolverError, match="arrays cannot be read"):
        worker.run(_job(), limit_s=30.0)


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
        worker.run(_job(), limit_s=2.0)
    assert not worker.alive
    assert _gone(int(note.read_text()))


def test_an_interrupt_leaves_nothing_running(fake: Fake) -> None:
    # Tests that a script runs in the background begin with Ctrl-C ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with Worker(fake("time.sleep(600)\n")) as worker:
            threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                worker.run(_job(), limit_s=60.0)
            assert not worker.alive
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_environment_of_a_worker_is_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("VIRTUAL_ENV", "/elsewhere")
    environment = finding.clean_environment()
    assert environment["OMP_NUM_THREADS"] == "1"
    assert not {"PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME"} & set(environment)


def test_a_pool_keeps_recycles_and_replaces_its_workers(fake: Fake) -> None:
    behaviour = """
        if job["n_x"] == 2:
            os._exit(1)
        say(id=name, done=True, seconds=0.0)
    """
    with Pool(1, command=fake(behaviour), jobs_per_worker=2) as pool:
        processes = [pool.run(_job(4))["answer"][1] for _ in range(4)]
        assert processes[0] == processes[1] != processes[2] == processes[3]
        with pytest.raises(SolverError, match="died"):
            pool.run(_job(2))
        assert pool.run(_job(4))["answer"][1] != processes[3]


def test_a_pool_runs_on_several_workers_and_ends_them_on_closing(fake: Fake) -> None:
    honest = fake("time.sleep(0.3)\nsay(id=name, done=True, seconds=0.0)\n")
    with Pool(2, command=honest) as pool, ThreadPoolExecutor(4) as threads:
        answers = list(threads.map(lambda n: pool.run(_job(n))["answer"], [4, 6, 8, 10]))
    assert [answer[0] for answer in answers] == [4, 6, 8, 10]
    assert len({answer[1] for answer in answers}) == 2

    behaviour = """
        if job["n_x"] == 2:
            os._exit(1)
        time.sleep(600)
    """
    start = time.monotonic()
    with ThreadPoolExecutor(1) as thread, Pool(2, command=fake(behaviour)) as pool:
        sleeping = thread.submit(pool.run, _job(4))
        with pytest.raises(SolverError):
            pool.run(_job(2))
        pool.close()
        assert isinstance(sleeping.exception(60.0), SolverError)
    assert time.monotonic() - start < 60.0, "nobody waits for the sleeping worker"


def _jobs_run(pool: Pool, folder: Path, *jobs: Job) -> tuple[list[int], int]:
    """The workers' processes that answered, and how many files are kept by then."""
    answers = [int(pool.run(job)["answer"][1]) for job in jobs]
    return answers, len(list(folder.iterdir()))


def test_a_finished_job_is_kept_and_not_run_again(fake: Fake, tmp_path: Path) -> None:
    command, folder = fake(_HONEST), tmp_path / "kept"
    with Pool(1, command=command, keep=folder) as pool:
        first, files = _jobs_run(pool, folder, _job(4), _job(6), _job(4))
        assert files == 2
    # A later process has another worker; the answers are those of the first.
    with Pool(1, command=command, keep=folder) as pool:
        again, files = _jobs_run(pool, folder, _job(4), _job(6))
        assert len(list(tmp_path.glob("fake_*.py.*"))) == 1, "no worker was started"
        assert again == first[:2]
        new, files = _jobs_run(pool, folder, _job(8))
    assert files == 3
    assert new[0] not in first
    with Pool(1, command=[*command, "another version"], keep=folder) as pool:
        other, _ = _jobs_run(pool, folder, _job(4))
    assert other[0] not in {*first, *new}


def test_a_kill_leaves_the_finished_jobs_and_a_damaged_one_is_run_again(fake: Fake, tmp_path: Path) -> None:
    behaviour = """
        if job["n_x"] == 6 and not os.path.exists(sys.argv[0] + ".second"):
            open(sys.argv[0] + ".second", "w").close()
            os._exit(9)
        say(id=name, done=True, seconds=0.0)
    """
    command, folder = fake(behaviour), tmp_path / "kept"
    with Pool(1, command=command, keep=folder) as pool:
        before, _ = _jobs_run(pool, folder, _job(4))
        with pytest.raises(SolverError, match="died"):
            pool.run(_job(6))
        after, files = _jobs_run(pool, folder, _job(4), _job(6))
        assert after[0] == before[0]
        assert files == 2
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[:100])
    with Pool(1, command=command, keep=folder) as pool:
        again, files = _jobs_run(pool, folder, _job(4))
        assert again[0] != before[0]
        assert files == 2
        assert _jobs_run(pool, folder, _job(4))[0] == again


def test_where_finished_jobs_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("METAFAB_MEEP_JOBS", str(tmp_path))
    assert own_folder() == tmp_path
    monkeypatch.setenv("METAFAB_MEEP_JOBS", "")
    assert own_folder() is None
    monkeypatch.delenv("METAFAB_MEEP_JOBS")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert own_folder() == tmp_path / "caches" / "metafab" / "meep"


def _interpreter(tmp_path: Path, meep: str | None) -> Path:
    """A virtual environment in miniature: our Python, with a package of that name, or with none."""
    script = tmp_path / "python"
    lines = ["#!/bin/sh"]
    if meep is None:
        lines.append(f'exec "{sys.executable}" -S "$@"')
    else:
        package = tmp_path / "site"
        package.mkdir()
        (package / "meep.py").write_text(meep)
        # -I would hide PYTHONPATH, which is the point of it: put the package where site.py finds it.
        shim = f"import sys, runpy; sys.path.insert(0, {str(package)!r}); sys.argv = sys.argv[1:]; "
        shim += "runpy.run_path(sys.argv[0], run_name='__main__')"
        lines.append(f'shift\nexec "{sys.executable}" -c "{shim}" "$@"')
    script.write_text("\n".join(lines) + "\n")
    script.chmod(0o755)
    return script


def test_an_impostor_named_meep_is_not_taken(tmp_path: Path) -> None:
    impostor = _interpreter(tmp_path, "__version__ = '0.0.1'\nprint('hello from an unrelated package')\n")
    (candidate,) = finding.find(impostor)
    assert not candidate.found
    assert candidate.version == "0.0.1"
    assert "not the FDTD program" in candidate.reason
    with pytest.raises(MissingToolError, match=r"python3-meep(.|\n)*pymeep(.|\n)*another program"):
        finding.best(impostor)


def test_a_better_impostor_fails_in_vacuum(tmp_path: Path) -> None:
    names = "Simulation PML GaussianSource Medium Mirror Vector3 Source Ex verbosity"
    code = (
        f"class Thing:\n    def __init__(self, *a, **k): pass\nfor name in {names.split()!r}: globals()[name] = Thing\n"
    )
    (candidate,) = finding.find(_interpreter(tmp_path, code))
    assert not candidate.found
    assert "vacuum" in candidate.reason


def test_interpreters_without_meep_say_why(tmp_path: Path) -> None:
    (candidate,) = finding.find(_interpreter(tmp_path, None))
    assert not candidate.found
    assert "meep" in candidate.reason or "numpy" in candidate.reason
    (candidate,) = finding.find(tmp_path / "no_such_python")
    assert candidate.reason == "no such file"


def test_the_variable_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = _interpreter(tmp_path, "raise RuntimeError('broken installation')\n")
    monkeypatch.setenv(finding.VARIABLE, str(named))
    first = finding.find()[0]
    assert first.interpreter == named
    assert "broken installation" in first.reason


def test_a_worker_whose_starter_is_gone_leaves() -> None:
    """The real worker reads stdin to its end, with or without Meep, and then exits."""
    finished = subprocess.run(
        [sys.executable, "-I", str(finding.WORKER)], input="", text=True, capture_output=True, timeout=60, check=False
    )
    assert finished.returncode == 0
    assert finished.stdout == ""
