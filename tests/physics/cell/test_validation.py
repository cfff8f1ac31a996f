"""Cells at the edge of what can be built or computed: right or refused, never a NaN, never a warning (-W error)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, solve
from metafab.cell.fresnel import film_jones
from metafab.cell.rcwa import zero_order
from metafab.core.errors import InputError
from tests.paper_cell import LOSSLESS

#: Half an ulp in each of some 1e5 operations, on amplitudes of order one.
ROUNDING = 1e-10
QUICK = CellNumerics(target_error=1e-2, max_orders=5)

LOSSLESS_CELLS: dict[str, dict[str, object]] = {
    "5 um tall": {"height_nm": 5e3},
    "50 um tall": {"height_nm": 5e4},
    "a metre tall": {"height_nm": 1e9},
    "no height": {"height_nm": 0.0},
    "an atom high": {"height_nm": 1e-9},
    "2 nm": {"width_nm": 2.0, "length_nm": 2.0},
    "0.01 nm": {"width_nm": 0.01, "length_nm": 0.01},
    "touching along x": {"width_nm": 350.0},
    "touching": {"width_nm": 350.0, "length_nm": 350.0},
    "slits of 0.01 nm": {"width_nm": 349.99, "length_nm": 349.99},
    "anomaly in the substrate": {"period_nm": (800.0 / 1.7601,) * 2},
    "anomaly in the ambient": {"period_nm": (800.0, 800.0)},
    "anomaly on both sides": {"period_nm": (800.0, 800.0), "n_substrate": (1.0, 1.0)},
    "anomaly of the diagonal order": {"period_nm": (800.0 * 2.0**0.5,) * 2},
    "anomaly seen from the ambient": {"period_nm": (800.0, 800.0), "side": "ambient"},
    "critical angle": {"angle_deg": float(np.degrees(np.arcsin(1.0 / 1.7601)))},
    "grazing": {"angle_deg": 89.9},
    "a hundred micrometres apart": {"period_nm": (1e5, 1e5)},
    "a period a thousand times the other": {"period_nm": (350.0, 3.5e5)},
    "radio waves": {"wavelength_nm": 1e12},
    "index of 1000": {"n_pillar": 1e3},
    "index of 1/1000": {"n_pillar": 1e-3},
    "index of 1e-5": {"n_pillar": 1e-5},
    "substrate index of 1e6": {"n_substrate": (1e6, 1e6)},
    "ambient index of 1e-5": {"n_ambient": 1e-5},
}
PASSIVE_CELLS: dict[str, dict[str, object]] = {
    "gold": {"n_pillar": 0.15 + 4.9j},
    "silver": {"n_pillar": 0.036 + 5.6j},
    "nearly perfect metal": {"n_pillar": 1e-3 + 1e3j},
    "perfect to a part in a million": {"n_pillar": 1e-6 + 1e6j},
    "at its surface plasmon": {"n_pillar": 1e-9 + 1.0j},
    "absorbing substrate behind": {"n_substrate": (1.7 + 0.5j,) * 2, "side": "ambient"},
    "metal substrate behind": {"n_substrate": (0.2 + 5.0j,) * 2, "side": "ambient"},
}


def power(cell: PillarCell) -> tuple[np.ndarray, float]:
    """Power in all orders of both sides for x and y polarised light, and what rounding is said to do to amplitudes."""
    solved = zero_order(cell, 5)
    assert np.isfinite(solved.t).all()
    assert np.isfinite(solved.r).all()
    return np.asarray(solved.transmitted_power + solved.reflected_power), solved.conditioning.rounding


@pytest.mark.parametrize("change", LOSSLESS_CELLS.values(), ids=LOSSLESS_CELLS.keys())
def test_lossless_cells_conserve_power(change: dict[str, object]) -> None:
    total, _ = power(replace(LOSSLESS, **change))  # type: ignore[arg-type]
    np.testing.assert_allclose(total, 1.0, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("change", PASSIVE_CELLS.values(), ids=PASSIVE_CELLS.keys())
def test_absorbing_cells_only_absorb(change: dict[str, object]) -> None:
    total, rounding = power(replace(LOSSLESS, **change))  # type: ignore[arg-type]
    # Permittivities of -1e12 leave few digits: rounding shows, and is confessed to (and is in the bound of the answer).
    assert (total <= 1.0 + 2.0 * max(ROUNDING, rounding)).all()
    assert (total > 0.0).all()


@pytest.mark.parametrize("change", [LOSSLESS_CELLS["50 um tall"], *PASSIVE_CELLS.values()])
def test_films_of_such_materials_equal_the_closed_form(change: dict[str, object]) -> None:
    cell = replace(LOSSLESS, width_nm=350.0, length_nm=350.0, **change)  # type: ignore[arg-type]
    solved = zero_order(cell, 3)
    t, r = film_jones(cell, cell.n_pillar)
    # Admittances that differ by |n| are added: as many digits of the smaller are lost.
    tolerance = max(ROUNDING, 1e-15 * abs(cell.n_pillar))
    np.testing.assert_allclose(solved.t, t, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(solved.r, r, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("change", [*LOSSLESS_CELLS.values(), *PASSIVE_CELLS.values()])
def test_what_is_not_known_is_not_claimed(change: dict[str, object]) -> None:
    response = solve(replace(LOSSLESS, **change), QUICK)  # type: ignore[arg-type]
    assert response.error >= 0.0
    assert response.converged == (response.error <= QUICK.target_error)


@pytest.mark.parametrize("name", [name for name in LOSSLESS_CELLS if "anomaly" in name])
def test_an_anomaly_is_the_limit_of_its_surroundings(name: str) -> None:
    cell = replace(LOSSLESS, **LOSSLESS_CELLS[name])  # type: ignore[arg-type]
    exact = zero_order(cell, 4)
    for step in (-1e-12, 1e-12):
        near = zero_order(replace(cell, period_nm=tuple(p * (1.0 + step) for p in cell.period_nm)), 4)  # type: ignore[arg-type]
        # The amplitudes run as the root of the distance, sqrt(2e-12) = 1.4e-6, with slopes of order ten.
        np.testing.assert_allclose(near.t, exact.t, rtol=0.0, atol=1e-4)
        np.testing.assert_allclose(near.r, exact.r, rtol=0.0, atol=1e-4)


def test_a_vanishing_pillar_leaves_the_empty_cell() -> None:
    empty, _ = film_jones(LOSSLESS, 1.0)
    for size_nm in (2.0, 0.2):
        solved = zero_order(replace(LOSSLESS, width_nm=size_nm, length_nm=size_nm), 5)
        # At most the whole pillar's extra optical path, spread over the cell: k0 H fill (eps - 1) / 2.
        most = 2.0 * np.pi / 800.0 * 600.0 * (size_nm / 350.0) ** 2 * (3.6941**2 - 1.0) / 2.0
        departure = np.abs(np.diag(solved.t - empty))
        assert (departure > 0.0).all()
        assert (departure <= most * np.abs(np.diag(empty))).all()


def test_closing_slits_approach_the_closed_film() -> None:
    film, _ = film_jones(LOSSLESS, LOSSLESS.n_pillar)
    apart = [
        np.abs(zero_order(replace(LOSSLESS, width_nm=350.0 - gap, length_nm=350.0 - gap), 6).t - film).max()
        for gap in (1.0, 0.1, 0.01)
    ]
    # A slit across the field counts by its share of the cell, to first order.
    assert apart[0] > 5.0 * apart[1] > 25.0 * apart[2]
    assert apart[2] < 1e-2


@pytest.mark.parametrize(
    "change",
    [
        {"n_pillar": 1e-160},
        {"n_pillar": 1e160},
        {"n_pillar": 1.1e6},
        {"n_substrate": (1e-4, 1e-4), "n_pillar": 1e3},
        {"n_ambient": 3e-7},
        {"n_pillar": 1.0 + 2e6j},
    ],
)
def test_more_than_a_million_to_one_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError, match="a million to one"):
        solve(replace(LOSSLESS, **change), QUICK)  # type: ignore[arg-type]
