"""RCWA against closed forms and conservation laws: what must hold whatever the truncation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics
from metafab.cell.fresnel import film_jones
from metafab.cell.rcwa import solve, zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.core.conventions import Side
from tests.paper_cell import LOSSLESS, SILICON

FORMULATIONS: tuple[Formulation, ...] = ("adaptive", "fourier")
#: Rounding of an eigenvalue problem of some 50 unknowns, with resonances of quality up to 100 on top.
ROUNDING = 1e-10


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("side", ["substrate", "ambient"])
@pytest.mark.parametrize("angle", [(0.0, 0.0), (25.0, 0.0), (25.0, 90.0), (25.0, 33.0)])
@pytest.mark.parametrize("size_nm", [0.0, 350.0])
def test_uniform_layers_equal_the_closed_form(
    formulation: Formulation, side: Side, angle: tuple[float, float], size_nm: float
) -> None:
    cell = replace(SILICON, width_nm=size_nm, length_nm=size_nm, side=side, angle_deg=angle[0], azimuth_deg=angle[1])
    solved = zero_order(cell, 3, formulation)
    t, r = film_jones(cell, cell.n_pillar if size_nm else cell.n_ambient)
    np.testing.assert_allclose(solved.t, t, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(solved.r, r, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("size_nm", [(150.0, 210.0), (250.0, 250.0), (145.0, 245.0), (155.0, 185.0), (220.0, 195.0)])
def test_lossless_pillars_conserve_power(formulation: Formulation, size_nm: tuple[float, float]) -> None:
    cell = replace(LOSSLESS, width_nm=size_nm[0], length_nm=size_nm[1])
    solved = zero_order(cell, 5, formulation)
    # Below the first Rayleigh wavelength (350 nm < 800 nm / 1.7601) only the zero orders carry power.
    transmitted = np.abs(np.diag(solved.t)) ** 2 / 1.7601
    reflected = np.abs(np.diag(solved.r)) ** 2
    np.testing.assert_allclose(transmitted + reflected, 1.0, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_transmission_is_reciprocal(formulation: Formulation) -> None:
    up, down = (zero_order(replace(SILICON, side=side), 5, formulation) for side in ("substrate", "ambient"))
    # The Lorentz relation for zero orders along z: n_out t(in -> out) = n_in t(out -> in).
    np.testing.assert_allclose(np.diag(up.t), 1.7601 * np.diag(down.t), rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_turning_the_cell_by_90_degrees_swaps_the_polarisations(formulation: Formulation) -> None:
    one = zero_order(SILICON, 5, formulation)
    other = zero_order(replace(SILICON, width_nm=SILICON.length_nm, length_nm=SILICON.width_nm), 5, formulation)
    np.testing.assert_allclose(one.t, other.t[::-1, ::-1], rtol=0.0, atol=ROUNDING)


def test_a_short_period_gets_as_many_cosines_as_a_long_one() -> None:
    oblong = replace(SILICON, period_nm=(140.0, 350.0), width_nm=60.0)
    for orders in (3, 5):
        # (M + 1)^2 + M^2 unknowns, as in a square cell.
        assert zero_order(oblong, orders).coefficients == (orders + 1) ** 2 + orders**2
    response = solve(oblong, CellNumerics(target_error=1e-2))
    assert response.details.orders_x == response.details.orders_y
    assert response.resolution == (2 * int(response.details.orders_x) + 1) ** 2


def test_the_near_field_is_that_of_all_waves_but_the_zero_order() -> None:
    """Nothing in a uniform layer, the same for both orientations and at every truncation, large beside a resonance."""
    assert zero_order(replace(SILICON, width_nm=0.0, length_nm=0.0), 4).near_field == pytest.approx(0.0, abs=ROUNDING)
    turned = replace(SILICON, width_nm=SILICON.length_nm, length_nm=SILICON.width_nm)
    assert zero_order(turned, 4).near_field == pytest.approx(zero_order(SILICON, 4).near_field, rel=ROUNDING)
    resonant = replace(
        LOSSLESS, period_nm=(400.0, 400.0), width_nm=225.6, length_nm=201.96, height_nm=500.0, n_pillar=3.5,
        n_substrate=(1.46, 1.46), wavelength_nm=850.0,
    )  # fmt: skip
    coarse, fine, aside = (
        zero_order(cell, orders).near_field
        for cell, orders in ((resonant, 6), (resonant, 12), (replace(resonant, wavelength_nm=950.0), 6))
    )
    # At six cosines the resonance lies 0.1 of its width from its place.
    assert fine == pytest.approx(coarse, rel=0.1)
    assert coarse > 50.0 * aside


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 33.0])
def test_oblique_classes_continue_normal_incidence(azimuth_deg: float) -> None:
    # t changes at most linearly with the angle: 1e-6 degrees is 2e-8 of k0, with a slope of order ten.
    tilted = zero_order(replace(SILICON, angle_deg=1e-6, azimuth_deg=azimuth_deg), 4)
    upright = zero_order(SILICON, 4)
    np.testing.assert_allclose(tilted.t, upright.t, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(tilted.r, upright.r, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"height_nm": 5_000.0},
        {"height_nm": 50_000.0},
        {"width_nm": 2.0, "length_nm": 2.0},
        {"width_nm": 350.0},
        {"width_nm": 349.0, "length_nm": 349.0},
        {"period_nm": (800.0 / 1.7601, 800.0 / 1.7601)},
        {"period_nm": (800.0, 800.0)},
        {"period_nm": (350.0, 420.0)},
    ],
)
def test_extreme_lossless_cells_stay_sound(change: dict[str, object]) -> None:
    cell = replace(LOSSLESS, **change)  # type: ignore[arg-type]
    solved = zero_order(cell, 5)
    assert np.isfinite(solved.t).all()
    assert np.isfinite(solved.r).all()
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("angle", [(20.0, 0.0), (20.0, 90.0), (20.0, 40.0)])
@pytest.mark.parametrize("period_nm", [350.0, 600.0])
def test_oblique_light_conserves_power(formulation: Formulation, angle: tuple[float, float], period_nm: float) -> None:
    cell = replace(LOSSLESS, angle_deg=angle[0], azimuth_deg=angle[1], period_nm=(period_nm, period_nm))
    solved = zero_order(cell, 3, formulation)
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("angle", [(0.0, 0.0), (20.0, 0.0), (20.0, 40.0)])
@pytest.mark.parametrize("side", ["substrate", "ambient"])
def test_transmittance_is_all_transmitted_power_without_diffraction(side: Side, angle: tuple[float, float]) -> None:
    cell = replace(SILICON, angle_deg=angle[0], azimuth_deg=angle[1], side=side)
    response = solve(cell, CellNumerics(target_error=1e-2, max_orders=3))
    every_order = [response.details.transmitted_power_x, response.details.transmitted_power_y]
    np.testing.assert_allclose(response.transmittance, every_order, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("n_pillar", [0.036 + 5.6j, 1e-3 + 1e3j, 1e3 + 0j, 0.15 + 3.5j])
@pytest.mark.parametrize("n_substrate", [1.7601 + 0j, 1.7601 + 0.3j])
def test_metals_and_absorbing_substrates_stay_passive(n_pillar: complex, n_substrate: complex) -> None:
    cell = replace(LOSSLESS, n_pillar=n_pillar, n_substrate=(n_substrate, n_substrate), side="ambient")
    solved = zero_order(cell, 5)
    reflected = np.abs(np.diag(solved.r)) ** 2
    transmitted = np.abs(np.diag(solved.t)) ** 2 * n_substrate.real
    assert (reflected + transmitted <= 1.0 + 1e-8).all()
