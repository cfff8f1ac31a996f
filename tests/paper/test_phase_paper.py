"""The phase design of Shen et al., Nature Communications 14, 1035 (2023): Eqs. 2 to 4, +36 % peak, rotation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.phase import Pupil, SpiralZonesPhase, SplitLensPhase, main_lobe, optimise_peak
from metafab.phase.optimise.peak import PeakDesign
from metafab.phase.optimise.rotation import rotation_deg_per_dioptre
from metafab.phase.pupil import pupil_field, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field, zone_charges, zone_radii

WAVELENGTH_UM, RADIUS_UM, FOCAL_UM, ANGLE_DEG, FOCUS_M = 0.8, 1000.0, 20000.0, 8.0, 0.30


@pytest.fixture(scope="module")
def best() -> PeakDesign:
    return optimise_peak(4, 0.5)


def test_zones_of_eq_2() -> None:
    for zones, exponent in ((4, 0.5), (7, 0.5), (3, 1.0), (5, 0.7)):
        np.testing.assert_allclose(zone_radii(zones, exponent)[[0, -1]], [(1 / zones) ** exponent, 1.0], rtol=1e-15)
        for charge in range(1, zones + 1):
            inner, outer = ((charge - 1) / zones) ** exponent, (charge / zones) ** exponent
            inside = np.linspace(inner, outer, 7)[1:-1]
            assert (zone_charges(inside, zones, exponent) == charge).all()


def test_phase_of_eq_2_is_charge_times_azimuth_and_counts_turns_in_each_zone() -> None:
    term = SpiralZonesPhase(4, 0.5, RADIUS_UM)
    azimuth = np.linspace(0.0, 2.0 * math.pi, 401)
    for charge in range(1, 5):
        radius_um = RADIUS_UM * math.sqrt((charge - 0.5) / 4)
        x_um, y_um = radius_um * np.cos(azimuth), radius_um * np.sin(azimuth)
        on_circle = np.array([term(x_um[i : i + 1], y_um[i : i + 1], "x")[0, 0] for i in range(azimuth.size)])
        np.testing.assert_allclose(np.exp(1j * on_circle), np.exp(1j * charge * azimuth), atol=1e-12)
        winding = np.angle(np.exp(1j * np.diff(on_circle))).sum() / (2.0 * math.pi)
        assert winding == pytest.approx(charge, abs=1e-9)


def test_eqs_3_and_4() -> None:
    x_um, y_um = np.linspace(-1000.0, 1000.0, 41), np.linspace(-900.0, 950.0, 37)
    x, y, sine = x_um[None, :], y_um[:, None], math.sin(math.radians(ANGLE_DEG))
    term = SplitLensPhase(WAVELENGTH_UM, FOCAL_UM, ANGLE_DEG)
    for polarisation, sign in (("x", 1.0), ("y", -1.0)):
        root = np.sqrt(x**2 + y**2 + FOCAL_UM**2 + sign * 2.0 * x * FOCAL_UM * sine)
        expected = -2.0 * math.pi / WAVELENGTH_UM * (root - FOCAL_UM)
        # The written difference of 20 mm roots keeps 4e-12 um, times k 3e-11 rad.
        np.testing.assert_allclose(term(x_um, y_um, polarisation), expected, atol=1e-10)  # type: ignore[arg-type]


def test_x_polarised_parallel_light_goes_to_minus_theta() -> None:
    """Stationary phase: a plane wave leaves the centre with transverse slope d psi / dx = k sin(direction)."""
    term = SplitLensPhase(WAVELENGTH_UM, FOCAL_UM, ANGLE_DEG)
    x_um = np.array([-0.5, 0.5])
    for polarisation, sign in (("x", -1.0), ("y", 1.0)):
        slope = np.diff(term(x_um, np.zeros(1), polarisation)[0])[0]  # type: ignore[arg-type]
        sine = slope * WAVELENGTH_UM / (2.0 * math.pi)
        assert sine == pytest.approx(sign * math.sin(math.radians(ANGLE_DEG)), rel=1e-9)


def test_the_iteration_beats_the_papers_gain(best: PeakDesign) -> None:
    assert best.peak_gain >= 1.36
    assert best.bound_fraction > 0.95
    assert (best.target <= 1.0).all()


@pytest.mark.parametrize("optimised", [False, True])
def test_rotation_over_25_to_60_cm(best: PeakDesign, optimised: bool) -> None:
    """Monotonic, counter-clockwise as the object recedes, at -225 / L degrees per dioptre."""
    pupil = Pupil()
    field = pupil_field(best.term(RADIUS_UM), pupil, RADIUS_UM) if optimised else spiral_field(pupil, 4, 0.5)
    depth_m = 1.0 / np.linspace(4.0, 1.0 / 0.6, 36)
    lobe = main_lobe(pupil, field, rim_defocus_rad(depth_m, FOCUS_M, RADIUS_UM, WAVELENGTH_UM), 14.0)
    assert (np.diff(lobe.phi_deg) > 0.0).all()
    rate = np.polyfit(1.0 / depth_m, lobe.phi_deg, 1)[0]
    assert rotation_deg_per_dioptre(4, RADIUS_UM, WAVELENGTH_UM) == pytest.approx(-225.0 / 4, rel=1e-3)
    assert rate == pytest.approx(-225.0 / 4, rel=0.03)
