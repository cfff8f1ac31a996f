"""Libraries and checks by Meep, with a fake worker in its place: what is asked, what a kill leaves, what is judged."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.cell.meep import Pool, finding, solver
from metafab.cell.meep.pool import FOLDER_VARIABLE
from metafab.core.errors import SolverError
from metafab.core.parallel.executor import open_executor
from metafab.library import Library
from metafab.spec import UnitCell
from tests import library_ridges as ridges
from tests.dask_workers import two_workers

#: Answers every job alike, notes it in ``log``, and dies once at the job that ``fatal`` names.
WORKER = """
import json, os, sys
import numpy as np
folder = sys.argv[1]
for line in sys.stdin:
    message = json.loads(line)
    with open(os.path.join(folder, "log"), "a+") as log:
        log.write(json.dumps(message["job"], sort_keys=True) + "\\n")
        log.seek(0)
        count = len(log.readlines())
    fatal = os.path.join(folder, "fatal")
    if os.path.exists(fatal) and count == int(open(fatal).read()):
        os._exit(9)
    reply = {
        "limit": np.full((2, 1, 1), 0.5 + 0.1j), "incident": np.array([1.0 + 0j, 0.0]),
        "tail": np.array(1e-5), "time": np.array([30.0]),
    }
    np.savez(message["arrays"], **reply)
    print(json.dumps({"id": message["id"], "done": True, "seconds": 0.0}), flush=True)
"""


@pytest.fixture
def small_sweep(unit_cell: UnitCell) -> UnitCell:
    """Nine sizes, six of them distinct, by Meep."""
    sweep = replace(
        unit_cell.sweep, width_nm=(120.0, 160.0), length_nm=(120.0, 160.0), size_grid_nm=20.0, target_error=0.1
    )
    return replace(unit_cell, sweep=sweep, solver=replace(unit_cell.solver, name="meep"))


@pytest.fixture
def fake_pool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Pool]:
    """The pool that ``metafab.cell.solve`` uses, over the fake worker; finished jobs are kept."""
    script = tmp_path / "worker.py"
    script.write_text(WORKER)
    with Pool(1, command=[sys.executable, str(script), str(tmp_path)], keep=tmp_path / "kept") as pool:
        monkeypatch.setattr(solver, "own_pool", lambda: pool)
        yield pool


def _runs(tmp_path: Path) -> list[str]:
    return (tmp_path / "log").read_text().splitlines()


def test_a_unit_cell_that_names_meep_is_built_by_it(small_sweep: UnitCell, fake_pool: Pool, tmp_path: Path) -> None:
    built = library.build(small_sweep)
    assert built.t_xx.shape == (1, 3, 3)
    assert built.details["points_solved"] == 6
    np.testing.assert_array_equal(built.t_xx[0], built.t_yy[0].T)
    runs = _runs(tmp_path)
    assert len(set(runs)) == len(runs), "nothing was run twice"
    # Grids that answer alike although their waves travel differently are far from converged: that is stated.
    assert float(built.details["max_error"]) > 0.05


def test_a_killed_build_goes_on_with_what_was_finished(small_sweep: UnitCell, fake_pool: Pool, tmp_path: Path) -> None:
    (tmp_path / "fatal").write_text("11")
    path = tmp_path / "lib.h5"
    with pytest.raises(SolverError, match="died"):
        library.build_file(small_sweep, path)
    assert not path.exists()
    assert len(_runs(tmp_path)) == 11
    built = library.build_file(small_sweep, path)
    runs = _runs(tmp_path)
    # The job in which the worker died is run again, and no other.
    assert [runs.count(run) for run in dict.fromkeys(runs)].count(2) == 1
    assert len(runs) == len(set(runs)) + 1
    np.testing.assert_array_equal(library.load(path).t_xx, built.t_xx)


@pytest.mark.slow
def test_a_cluster_runs_meep_in_its_own_processes(
    small_sweep: UnitCell, fake_pool: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two processes over Dask, each with a worker of its own, share one folder of finished runs.

    The process that asks keeps its runs elsewhere: what this folder holds, the cluster has run.
    """
    pytest.importorskip("distributed")
    here = library.build(small_sweep)
    runs = _runs(tmp_path)
    interpreter, finished = tmp_path / "python", tmp_path / "finished"
    answer = '{"found": true, "version": "1", "python": "3", "reason": ""}'
    interpreter.write_text(
        f"#!/bin/sh\nif [ \"$3\" = --probe ]; then echo '{answer}'; exit; fi\n"
        f'exec "{sys.executable}" "{tmp_path / "worker.py"}" "{tmp_path}"\n'
    )
    interpreter.chmod(0o755)
    monkeypatch.setenv(finding.VARIABLE, str(interpreter))
    monkeypatch.setenv(FOLDER_VARIABLE, str(finished))
    with (
        two_workers() as cluster,
        open_executor(cluster=cluster.scheduler_address) as executor,
    ):
        there = library.build(small_sweep, executor=executor)
    np.testing.assert_array_equal(there.t_xx, here.t_xx)
    np.testing.assert_array_equal(there.error, here.error)
    assert len(list(finished.glob("*.npz"))) == len(runs)
    # The same runs as here, each of them once.
    assert sorted(_runs(tmp_path)) == sorted(2 * runs)


