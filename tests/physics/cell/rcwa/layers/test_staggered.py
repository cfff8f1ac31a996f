"""Hexagonal lattices by RCWA: limits that need no lattice, plain Fourier modes of the whole centred cell, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, rcwa, solve
from metafab.cell.rcwa.jones import distance
from metafab.core.errors import InputError
from tests.plain_modes import transmitted

CELL = PillarCell(
    period_nm=(350.0, 303.0),
    width_nm=150.0,
    length_nm=120.0,
    height_nm=300.0,
    n_pillar=1.6,
    n_substrate=(1.0, 1.0),
    n_ambient=1.0,
    wavelength_nm=800.0,
    is_staggered=True,
)


def _plain_fourier(cell: PillarCell, orders: int) -> np.ndarray:
    """(t_xx, t_yy) by plain Fourier modes of the centred cell of two rows."""
    p, rows = cell.period_nm

    def indicator(m: np.ndarray, n: np.ndarray) -> np.ndarray:
        one = cell.width_nm * cell.length_nm / (2.0 * p * rows) * np.sinc(m * cell.width_nm / p)
        one = one * np.sinc(n * cell.length_nm / (2.0 * rows))
        return np.asarray(one * (1.0 + (-1.0) ** (m * cell.is_staggered + n)))

    most = orders, 2 * orders
    return transmitted((p, 2.0 * rows), most, indicator, cell.n_pillar, cell.height_nm, cell.wavelength_nm)


@pytest.mark.parametrize("width_nm", [150.0, 220.0])  # pillars of neighbouring rows apart, and overlapping along x
def test_plain_fourier_modes_see_the_same_change_where_rows_step_aside(width_nm: float) -> None:
    """The direct rule is off by 0.02 at this truncation, but by nearly the same for both lattices, in one cell."""
    cell = replace(CELL, width_nm=width_nm, wavelength_nm=450.0)
    in_line = replace(cell, is_staggered=False)
    plain = _plain_fourier(cell, 4) - _plain_fourier(in_line, 4)
    answers = [rcwa.zero_order(each, 8) for each in (cell, in_line)]
    change = np.diagonal(answers[0].t - answers[1].t)
    assert np.abs(change).max() > 0.008
    assert np.abs(plain - change).max() < 0.15 * np.abs(change).max()


def test_bars_do_not_know_where_rows_stand() -> None:
    """Pillars as wide as the period are bars along x."""
    cell = replace(CELL, width_nm=350.0, n_pillar=2.5)
    staggered, in_line = (rcwa.zero_order(replace(cell, is_staggered=value), 8) for value in (True, False))
    assert distance(staggered, in_line) < 2e-3


@pytest.mark.parametrize("size_nm", [(100.0, 100.0), (240.0, 200.0)])
def test_the_stated_error_holds_and_power_is_kept(size_nm: tuple[float, float]) -> None:
    """Against the next finer truncations; without loss, power is kept at any of them."""
    cell = replace(CELL, width_nm=size_nm[0], length_nm=size_nm[1], n_pillar=2.4)
    answer = solve(cell, CellNumerics(target_error=2e-2))
    fine = rcwa.zero_order(cell, 9)
    assert answer.error <= 2e-2
    assert distance(answer, fine) <= answer.error
    assert fine.transmitted_power + fine.reflected_power == pytest.approx(1.0, abs=1e-8)


def test_orders_are_those_of_the_hexagonal_lattice() -> None:
    """The first six leave together at a wavelength of sqrt(3)/2 periods."""
    wide, narrow = (replace(CELL, wavelength_nm=w) for w in (300.0, 306.0))
    assert len(rcwa.propagating_orders(wide, (1.0, 1.0))) == 7
    assert len(rcwa.propagating_orders(narrow, (1.0, 1.0))) == 1


def test_what_is_not_treated_is_refused() -> None:
    for changes in ({"angle_deg": 10.0}, {"sidewall_angle_deg": 85.0}):
        with pytest.raises(InputError, match="hexagonal"):
            solve(replace(CELL, **changes))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="hexagonal"):
        solve(CELL, CellNumerics(solver="meep"))


@pytest.mark.parametrize(
    "change", [{"sidewall_angle_deg": 88.0}, {"shape": "ellipse"}, {"corner_radius_nm": 10.0}, {"angle_deg": 3.0}]
)
def test_what_would_be_taken_for_an_upright_rectangle_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError, match="for a hexagonal lattice by RCWA"):
        rcwa.zero_order(replace(CELL, **change), 4)  # type: ignore[arg-type]
