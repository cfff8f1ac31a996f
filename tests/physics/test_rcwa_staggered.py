"""Hexagonal lattices by RCWA: limits that need no lattice, and plain Fourier modes of the whole centred cell."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, rcwa, solve
from metafab.cell.rcwa.jones import distance
from metafab.core.errors import InputError

CELL = PillarCell((350.0, 303.0), 150.0, 120.0, 300.0, 1.6, (1.0, 1.0), 1.0, 800.0, is_staggered=True)


def _plain_fourier(cell: PillarCell, orders: int) -> np.ndarray:
    """(t_xx, t_yy) of a slab in vacuum by the plain direct rule: no symmetry, no stretched axes, no doubling.

    de/dz = i P h and dh/dz = i Q e over exp(i (k_x x + k_y y)), for e = (E_x, E_y), h = (H_y, -H_x).
    """
    p, rows = cell.period_nm
    k0 = 2.0 * math.pi / cell.wavelength_nm
    m, n = (
        axis.ravel() for axis in np.meshgrid(np.arange(-orders, orders + 1), np.arange(-2 * orders, 2 * orders + 1))
    )
    k_x, k_y = (np.diag(2.0 * np.pi * number / length / k0) for number, length in ((m, p), (n, 2.0 * rows)))
    d_m, d_n = m[:, None] - m, n[:, None] - n
    one = cell.width_nm * cell.length_nm / (2.0 * p * rows) * np.sinc(d_m * cell.width_nm / p)
    one = one * np.sinc(d_n * cell.length_nm / (2.0 * rows))
    eps = np.eye(m.size) + (complex(cell.n_pillar) ** 2 - 1.0) * one * (1.0 + (-1.0) ** (d_m * cell.is_staggered + d_n))
    eta, unit = np.linalg.inv(eps), np.eye(m.size)
    to_e = np.block([[unit - k_x @ eta @ k_x, -k_x @ eta @ k_y], [-k_y @ eta @ k_x, unit - k_y @ eta @ k_y]])
    to_h = np.block([[eps - k_y @ k_y, k_y @ k_x], [k_x @ k_y, eps - k_x @ k_x]])
    beta_squared, modes = np.linalg.eig(to_e @ to_h)
    beta = np.sqrt(beta_squared.astype(complex))
    beta = np.where(beta.imag < 0.0, -beta, beta)
    magnetic = to_h @ modes / beta
    free = np.sqrt((1.0 - np.diag(k_x) ** 2 - np.diag(k_y) ** 2).astype(complex))
    outside = np.block([[unit - k_y @ k_y, k_y @ k_x], [k_x @ k_y, unit - k_x @ k_x]]) / np.tile(free, 2)
    decay = np.exp(1j * beta * k0 * cell.height_nm)
    # Unknown: forward modes from the front, backward ones from the end; h = +-(outside) e in vacuum.
    incident = np.zeros((2 * m.size, 2))
    middle = int(np.flatnonzero((m == 0) & (n == 0))[0])
    incident[middle, 0] = incident[m.size + middle, 1] = 1.0
    front = np.hstack([outside @ modes + magnetic, (outside @ modes - magnetic) * decay])
    end = np.hstack([(outside @ modes - magnetic) * decay, outside @ modes + magnetic])
    sent = np.vstack([2.0 * outside @ incident, np.zeros_like(incident)])
    forward, backward = np.split(np.linalg.solve(np.vstack([front, end]), sent), 2)
    leaving = modes @ (decay[:, None] * forward + backward)
    return np.array([leaving[middle, 0], leaving[m.size + middle, 1]])


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