class _Biased:
    """The library's own values off by ``bias``, with a stated error; remembers what it was asked."""

    def __init__(self, bias: complex, error: float) -> None:
        self.bias, self.error = bias, error
        self.asked: list[CellNumerics] = []

    def __call__(self, cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        self.asked.append(numerics)
        true = ridges.solve(cell, numerics)
        return replace(true, t=true.t + self.bias * np.eye(2), error=self.error)


@pytest.fixture
def stored(smooth_library: Library) -> Library:
    """The ridges at three widths and lengths, too few to go on between them: samples are stored sizes."""
    width_nm, length_nm = smooth_library.width_nm[::30], smooth_library.length_nm[::30]
    t_xx = np.vectorize(ridges.amplitude)(*np.meshgrid(width_nm, length_nm))[None]
    t_yy, error = t_xx.transpose(0, 2, 1), np.full(t_xx.shape, 1e-3)
    return replace(
        smooth_library, width_nm=width_nm, length_nm=length_nm, t_xx=t_xx, t_yy=t_yy, r_xx=t_xx, r_yy=t_yy, error=error
    )


def test_a_check_by_meep_asks_for_what_meep_can_do(stored: Library) -> None:
    judge = _Biased(0.004, 5e-3)
    found = library.check(stored, against="meep", samples=7, solver=judge)
    assert {numerics.solver for numerics in judge.asked} == {"meep"}
    assert {numerics.target_error for numerics in judge.asked} == {1e-2}
    assert (found.samples, len(found.sizes), found.verdict) == (7, 7, "holds")
    assert found.max_abs_error == pytest.approx(0.004)
    assert found.mean_abs_error == pytest.approx(0.004)
    assert (found.max_stated_error, found.max_solver_error) == pytest.approx((1e-3, 5e-3))
    finer = _Biased(0.0, 0.0)
    library.check(stored, against="rcwa", samples=2, solver=finer)
    assert {n.target_error for n in finer.asked} == {0.1 * stored.unit_cell.sweep.target_error}


def test_a_check_names_every_size_and_the_worst(stored: Library) -> None:
    found = library.check(stored, against="meep", samples=9, solver=_Biased(0.02j, 1e-3))
    assert (found.verdict, found.beyond_stated) == ("fails", 9)
    assert all(size.abs_error > size.stated_error + size.solver_error for size in found.sizes)
    worst = max(found.sizes, key=lambda size: size.abs_error)
    assert worst.abs_error == found.max_abs_error
    assert 0.0 < found.mean_phase_error_rad <= found.max_phase_error_rad
    # A bias of 0.02 turns an amplitude of a tenth, the smallest that counts, by 0.2 at most.
    assert found.max_phase_error_rad < 0.21
