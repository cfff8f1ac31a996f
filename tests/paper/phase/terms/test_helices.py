"""Eq. 2 of Shen et al., Nature Communications 14, 1035 (2023)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.phase import SpiralZonesPhase
from metafab.phase.terms.helices import zone_charges, zone_radii

WAVELENGTH_UM, RADIUS_UM, FOCAL_UM, ANGLE_DEG, FOCUS_M = 0.8, 1000.0, 20000.0, 8.0, 0.30


def test_zones_of_eq_2() -> None:
    for zones, exponent in ((4, 0.5), (7, 0.5), (3, 1.0), (5, 0.7)):
        np.testing.assert_allclose(zone_radii(zones, exponent)[[0, -1]], [(1 / zones) ** exponent, 1.0], rtol=1e-15)
        for charge in range(1, zones + 1):
            inner, outer = ((charge - 1) / zones) ** exponent, (charge / zones) ** exponent
            inside = np.linspace(inner, outer, 7)[1:-1]
            assert (zone_charges(inside, zones, exponent) == charge).all()


def test_phase_of_eq_2_is_charge_times_azimuth_and_counts_turns_in_each_zone() -> None:
    term = SpiralZonesPhase(zones=4, exponent=0.5, radius_um=RADIUS_UM)
    azimuth = np.linspace(0.0, 2.0 * math.pi, 401)
    for charge in range(1, 5):
        radius_um = RADIUS_UM * math.sqrt((charge - 0.5) / 4)
        x_um, y_um = radius_um * np.cos(azimuth), radius_um * np.sin(azimuth)
        on_circle = np.array([term(x_um[i : i + 1], y_um[i : i + 1], "x")[0, 0] for i in range(azimuth.size)])
        np.testing.assert_allclose(np.exp(1j * on_circle), np.exp(1j * charge * azimuth), atol=1e-12)
        winding = np.angle(np.exp(1j * np.diff(on_circle))).sum() / (2.0 * math.pi)
        assert winding == pytest.approx(charge, abs=1e-9)
