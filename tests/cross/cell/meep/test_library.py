"""A library by the real Meep, and its check by RCWA: two programs, one file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from metafab import library
from metafab.cell.meep import Pool, solver
from metafab.spec import UnitCell
from metafab.spec.cell import Material


@pytest.mark.meep
@pytest.mark.slow
def test_a_library_by_meep_holds_against_rcwa(
    pool: Pool, unit_cell: UnitCell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three distinct sizes of a weak material, whose fields die fast; all walls fit the coarsest family of grids."""
    monkeypatch.setattr(solver, "own_pool", lambda: pool)
    weak = replace(
        unit_cell,
        materials=replace(unit_cell.materials, pillar=Material(n=2.0)),
        sweep=replace(
            unit_cell.sweep, width_nm=(140.0, 210.0), length_nm=(140.0, 210.0), size_grid_nm=70.0, target_error=0.04
        ),
        solver=replace(unit_cell.solver, name="meep"),
    )
    path = tmp_path / "weak.h5"
    built = library.build_file(weak, path)
    assert built.statistics.points_solved == 3
    assert built.error.max() < 0.05
    judged = library.check(library.load(path), against="rcwa", samples=4)
    assert judged.verdict == "holds"
    assert judged.max_abs_error < 1e-2
