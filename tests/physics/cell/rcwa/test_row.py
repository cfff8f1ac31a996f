"""Rows of unlike pillars by RCWA: what is known of them without another solver."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, rcwa
from metafab.cell.rcwa.row import RowNumerics, row_axis, row_orders, solve_row
from metafab.cell.supercell import Supercell
from metafab.core.errors import InputError
from tests.paper_cell import EMPTY

RAMP = [(120.0, 180.0), (150.0, 150.0), (180.0, 130.0)]
COARSE = RowNumerics((2, 3), (3, 4))


def _row(*sizes: tuple[float, float], cell: PillarCell = EMPTY) -> Supercell:
    return Supercell(cell, np.array([sizes]))


def test_walls_lie_where_the_pillars_have_them() -> None:
    axis = row_axis(350.0, np.array([120.0, 0.0, 350.0, 349.0, 2.0]), 3)
    # Between the constant and itself an indicator is the share that the pillar covers.
    np.testing.assert_allclose(axis.pillars[:, 0, 0].real * 5 * 350.0, [120.0, 0.0, 350.0, 349.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(axis.pillars, axis.pillars.conj().transpose(0, 2, 1), atol=1e-12)
    eigenvalues = np.linalg.eigvalsh(axis.pillars.sum(axis=0))
    assert eigenvalues.min() > -1e-9
    assert eigenvalues.max() < 1.0 + 1e-9


def test_low_orders_are_plane_waves_and_high_ones_nearly() -> None:
    axis = row_axis(350.0, np.array([120.0, 200.0, 150.0, 180.0]), 4)
    np.testing.assert_allclose(axis.wavenumber[:7], 2.0 * np.pi / 1400.0 * axis.order[:7], rtol=2e-3, atol=1e-15)
    np.testing.assert_allclose(np.abs(axis.phase[:7]), 1.0, atol=2e-4)


@pytest.mark.parametrize("polarisation", ["x", "y"])
def test_equal_pillars_are_their_own_local_period(polarisation: str) -> None:
    """The certified cell, beside its resonance for y; the row is as converged as its own error says."""
    found = solve_row(_row(*RAMP[:1] * 3), polarisation, RowNumerics((4, 5), (5, 6)))  # type: ignore[arg-type]
    own = rcwa.solve(replace(EMPTY, width_nm=120.0, length_nm=180.0), CellNumerics(1e-4))
    axis = "xy".index(polarisation)
    zero = found.order[:, 0] == 0
    assert abs(found.co_polarised[zero][0] - own.t[axis, axis]) < min(found.error, 2e-3)
    assert np.abs(found.co_polarised[~zero]).max() < 1e-12
    assert found.coupling_error < min(found.error, 3e-3)


def test_a_pillar_and_a_gap_are_a_cell_of_twice_the_period() -> None:
    """By the solver for single rectangles, which shares neither map nor matrices along x."""
    wide = replace(EMPTY, period_nm=(700.0, 350.0), width_nm=130.0, length_nm=170.0)
    for polarisation, axis in (("x", 0), ("y", 1)):
        found = solve_row(_row((130.0, 170.0), (0.0, 0.0)), polarisation, RowNumerics((5, 6), (5, 6)))  # type: ignore[arg-type]
        own = rcwa.solve(wide, CellNumerics(1e-3))
        zero = int(np.flatnonzero(found.order[:, 0] == 0)[0])
        assert abs(found.co_polarised[zero] - own.t[axis, axis]) < own.error + found.error
        assert found.error < 2e-2


def test_moving_the_row_turns_the_phases_of_its_orders() -> None:
    order = _row(*RAMP).propagating_orders("x")[:, 0]
    here = row_orders(_row(*RAMP), "x", order, 3, 4)
    moved = row_orders(_row(*RAMP[-1:], *RAMP[:-1]), "x", order, 3, 4)
    np.testing.assert_allclose(moved, here * np.exp(-2j * np.pi * order / 3.0), atol=1e-9)


def test_a_mirrored_row_mirrors_its_orders() -> None:
    """And an asymmetric row tells +1 from -1, so that the mirror has something to do."""
    order = _row(*RAMP).propagating_orders("y")[:, 0]
    here = row_orders(_row(*RAMP), "y", order, 3, 4)
    there = row_orders(_row(*RAMP[::-1]), "y", order, 3, 4)
    np.testing.assert_allclose(there, here[::-1], atol=1e-9)
    assert abs(here[0] - here[-1]) > 0.05


def test_a_lossless_row_sends_out_no_more_than_came_in() -> None:
    lossless = replace(EMPTY, n_pillar=3.0 + 0j)
    for polarisation in ("x", "y"):
        found = solve_row(_row(*RAMP, cell=lossless), polarisation, COARSE)  # type: ignore[arg-type]
        assert 0.3 < found.efficiency.sum() < 1.0


def test_closed_films_of_any_cut_are_one_film() -> None:
    film = _row((350.0, 350.0), (350.0, 350.0))
    found = solve_row(film, "x", COARSE)
    own = rcwa.solve(replace(EMPTY, width_nm=350.0, length_nm=350.0), CellNumerics(1e-4))
    zero = found.order[:, 0] == 0
    np.testing.assert_allclose(found.co_polarised[zero], own.t[0, 0], atol=1e-10)
    assert found.error < 1e-10


def test_refinement_settles() -> None:
    order = _row(*RAMP).propagating_orders("x")[:, 0]
    steps = [row_orders(_row(*RAMP), "x", order, m, m + 1) for m in (2, 3, 4, 5)]
    changes = [float(np.abs(b - a).max()) for a, b in pairwise(steps)]
    assert changes[2] < 0.2 * changes[0]
    assert changes[2] < 2e-2


@pytest.mark.parametrize(
    ("supercell", "field"),
    [
        (Supercell(EMPTY, np.full((2, 2, 2), 120.0)), "size_nm"),
        (_row(*RAMP, cell=replace(EMPTY, period_nm=(350.0, 900.0))), "period_nm"),
    ],
)
def test_what_a_row_is_not_is_refused(supercell: Supercell, field: str) -> None:
    with pytest.raises(InputError, match=field):
        solve_row(supercell, "x")
