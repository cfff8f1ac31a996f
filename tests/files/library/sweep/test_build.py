"""Library files as they are made: killed builds go on, builds of the same file do not meet, any workers agree."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library
from metafab.core.parallel.executor import open_executor
from metafab.core.storage.files import file_sha256
from metafab.library import Library
from metafab.spec import UnitCell, canonical_toml
from tests import library_ridges as ridges
from tests.dask_workers import two_workers

ROOT = Path(__file__).parents[4]
#: What stands for the hash of the code, here and in processes: people may edit it while tests run.
CODE = "the code of this test run"
#: A hang, not a slow machine: the tests wait for events, and only a fault lets so much time pass.
HANG_S = 900.0
#: Solves slowly enough to be caught at it: about 10 ms a size.
BUILD = f"""
import sys, time
from pathlib import Path
import metafab.library.library
from metafab import library
from metafab.spec import load_unit_cell
from tests import library_ridges as ridges
metafab.library.library.sources_sha256 = lambda modules, rooms: {CODE!r}
def solve(cell, numerics):
    time.sleep(0.01)
    return ridges.solve(cell, numerics)
library.build_file(load_unit_cell(Path(sys.argv[1])), Path(sys.argv[2]), solver=solve)
"""


@pytest.fixture(autouse=True)
def same_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metafab.library.library.sources_sha256", lambda modules, rooms: CODE)


@pytest.fixture(scope="module")
def coarse(unit_cell: UnitCell) -> UnitCell:
    return replace(unit_cell, sweep=replace(unit_cell.sweep, size_grid_nm=5.0))


@pytest.fixture(scope="module")
def whole(coarse: UnitCell) -> Library:
    return library.build(coarse, solver=ridges.solve)


def same(one: Library, other: Library) -> bool:
    names = ("t_xx", "t_yy", "r_xx", "r_yy", "error")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@contextmanager
def building(unit_cell: UnitCell, path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process of its own that builds a library file with the closed form."""
    spec = path.with_suffix(".toml")
    spec.write_text(canonical_toml(unit_cell))
    process = subprocess.Popen([sys.executable, "-c", BUILD, str(spec), str(path)], cwd=ROOT)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def partial_of(path: Path, lines: int, by: subprocess.Popen[bytes] | None = None) -> Path:
    """The checkpoint beside ``path``, once it holds so many lines; ``by`` writes it and must not end before."""
    end = time.monotonic() + HANG_S
    while time.monotonic() < end and (by is None or by.poll() is None):
        for file in path.parent.glob("*.partial"):
            if file.read_bytes().count(b"\n") >= lines:
                return file
        time.sleep(0.005)
    raise TimeoutError(f"no checkpoint of {lines} lines beside {path}")


def test_a_file_is_what_was_built_and_leaves_nothing_beside(coarse: UnitCell, whole: Library, tmp_path: Path) -> None:
    path = tmp_path / "library.h5"
    built = library.build_file(coarse, path, solver=ridges.solve)
    assert same(built, whole)
    assert same(library.load(path), whole)
    assert [file.name for file in tmp_path.iterdir()] == ["library.h5"]


def test_a_build_killed_outright_loses_only_what_was_in_flight(
    coarse: UnitCell, whole: Library, tmp_path: Path
) -> None:
    path = tmp_path / "library.h5"
    with building(coarse, path) as process:
        partial_of(path, 40, process)
        process.kill()
        process.wait()
    assert not path.exists()
    kept = partial_of(path, 40).read_bytes().count(b"\n") - 1
    survivor = ridges.DyingSolver(10_000)
    resumed = library.build_file(coarse, path, solver=survivor)
    assert same(resumed, whole)
    assert survivor.calls == whole.statistics.points_solved - kept
    assert not list(tmp_path.glob("*.partial"))


def test_the_later_of_two_builds_takes_over_the_file(coarse: UnitCell, whole: Library, tmp_path: Path) -> None:
    path = tmp_path / "library.h5"
    with building(coarse, path) as process:
        partial_of(path, 2, process)
        idle = ridges.DyingSolver(0)  # would raise at its first cell
        taken = library.build_file(coarse, path, solver=idle)
        assert process.wait(HANG_S) == 0
    assert idle.calls == 0
    assert same(taken, whole)
    assert not list(tmp_path.glob("*.partial"))


def test_the_later_build_goes_on_if_the_first_is_killed(coarse: UnitCell, whole: Library, tmp_path: Path) -> None:
    path = tmp_path / "library.h5"
    with building(coarse, path) as first, building(coarse, path) as second:
        partial_of(path, 40, first)
        # Either may hold the checkpoint; whoever is left finishes.
        first.kill()
        first.wait()
        assert second.wait(HANG_S) == 0
    assert same(library.load(path), whole)
    assert not list(tmp_path.glob("*.partial"))


def test_builds_to_other_targets_do_not_meet(coarse: UnitCell, tmp_path: Path) -> None:
    """Another target error is another build: the checkpoint of the first neither blocks nor feeds it."""
    path = tmp_path / "library.h5"
    with building(coarse, path) as process:
        partial_of(path, 40, process)
        process.kill()
        process.wait()
    library.build_file(coarse, path, target_error=1e-2, solver=ridges.solve)
    assert len(list(tmp_path.glob("*.partial"))) == 1
    assert library.load(path).unit_cell.sweep.target_error == 1e-2


@pytest.mark.slow
def test_a_script_without_a_guard_is_told_so_and_does_not_hang(coarse: UnitCell, tmp_path: Path) -> None:
    """Spawned workers run it again, to the checkpoint that their parent holds open: they must not wait for it."""
    (tmp_path / "cell.toml").write_text(canonical_toml(coarse))
    script = tmp_path / "unguarded.py"
    script.write_text(
        "import threading, time\n"
        "from pathlib import Path\n"
        "from metafab import library\n"
        "from metafab.core.parallel import processes\n"
        "from metafab.core.parallel.executor import open_executor\n"
        "from metafab.spec import load_unit_cell\n"
        "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"  # beside it, workers are spawned
        "processes.MOST_LOSSES = 1\n"  # one lost pair of workers tells as much as three
        "with open_executor(2) as executor:\n"
        "    library.build_file(load_unit_cell(Path('cell.toml')), Path('library.h5'), executor=executor)\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, check=False
    )
    assert done.returncode != 0
    assert "__main__" in done.stderr


def test_libraries_of_another_solver_are_not_current(
    coarse: UnitCell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "library.h5"
    library.build_file(coarse, path, solver=ridges.solve)
    assert library.is_current(path, coarse)
    monkeypatch.setattr("metafab.library.library.sources_sha256", lambda modules, rooms: "another")
    assert not library.is_current(path, coarse)


def test_processes_and_clusters_write_the_same_bytes(coarse: UnitCell, tmp_path: Path) -> None:
    """One process, two processes, and a Dask cluster of two processes over the loopback interface."""
    pytest.importorskip("distributed")

    def digest(name: str, executor: Executor) -> str:
        built = library.build_file(coarse, tmp_path / name, solver=ridges.solve, executor=executor)
        assert built.time is not None and built.time.seconds > 0.0
        assert library.load(tmp_path / name).time is None
        return file_sha256(tmp_path / name)

    digests = []
    for workers in (1, 2):
        with open_executor(workers) as executor:
            digests.append(digest(f"{workers}.h5", executor))
    with (
        two_workers() as cluster,
        open_executor(cluster=cluster.scheduler_address) as executor,
    ):
        digests.append(digest("cluster.h5", executor))
    assert len(set(digests)) == 1
