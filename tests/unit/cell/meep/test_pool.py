"""Pools of fake workers: recycling, replacement, and finished jobs on disk."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from metafab.cell.meep import Pool
from metafab.cell.meep.pool import own_folder
from metafab.cell.meep.protocol import Job
from metafab.core.errors import SolverError
from tests.fake_worker import HONEST, Fake, small_job


def test_a_pool_keeps_recycles_and_replaces_its_workers(fake: Fake) -> None:
    behaviour = """
        if job["n_x"] == 2:
            os._exit(1)
        say(id=name, done=True, seconds=0.0)
    """
    with Pool(1, command=fake(behaviour), jobs_per_worker=2) as pool:
        processes = [pool.run(small_job(4))["answer"][1] for _ in range(4)]
        assert processes[0] == processes[1] != processes[2] == processes[3]
        with pytest.raises(SolverError, match="died"):
            pool.run(small_job(2))
        assert pool.run(small_job(4))["answer"][1] != processes[3]


def test_a_pool_runs_on_several_workers_and_ends_them_on_closing(fake: Fake) -> None:
    honest = fake("time.sleep(0.3)\nsay(id=name, done=True, seconds=0.0)\n")
    with Pool(2, command=honest) as pool, ThreadPoolExecutor(4) as threads:
        answers = list(threads.map(lambda n: pool.run(small_job(n))["answer"], [4, 6, 8, 10]))
    assert [answer[0] for answer in answers] == [4, 6, 8, 10]
    assert len({answer[1] for answer in answers}) == 2

    behaviour = """
        if job["n_x"] == 2:
            os._exit(1)
        time.sleep(600)
    """
    start = time.monotonic()
    with ThreadPoolExecutor(1) as thread, Pool(2, command=fake(behaviour)) as pool:
        sleeping = thread.submit(pool.run, small_job(4))
        with pytest.raises(SolverError):
            pool.run(small_job(2))
        pool.close()
        assert isinstance(sleeping.exception(60.0), SolverError)
    assert time.monotonic() - start < 60.0, "nobody waits for the sleeping worker"


def _jobs_run(pool: Pool, folder: Path, *jobs: Job) -> tuple[list[int], int]:
    """The workers' processes that answered, and how many files are kept by then."""
    answers = [int(pool.run(job)["answer"][1]) for job in jobs]
    return answers, len(list(folder.iterdir()))


def test_a_finished_job_is_kept_and_not_run_again(fake: Fake, tmp_path: Path) -> None:
    command, folder = fake(HONEST), tmp_path / "kept"
    with Pool(1, command=command, keep=folder) as pool:
        first, files = _jobs_run(pool, folder, small_job(4), small_job(6), small_job(4))
        assert files == 2
    # A later process has another worker; the answers are those of the first.
    with Pool(1, command=command, keep=folder) as pool:
        again, files = _jobs_run(pool, folder, small_job(4), small_job(6))
        assert len(list(tmp_path.glob("fake_*.py.*"))) == 1, "no worker was started"
        assert again == first[:2]
        new, files = _jobs_run(pool, folder, small_job(8))
    assert files == 3
    assert new[0] not in first
    with Pool(1, command=[*command, "another version"], keep=folder) as pool:
        other, _ = _jobs_run(pool, folder, small_job(4))
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
        before, _ = _jobs_run(pool, folder, small_job(4))
        with pytest.raises(SolverError, match="died"):
            pool.run(small_job(6))
        after, files = _jobs_run(pool, folder, small_job(4), small_job(6))
        assert after[0] == before[0]
        assert files == 2
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[:100])
    with Pool(1, command=command, keep=folder) as pool:
        again, files = _jobs_run(pool, folder, small_job(4))
        assert again[0] != before[0]
        assert files == 2
        assert _jobs_run(pool, folder, small_job(4))[0] == again


def test_where_finished_jobs_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("METAFAB_MEEP_JOBS", str(tmp_path))
    assert own_folder() == tmp_path
    monkeypatch.setenv("METAFAB_MEEP_JOBS", "")
    assert own_folder() is None
    monkeypatch.delenv("METAFAB_MEEP_JOBS")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert own_folder() == tmp_path / "caches" / "metafab" / "meep"
