"""Lens, split lens, grating and axicon against their closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.phase import (
    AxiconPhase,
    GratingPhase,
    LensPhase,
    SplitLensPhase,
)

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
K = 2.0 * math.pi / 0.8


def test_a_lens_equalises_the_optical_paths() -> None:
    x, y = X_UM[None, :], Y_UM[:, None]
    phase = LensPhase(wavelength_um=0.8, image_distance_um=1200.0, object_distance_um=3000.0)(X_UM, Y_UM, "x")
    path = np.sqrt(x**2 + y**2 + 1200.0**2) + np.sqrt(x**2 + y**2 + 3000.0**2) - 4200.0
    # The plain difference of paths has lost eps * 4200 um; times k that is 8e-12 rad.
    np.testing.assert_allclose(phase, -K * path, atol=3e-11)


def test_a_finite_split_lens_focuses_its_object_on_the_tilted_image_sphere() -> None:
    x, y, z_um, s_um, angle = X_UM[None, :], Y_UM[:, None], 3000.0, 1500.0, math.radians(8.0)
    for polarisation, sign in (("x", -1.0), ("y", 1.0)):
        phase = SplitLensPhase(wavelength_um=0.8, image_distance_um=s_um, angle_deg=8.0, object_distance_um=z_um)(
            X_UM, Y_UM, polarisation
        )  # type: ignore[arg-type]
        focus_x, focus_z = sign * s_um * math.sin(angle), s_um * math.cos(angle)
        path = np.sqrt((x - focus_x) ** 2 + y**2 + focus_z**2) + np.sqrt(x**2 + y**2 + z_um**2)
        total = phase + K * path
        np.testing.assert_allclose(total - total[0, 0], 0.0, atol=3e-11)


def test_no_digits_are_lost_near_the_axis_of_a_long_lens() -> None:
    x_um = np.array([1e-3, 0.0, 2e-3])
    phase = LensPhase(wavelength_um=0.8, image_distance_um=1e6)(x_um, np.zeros(1), "x")
    np.testing.assert_allclose(phase[0], -K * x_um**2 / 2e6, rtol=1e-12)


def test_a_grating_and_an_axicon_have_the_slope_of_their_angle() -> None:
    grating = GratingPhase(wavelength_um=0.8, angle_deg=5.0, azimuth_deg=30.0)(X_UM, Y_UM, "x")
    slope = K * math.sin(math.radians(5.0))
    expected = slope * (X_UM[None, :] * math.cos(math.pi / 6) + Y_UM[:, None] * math.sin(math.pi / 6))
    np.testing.assert_allclose(grating, expected, atol=1e-10)
    axicon = AxiconPhase(wavelength_um=0.8, angle_deg=3.0)(X_UM, Y_UM, "y")
    expected = -K * math.sin(math.radians(3.0)) * np.sqrt(X_UM[None, :] ** 2 + Y_UM[:, None] ** 2)
    np.testing.assert_allclose(axicon, expected, atol=1e-10)


@pytest.mark.parametrize("object_um", [math.inf, 3e5])
@pytest.mark.parametrize("sine", [0.0, 0.139, -0.139])
def test_the_compiled_path_is_that_of_numpy(object_um: float, sine: float) -> None:
    """Up to the last digit: the same quotients in another order."""
    x_um, y_um, image_um = np.linspace(-900.0, 1000.0, 37), np.linspace(-1000.0, 700.0, 23), 2e4
    radius_squared = (y_um * y_um)[:, None] + x_um * x_um
    excess = radius_squared + (2.0 * image_um * sine) * x_um
    path_um = excess / (np.sqrt(excess + image_um**2) + image_um)
    if math.isfinite(object_um):
        path_um += radius_squared / (np.sqrt(radius_squared + object_um**2) + object_um)
    phase = SplitLensPhase(
        wavelength_um=0.8,
        image_distance_um=image_um,
        angle_deg=math.degrees(math.asin(sine)),
        object_distance_um=object_um,
    )(x_um, y_um, "x")
    assert phase == pytest.approx(-K * path_um, rel=1e-12)
