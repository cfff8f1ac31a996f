"""The build: it finds sharp ridges by few solutions, says honestly what it reached, and survives a kill."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library
from metafab.core.errors import InputError, SolverError
from metafab.library import Library
from metafab.library.fit.size_grid import SizeGrid
from metafab.spec import UnitCell
from tests import library_ridges as ridges


@pytest.fixture(scope="module")
def built(unit_cell: UnitCell) -> Library:
    return library.build(unit_cell, solver=ridges.solve)


def coarse(unit_cell: UnitCell) -> UnitCell:
    return replace(unit_cell, sweep=replace(unit_cell.sweep, size_grid_nm=5.0))


def test_the_target_is_met_at_held_out_sizes_between_the_grid(built: Library, unit_cell: UnitCell) -> None:
    """500 random sizes, ridges of 1 nm half width included, against the closed form itself."""
    width_nm, length_nm = np.random.default_rng(11).uniform(100.0, 250.0, (2, 500))
    true = np.array([ridges.amplitude(w, h) for w, h in zip(width_nm, length_nm, strict=True)])
    held = library.evaluate(built, width_nm, length_nm)
    error = np.abs(held.t_xx - true)
    assert error.max() <= unit_cell.sweep.target_error
    assert np.all(error <= held.error)


def test_few_of_all_sizes_are_solved(built: Library) -> None:
    assert built.statistics.points_total == 76 * 76
    assert built.statistics.points_solved < 0.1 * 76 * 76
    assert built.statistics.held_out >= 16


def test_every_size_of_the_grid_is_within_its_stated_error(built: Library) -> None:
    true = np.array([[ridges.amplitude(w, h) for w in built.width_nm] for h in built.length_nm])
    assert np.all(np.abs(built.t_xx[0] - true) <= built.error[0])
    assert np.all(np.abs(built.t_yy[0] - true.T) <= built.error[0])


def test_exchange_of_x_and_y(built: Library) -> None:
    """A square cell: t_yy(W, L) = t_xx(L, W), by construction, to rounding."""
    assert np.allclose(built.t_yy[0], built.t_xx[0].T, atol=1e-9)


def test_a_cell_that_is_not_square_is_fitted_in_both_polarisations(unit_cell: UnitCell) -> None:
    oblong = replace(coarse(unit_cell), cell=replace(unit_cell.cell, period_nm=(350.0, 352.0)))
    built = library.build(oblong, solver=ridges.solve)
    true = np.array([[ridges.amplitude(w, h) for w in built.width_nm] for h in built.length_nm])
    assert not SizeGrid.of(oblong).exchange
    assert np.all(np.abs(built.t_xx[0] - true) <= built.error[0])
    assert np.all(np.abs(built.t_yy[0] - true.T) <= built.error[0])


def test_any_number_of_workers_gives_the_same_library(unit_cell: UnitCell) -> None:
    cell = coarse(unit_cell)
    one = library.build(cell, solver=ridges.solve)
    with ThreadPoolExecutor(3) as executor:
        three = library.build(cell, solver=ridges.solve, executor=executor)
    for name in ("t_xx", "t_yy", "r_xx", "r_yy", "error"):
        assert np.array_equal(getattr(one, name), getattr(three, name)), name


@pytest.mark.parametrize("is_cut", [True, False])
def test_a_killed_build_goes_on_where_it_stopped(unit_cell: UnitCell, tmp_path: Path, is_cut: bool) -> None:
    cell, checkpoint = coarse(unit_cell), tmp_path / "library.partial"
    whole = library.build(cell, solver=ridges.solve)
    with pytest.raises(SolverError, match="out of lives"):
        library.build(cell, solver=ridges.DyingSolver(101), checkpoint=checkpoint)
    content = checkpoint.read_bytes()
    lines = content.split(b"\n")
    lines[61] = lines[61].replace(b"0.", b"1.", 1)  # the 61st point has another digit
    assert b"\n".join(lines) != content
    checkpoint.write_bytes(content[:-30] if is_cut else b"\n".join(lines))  # a line cut short, as by a power failure
    survivor = ridges.DyingSolver(10_000)
    resumed = library.build(cell, solver=survivor, checkpoint=checkpoint)
    # Small batches are kept size by size: of 101 solved, one is lost, with the cut line.
    assert survivor.calls == whole.statistics.points_solved - (100 if is_cut else 60)
    assert np.array_equal(resumed.t_xx, whole.t_xx)
    assert np.array_equal(resumed.error, whole.error)


def test_a_foreign_checkpoint_is_refused(unit_cell: UnitCell, tmp_path: Path) -> None:
    checkpoint = tmp_path / "library.partial"
    with pytest.raises(SolverError):
        library.build(coarse(unit_cell), solver=ridges.DyingSolver(8), checkpoint=checkpoint)
    with pytest.raises(InputError, match="delete it"):
        library.build(unit_cell, solver=ridges.solve, checkpoint=checkpoint)
    checkpoint.write_text("something else\n")
    with pytest.raises(InputError, match="foreign or damaged"):
        library.build(unit_cell, solver=ridges.solve, checkpoint=checkpoint)


def test_a_poor_certificate_is_visible(unit_cell: UnitCell) -> None:
    built = library.build(coarse(unit_cell), solver=ridges.solve_poorly_in_a_corner)
    assert built.error[0, -1, -1] >= 0.05
    assert built.error[0, 0, 0] < unit_cell.sweep.target_error
    assert built.statistics.sizes_beyond_target >= 1
    assert built.statistics.max_error == built.error.max()


def test_certificates_hold_on_the_flanks_of_ridges_off_the_grid(unit_cell: UnitCell) -> None:
    """A solver whose resonances are all shifted by 0.01 nm: on a flank between two sizes that shows most.

    The ridge of 1 nm half width turns t by up to 0.9 / nm, so the shift costs 1e-2 there and 1e-4 elsewhere: a
    certificate taken over from the sizes beside it, as it is, would be wrong by up to that ratio.
    """
    built = library.build(unit_cell, solver=ridges.solve_shifted)
    width_nm, length_nm = np.random.default_rng(12).uniform(100.0, 250.0, (2, 4000))
    true = np.array([ridges.amplitude(w, h) for w, h in zip(width_nm, length_nm, strict=True)])
    held = library.evaluate(built, width_nm, length_nm)
    error = np.abs(held.t_xx - true)
    assert error.max() > 5e-3
    assert np.all(error <= held.error)
