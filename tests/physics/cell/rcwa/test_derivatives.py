"""Derivatives by the pillar's sizes against finite differences of the same truncated equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, solve
from metafab.cell.rcwa import RcwaDetails, zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.derivatives import derivatives
from metafab.cell.rcwa.scattering import doubling
from metafab.cell.response import CellResponse
from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError
from tests.paper_cell import SILICON

CELLS = [
    SILICON,
    replace(SILICON, width_nm=230.0, length_nm=230.0, side="ambient"),
    replace(SILICON, n_substrate=(1.7601, 1.7522), period_nm=(350.0, 420.0)),
    replace(SILICON, n_pillar=2.4, height_nm=5_000.0),
    replace(SILICON, n_pillar=0.15 + 3.5j),
]
#: Light along neither axis, in a mirror plane of each, and through an absorbing substrate.
TILTED = [
    replace(SILICON, angle_deg=20.0, azimuth_deg=33.0),
    replace(SILICON, angle_deg=10.0, azimuth_deg=0.0, side="ambient"),
    replace(SILICON, angle_deg=10.0, azimuth_deg=90.0, period_nm=(350.0, 420.0)),
    replace(SILICON, angle_deg=40.0, azimuth_deg=200.0, side="ambient", n_substrate=(1.76 + 0.2j, 1.76 + 0.2j)),
    replace(SILICON, angle_deg=20.0, azimuth_deg=33.0, period_nm=(700.0, 560.0), n_pillar=2.4),
]
#: Steps of the five-point difference; its truncation error is below 1e-10 of the derivative, its rounding error about
#: 1e-12 over the step.
STEPS = {"width_nm": 0.02, "length_nm": 0.02, "height_nm": 0.05, "n_pillar": 2e-4}


def _difference(
    cell: PillarCell, name: str, orders: int, formulation: Formulation
) -> tuple[ComplexArray, ComplexArray]:
    value, step = getattr(cell, name), STEPS[name]
    at = {k: zero_order(replace(cell, **{name: value + k * step}), orders, formulation) for k in (-2, -1, 1, 2)}
    weights = {-2: 1.0, -1: -8.0, 1: 8.0, 2: -1.0}
    t, r = (
        sum(weight * getattr(at[k], which) for k, weight in weights.items()) / (12.0 * step) for which in ("t", "r")
    )
    return np.asarray(t), np.asarray(r)


def _check(cell: PillarCell, orders: int, formulation: Formulation) -> None:
    found = derivatives(cell, orders, formulation)
    value = zero_order(cell, orders, formulation)
    np.testing.assert_allclose(found.t, value.t, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.r, value.r, rtol=0.0, atol=1e-11)
    for i, name in enumerate(STEPS):
        t, r = _difference(cell, name, orders, formulation)
        scale = max(np.abs(t).max(), np.abs(r).max())
        np.testing.assert_allclose(found.d_t[i], t, rtol=0.0, atol=1e-6 * scale, err_msg=name)
        np.testing.assert_allclose(found.d_r[i], r, rtol=0.0, atol=1e-6 * scale, err_msg=name)


@pytest.mark.parametrize("formulation", ["adaptive", "fourier"])
@pytest.mark.parametrize("cell", CELLS, ids=["silicon", "square", "anisotropic", "tall", "metal"])
def test_derivatives_equal_differences(cell: PillarCell, formulation: Formulation) -> None:
    _check(cell, 4, formulation)


@pytest.mark.parametrize("formulation", ["adaptive", "fourier"])
@pytest.mark.parametrize("cell", TILTED, ids=["tilted", "mirror x", "mirror y", "absorbing", "diffracting"])
def test_derivatives_at_an_angle_equal_differences(cell: PillarCell, formulation: Formulation) -> None:
    _check(cell, 3, formulation)


@pytest.mark.parametrize(
    "cell", [*CELLS, TILTED[0]], ids=["silicon", "square", "anisotropic", "tall", "metal", "tilted"]
)
def test_the_reverse_of_doubling_equals_the_modes(cell: PillarCell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding alone tells them apart: amplitudes by either way differ by up to 2e-9."""
    found = derivatives(cell, 4)
    monkeypatch.setattr(doubling, "CONSISTENT", 1e-18)
    modes = derivatives(cell, 4)
    for one, other in ((found.d_t, modes.d_t), (found.d_r, modes.d_r)):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-8 * np.abs(other).max())


