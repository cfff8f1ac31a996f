"""The sum over a band, on spots whose images at every wavelength are written down."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.optics import Imaging, relative_l2
from metafab.optics.propagation.band import at_wavelength, band_irradiance, padded_px

LENS = Imaging(
    wavelength_um=0.8,
    focal_length_mm=20.0,
    split_angle_deg=8.0,
    sensor_distance_um=21220.0,
    pixel_um=3.45,
    aperture_um=2000.0,
)
WIDTH_NM, WINDOW_PX = 10.0, 40


def _spot(imaging: Imaging, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
    """A band-limited spot that is smallest at 800 nm and turns with the wavelength."""
    detuning = (imaging.wavelength_um - 0.8) / (0.5e-3 * WIDTH_NM)
    size = 11.0 * np.sqrt(1.0 + 0.4 * detuning**2)
    x, y = x_um - 9.0 * np.cos(detuning), y_um - 9.0 * np.sin(detuning)
    return np.asarray(np.exp(-0.5 * (x**2 + y**2) / size**2))


def _images(imaging: Imaging, side_px: int, judge: bool) -> tuple[FloatArray, FloatArray]:
    at = (np.arange(side_px) - side_px // 2) * imaging.pixel_um
    return _spot(imaging, at[None, :], at[:, None])[None], np.zeros(1 if judge else 0)


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.05, -0.03)])
@pytest.mark.parametrize("target", [1e-2, 1e-3, 1e-4, 1e-6])
def test_the_stated_error_bounds_the_true_one(target: float, tangent: tuple[float, float]) -> None:
    """Against 64 Gauss-Legendre wavelengths, each spot drawn where its own image point lies."""
    asked: list[float] = []

    def counted(imaging: Imaging, side_px: int, judge: bool) -> tuple[FloatArray, FloatArray]:
        asked.append(imaging.wavelength_um)
        return _images(imaging, side_px, judge)

    image, error = band_irradiance(counted, LENS, 0, tangent, WIDTH_NM, WINDOW_PX, target)
    at = (np.arange(WINDOW_PX) - WINDOW_PX // 2) * LENS.pixel_um
    truth = np.zeros((WINDOW_PX, WINDOW_PX))
    for node, weight in zip(*np.polynomial.legendre.leggauss(64), strict=True):
        there = at_wavelength(LENS, 0.8 + 0.5e-3 * WIDTH_NM * float(node))
        x, y = np.subtract(there.image_point_um(0, tangent), LENS.image_point_um(0, tangent))
        truth += 0.5 * weight * _spot(there, at[None, :] - x, at[:, None] - y)
    # Spots of 11 um have 1e-8 of their spectrum beyond the pixels' Nyquist frequency, and the edges' fade is far away.
    assert relative_l2(image[0], truth) <= error[0] + 1e-7
    assert error[0] <= target
    assert len(set(asked)) == len(asked)


def test_more_is_computed_only_where_more_is_asked() -> None:
    counts = []
    for target in (1e-2, 1e-3, 1e-5):
        asked = []

        def counted(
            imaging: Imaging, side_px: int, judge: bool, asked: list[float] = asked
        ) -> tuple[FloatArray, FloatArray]:
            asked.append(imaging.wavelength_um)
            return _images(imaging, side_px, judge)

        band_irradiance(counted, LENS, 0, (0.0, 0.0), WIDTH_NM, WINDOW_PX, target)
        counts.append(len(asked))
    assert counts[0] < counts[1] < counts[2] <= 16


def test_the_padded_window_holds_what_a_band_shifts() -> None:
    """10 nm move the image by z sin(theta) / cos^3(theta) / 80 = 38.0 um, 5.5 pixels either way."""
    theta = np.radians(8.0)
    moved_px = 21220.0 * np.sin(theta) / np.cos(theta) ** 3 / 80.0 / 3.45
    assert 64 + moved_px < padded_px(LENS, (0.0, 0.0), WIDTH_NM, 64) < 64 + moved_px + 40
    straight = Imaging(
        wavelength_um=0.8,
        focal_length_mm=20.0,
        split_angle_deg=0.0,
        sensor_distance_um=21220.0,
        pixel_um=3.45,
        aperture_um=2000.0,
    )
    assert padded_px(straight, (0.0, 0.0), WIDTH_NM, 64) < padded_px(LENS, (0.0, 0.0), WIDTH_NM, 64)
