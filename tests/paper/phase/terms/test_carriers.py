"""Eqs. 3 and 4 of Shen et al., Nature Communications 14, 1035 (2023)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.phase import SplitLensPhase

WAVELENGTH_UM, RADIUS_UM, FOCAL_UM, ANGLE_DEG, FOCUS_M = 0.8, 1000.0, 20000.0, 8.0, 0.30


def test_eqs_3_and_4() -> None:
    x_um, y_um = np.linspace(-1000.0, 1000.0, 41), np.linspace(-900.0, 950.0, 37)
    x, y, sine = x_um[None, :], y_um[:, None], math.sin(math.radians(ANGLE_DEG))
    term = SplitLensPhase(wavelength_um=WAVELENGTH_UM, image_distance_um=FOCAL_UM, angle_deg=ANGLE_DEG)
    for polarisation, sign in (("x", 1.0), ("y", -1.0)):
        root = np.sqrt(x**2 + y**2 + FOCAL_UM**2 + sign * 2.0 * x * FOCAL_UM * sine)
        expected = -2.0 * math.pi / WAVELENGTH_UM * (root - FOCAL_UM)
        # The written difference of 20 mm roots keeps 4e-12 um, times k 3e-11 rad.
        np.testing.assert_allclose(term(x_um, y_um, polarisation), expected, atol=1e-10)  # type: ignore[arg-type]


def test_x_polarised_parallel_light_goes_to_minus_theta() -> None:
    """Stationary phase: a plane wave leaves the centre with transverse slope d psi / dx = k sin(direction)."""
    term = SplitLensPhase(wavelength_um=WAVELENGTH_UM, image_distance_um=FOCAL_UM, angle_deg=ANGLE_DEG)
    x_um = np.array([-0.5, 0.5])
    for polarisation, sign in (("x", -1.0), ("y", 1.0)):
        slope = np.diff(term(x_um, np.zeros(1), polarisation)[0])[0]  # type: ignore[arg-type]
        sine = slope * WAVELENGTH_UM / (2.0 * math.pi)
        assert sine == pytest.approx(sign * math.sin(math.radians(ANGLE_DEG)), rel=1e-9)
