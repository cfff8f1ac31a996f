"""Builds: their cost, equal bytes by any workers, and builds by Meep with a fake worker in its place."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metafab import library
from metafab.cell.meep import Pool, finding, solver
from metafab.cell.meep.pool import FOLDER_VARIABLE
from metafab.core.errors import InputError, SolverError
from metafab.core.parallel.executor import open_executor
from metafab.library.sweep.build import solver_target, with_target
from metafab.spec import UnitCell
from metafab.spec.cell import Axes, Material
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
    assert built.statistics.points_solved == 6
    np.testing.assert_array_equal(built.t_xx[0], built.t_yy[0].T)
    runs = _runs(tmp_path)
    assert len(set(runs)) == len(runs), "nothing was run twice"
    # Grids that answer alike although their waves travel differently are far from converged: that is stated.
    assert built.statistics.max_error > 0.05


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


def test_the_number_of_cells_is_stated_alone_where_every_size_is_solved(unit_cell: UnitCell) -> None:
    assert library.expected_cells(unit_cell) == (100, 1100)
    small = replace(unit_cell, sweep=replace(unit_cell.sweep, width_nm=(100.0, 104.0), length_nm=(100.0, 104.0)))
    assert library.expected_cells(small) == (6, 6)
    coarse = replace(unit_cell, sweep=replace(unit_cell.sweep, size_grid_nm=5.0))
    assert library.expected_cells(coarse) == (100, 31 * 32 // 2 + 192), "all sizes, and those between them"
    circles = replace(unit_cell, cell=replace(unit_cell.cell, shape="circle"))
    assert library.expected_cells(circles) == (76, 76)
    three = replace(unit_cell, sweep=replace(unit_cell.sweep, length_nm=(150.0, 154.0)))
    assert library.expected_cells(three) == (3 * 76, 3 * 76), "lengths that no model connects"
    # Two sizes and an angle.
    tilted = replace(unit_cell, sweep=replace(unit_cell.sweep, axes=Axes(angle_x_deg=(0.0, 4.0))))
    assert library.expected_cells(tilted) == (100 + 3 * 96, 1100 + 3 * 400)


def test_the_solver_gets_the_share_of_a_model_only_where_there_is_none(unit_cell: UnitCell) -> None:
    """Models need answers of more than a loose target; circles, few sizes and sizes that are all solved need none."""
    assert solver_target(unit_cell) == 1e-3
    loose = with_target(unit_cell, 0.1)
    assert solver_target(loose) == 2e-3
    assert solver_target(replace(loose, solver=replace(loose.solver, name="meep"))) == 0.05
    few = replace(loose, sweep=replace(loose.sweep, size_grid_nm=50.0))
    circles = replace(loose, cell=replace(loose.cell, shape="circle"))
    for cell in (few, circles):
        assert solver_target(cell) == pytest.approx(0.09)
        swept = replace(cell, sweep=replace(cell.sweep, axes=Axes(wavelength_nm=(780.0, 820.0))))
        assert solver_target(swept) == 0.05, "a model of corners is fitted to the same answers"
    assert solver_target(loose, every_size=True) == 0.05


def test_a_loose_library_of_the_real_solver_takes_fewer_sizes_than_a_tight_one(unit_cell: UnitCell) -> None:
    """Noise of the solver would make models disagree: 368 sizes at a solver's target of 5e-3."""
    built = library.build(unit_cell, target_error=1e-2)
    assert built.statistics.points_solved < 200
    assert built.error.max() < 1e-2
    assert library.check(built, samples=8, seed=4).beyond_stated == 0


def test_a_record_that_does_not_cover_the_axis_is_refused_before_any_cell_is_solved(unit_cell: UnitCell) -> None:
    materials = replace(unit_cell.materials, pillar=Material(record="Si/Aspnes"))
    asked = replace(
        unit_cell,
        sweep=replace(unit_cell.sweep, axes=Axes(wavelength_nm=(790.0, 830.0))),
        materials=materials,
    )

    def never(*_: object) -> Any:
        raise AssertionError("a cell was solved")

    with pytest.raises(InputError, match="wavelength_nm"):
        library.build(asked, solver=never)


def test_two_workers_write_the_bytes_of_one(unit_cell: UnitCell, tmp_path: Path) -> None:
    """The real solver over a corner of the sweep, fits beside the workers or after them."""
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 130.0), length_nm=(100.0, 130.0), target_error=1e-2)
    cell = replace(unit_cell, sweep=sweep)
    for workers in (1, 2):
        with open_executor(workers) as executor:
            library.build_file(cell, tmp_path / f"{workers}.h5", executor=executor)
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()