@pytest.mark.parametrize("sizes_nm", [(150.0, 220.0), (180.0, 180.0)], ids=["oblong", "square"])
def test_slopes_of_a_certified_solution_are_those_of_its_finest_truncation(sizes_nm: tuple[float, float]) -> None:
    cell = replace(SILICON, width_nm=sizes_nm[0], length_nm=sizes_nm[1])
    solved = solve(cell, CellNumerics(slopes=True))
    d_t, d_r = (each[:2].diagonal(axis1=1, axis2=2) for each in _by_size(cell, solved))
    assert solved.slopes is not None
    # Slopes, the least a sixtieth of the largest one, with the rounding of a thin slab whose modes reach 28 i.
    np.testing.assert_allclose(solved.slopes, np.hstack([d_t, d_r]), rtol=1e-8)
    exchanged = solve(replace(cell, width_nm=sizes_nm[1], length_nm=sizes_nm[0]), CellNumerics(slopes=True))
    np.testing.assert_allclose(exchanged.slopes, solved.exchanged().slopes, rtol=1e-8)


def _by_size(cell: PillarCell, solved: CellResponse) -> tuple[ComplexArray, ComplexArray]:
    assert isinstance(solved.details, RcwaDetails)
    found = derivatives(cell, solved.details.orders_x)
    return found.d_t, found.d_r


def test_cells_without_derivatives_have_no_slopes() -> None:
    """A low pillar of sloped walls, which takes few steps, and one that was not asked for them."""
    low, numerics = replace(SILICON, height_nm=50.0), CellNumerics(target_error=5e-2, slopes=True)
    assert solve(low, numerics).slopes is not None
    assert solve(replace(low, sidewall_angle_deg=88.0), numerics).slopes is None
    assert solve(low, replace(numerics, slopes=False)).slopes is None


def test_derivative_by_index_is_analytic() -> None:
    # d t / d k = i d t / d n for n + i k, by the Cauchy-Riemann equations.
    step = 2e-4
    slope = derivatives(SILICON, 3).d_t[3]
    up, down = (zero_order(replace(SILICON, n_pillar=SILICON.n_pillar + sign * 1j * step), 3).t for sign in (1, -1))
    np.testing.assert_allclose((up - down) / (2.0 * step), 1j * slope, rtol=0.0, atol=1e-4 * np.abs(slope).max())


def test_a_film_grows_as_its_closed_form() -> None:
    # A pillar of the ambient's index is an empty film: t turns by k0 n per nm of height, r stays.
    empty = replace(SILICON, n_pillar=1.0, angle_deg=30.0, azimuth_deg=33.0, side="ambient")
    found = derivatives(empty, 3)
    turn = 2j * np.pi / 800.0 * np.cos(np.radians(30.0))
    np.testing.assert_allclose(found.d_t[2], turn * found.t, rtol=0.0, atol=1e-12)
    # From the ambient r is seen through the film, twice.
    np.testing.assert_allclose(found.d_r[2], 2.0 * turn * found.r, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.d_t[0], 0.0, rtol=0.0, atol=1e-12)


def test_derivatives_need_upright_walls() -> None:
    with pytest.raises(InputError, match="width_nm"):
        derivatives(replace(SILICON, width_nm=350.0), 4)
    with pytest.raises(InputError, match="sidewall_angle_deg"):
        derivatives(replace(SILICON, sidewall_angle_deg=88.0), 4)
