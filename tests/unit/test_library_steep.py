"""Steep places: certificates of sizes that are alike count, and what they cannot vouch for is solved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.cell.rcwa.certificate import ladder
from metafab.core.parallel.executor import open_executor
from metafab.library.fit.certificate import solver_errors
from metafab.library.fit.models import SizeModel
from metafab.library.fit.rational import RationalModel
from metafab.library.fit.sampling import SizeGrid
from metafab.library.sweep import steep
from metafab.spec import UnitCell
from tests import library_ridges as ridges

SPAN = (100.0, 250.0)


def slanted(depth: float) -> SizeModel:
    """A pole ``depth`` beside the real widths, at their middle: |dt/dW| is largest there."""
    numerator = np.array([[1.0, 0.1], [0.0, 0.0], [0.0, 0.0]], dtype=np.complex128)
    model = RationalModel(SPAN, SPAN, (1, 1), depth * numerator, np.array([-1j * depth, 0.0, 1.0]))
    return SizeModel(model, model)


def test_a_size_states_its_own_certificate_and_others_that_of_their_like() -> None:
    """On the flat sides 1e-4 was found, on the ridge 8e-4: sizes between solved ones are told apart by their slope."""
    side = np.linspace(*SPAN, 76)
    grid = SizeGrid(side, side, exchange=False)
    widths = np.array([104.0, 240.0, 176.0, 174.0])
    width_nm, length_nm = (part.ravel() for part in np.meshgrid(widths, np.linspace(100.0, 250.0, 16)))
    sizes_nm = np.stack([width_nm, length_nm])
    error = np.where(np.abs(width_nm - 175.0) < 5.0, 8e-4, 1e-4)
    at, around = solver_errors(grid, sizes_nm, error, slanted(0.1))
    row = int(np.searchsorted(side, 132.0))
    assert at[row, np.searchsorted(side, 176.0)] >= 8e-4
    assert at[row, np.searchsorted(side, 106.0)] < 3e-4
    # Half a step off the size that was solved it is hardly steeper than there.
    assert 8e-4 <= around[row, np.searchsorted(side, 176.0)] < 1.2e-3
    assert at[np.searchsorted(side, 110.0), np.searchsorted(side, 104.0)] == 1e-4


def test_where_only_flat_sizes_were_solved_steep_ones_are_stated_as_much_worse() -> None:
    side = np.linspace(*SPAN, 76)
    grid = SizeGrid(side, side, exchange=False)
    sizes_nm = np.stack([part.ravel() for part in np.meshgrid([104.0, 240.0], np.linspace(100.0, 250.0, 16))])
    at, _ = solver_errors(grid, sizes_nm, np.full(32, 1e-4), slanted(0.1))
    assert at[40, np.searchsorted(side, 176.0)] > 10.0 * at[40, np.searchsorted(side, 110.0)]


def test_steep_places_are_solved_until_the_target_holds_between_the_sizes(
    unit_cell: UnitCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Resonances shifted by 0.5 pm: 7e-4 is certified at the steepest sizes, which few of the others are."""

    def shifted(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        true = ridges.solve(cell, numerics)
        off = ridges.solve(replace(cell, width_nm=cell.width_nm + 5e-4, length_nm=cell.length_nm + 5e-4), numerics)
        return replace(off, cell=cell, error=1.4 * float(np.abs(off.t - true.t).max()) + 1e-6)

    target = unit_cell.sweep.target_error
    built = library.build(unit_cell, solver=shifted)
    assert built.model_error is not None
    assert built.model_error.max() <= target
    width_nm, length_nm = np.random.default_rng(14).uniform(100.0, 250.0, (2, 2000))
    true = np.array([ridges.amplitude(w, h) for w, h in zip(width_nm, length_nm, strict=True)])
    held = built.surface(width_nm, length_nm)
    assert np.all(np.abs(held.t_xx - true) <= held.error)
    monkeypatch.setattr(steep, "MOST_ROUNDS", 0)
    without = library.build(unit_cell, solver=shifted)
    assert without.details["max_between_error"] >= built.details["max_between_error"]


def test_what_a_build_takes_is_foreseen(unit_cell: UnitCell) -> None:
    ahead = library.foresee(unit_cell, 1e-3)
    assert ahead is not None
    assert 0.0 < ahead.seconds[0] < ahead.seconds[1]
    small = replace(unit_cell, sweep=replace(unit_cell.sweep, width_nm=(100.0, 104.0), length_nm=(100.0, 104.0)))
    few = library.foresee(small, 1e-3)
    assert few is not None
    assert few.cells == (6, 6)
    assert library.foresee(replace(unit_cell, solver=replace(unit_cell.solver, name="meep")), 1e-2) is None


def test_two_workers_write_the_bytes_of_one(unit_cell: UnitCell, tmp_path: Path) -> None:
    """The real solver over a corner of the sweep, fits beside the workers or after them."""
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 130.0), length_nm=(100.0, 130.0), target_error=1e-2)
    cell = replace(unit_cell, sweep=sweep)
    for workers in (1, 2):
        with open_executor(workers) as executor:
            library.build_file(cell, tmp_path / f"{workers}.h5", executor=executor)
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()


def test_seven_cosines_are_tried_only_where_nothing_was_measured() -> None:
    """Pillars that six cosines did not serve go on to eight, unless seven are all that may be had."""
    assert ladder(CellNumerics(1e-3), measured=True)[:4] == (4, 6, 8, 9)
    assert ladder(CellNumerics(1e-3))[:4] == (4, 6, 7, 8)
    assert ladder(CellNumerics(1e-3, max_orders=7), measured=True) == (4, 6, 7)
