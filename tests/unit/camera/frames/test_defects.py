"""Dead pixels, rows and columns of photographs are found; images, however noisy, hold none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metafab.camera.frames.defects import dead_pixels, share_below_black
from metafab.core.conventions import FloatArray


def photograph(seed: int, mean_e: float, blur_px: float = 0.7) -> FloatArray:
    """Half dark, half a full-contrast texture as sharp as a lens at its Nyquist rate shows it."""
    rng = np.random.default_rng(seed)
    texture = np.clip(gaussian_filter(rng.exponential(1.0, (120, 160)), blur_px), 0.0, None)
    texture[:, 80:] = 0.0
    return np.asarray(rng.poisson(mean_e * texture) + rng.normal(0.0, 2.0, texture.shape))


@pytest.mark.parametrize("mean_e", [30.0, 300.0, 3000.0, 30000.0])
@pytest.mark.parametrize("blur_px", [0.7, 2.0])
def test_an_image_has_no_dead_pixels(mean_e: float, blur_px: float) -> None:
    for seed in range(3):
        found = dead_pixels(photograph(seed, mean_e, blur_px), 2.0)
        assert not found.where.any() and not found.has_pattern


@pytest.mark.parametrize("noise_e", [2.0, 8.0])
@pytest.mark.parametrize("seed", range(3))
def test_noise_of_dark_areas_is_not_dead_where_no_read_noise_is_stated(noise_e: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    light = np.zeros((120, 160))
    light[:, :80] = photograph(seed, 30.0)[:, :80].clip(0.0)
    frame = light + rng.normal(0.0, noise_e, light.shape)
    found = dead_pixels(frame, 0.0)
    assert not found.where.any() and not found.has_pattern


def test_dead_pixels_of_a_noisy_frame_are_found_where_no_read_noise_is_stated() -> None:
    frame, rng = photograph(2, 3000.0, blur_px=2.0), np.random.default_rng(0)
    row, column = rng.integers(5, 115, 40), rng.integers(5, 75, 40)
    frame[row, column] = -100.0
    assert dead_pixels(frame, 0.0).where[row, column].mean() > 0.9


@pytest.mark.parametrize("photons", [4e4, 4e6, 4e7])
def test_the_dark_rings_of_a_point_are_no_dead_pixels(photons: float) -> None:
    """Nulls of a PSF hold less than a third of the light on both of their sides."""
    y, x = np.mgrid[-40:41, -40:41]
    phase = np.exp(1j * np.arctan2(y, x)) * (np.hypot(x, y) < 24)
    fine = np.abs(np.fft.fftshift(np.fft.fft2(phase, (512, 512)))) ** 2
    irradiance = fine.reshape(128, 4, 128, 4).sum(axis=(1, 3))  # over the pixels
    frame = np.random.default_rng(1).poisson(photons * irradiance / irradiance.sum()) + 0.0
    assert dead_pixels(frame, 2.0).where.sum() <= 4  # the null in the middle of the vortex


@pytest.mark.parametrize("lines", [slice(40, 41), slice(40, 42)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("level", [0.0, -100.0])
def test_dead_rows_and_columns_are_found(lines: slice, axis: int, level: float) -> None:
    frame = photograph(1, 3000.0, blur_px=2.0)
    frame[60] = 0.0  # crosses a dead column
    np.moveaxis(frame, axis, 0)[lines] = level
    expected = np.zeros(frame.shape, dtype=bool)
    np.moveaxis(expected, axis, 0)[lines] = expected[60] = True
    np.testing.assert_array_equal(dead_pixels(frame, 2.0).where, expected)


def test_single_dead_pixels_are_found_in_the_light_alone() -> None:
    frame, rng = photograph(2, 3000.0, blur_px=2.0), np.random.default_rng(0)
    row, column = rng.integers(5, 115, 60), rng.integers(5, 155, 60)
    frame[row, column] = 0.0
    dead = dead_pixels(frame, 2.0).where
    in_light = column < 75
    assert dead[row[in_light], column[in_light]].mean() > 0.9
    assert not dead[row[column > 85], column[column > 85]].any()


def test_a_dead_pixel_one_from_the_border_is_found() -> None:
    frame = photograph(2, 3000.0, blur_px=2.0)
    frame[1, 20] = frame[60, 1] = 0.0
    assert np.argwhere(dead_pixels(frame, 2.0).where).tolist() == [[1, 20], [60, 1]]


@pytest.mark.parametrize("dark", [0.0, 0.15])
@pytest.mark.parametrize("mosaic", [np.s_[::2, ::2], np.s_[1::2]])
def test_mosaics_have_no_dead_pixels(dark: float, mosaic: tuple[slice, ...]) -> None:
    """A colour of a Bayer frame alone, and interlaced rows."""
    frame = photograph(5, 3000.0, blur_px=2.0)
    frame[mosaic] *= dark
    found = dead_pixels(frame, 2.0)
    assert not found.where.any()
    assert found.has_pattern == (dark == 0.0)


def test_values_that_are_none_are_not_called_dead() -> None:
    frame = photograph(3, 3000.0, blur_px=2.0)
    frame[10, 10] = np.nan
    assert not dead_pixels(frame, 2.0).where.any()


def test_a_black_level_that_is_too_high_shows() -> None:
    frame = photograph(4, 3000.0)
    assert share_below_black(frame, 2.0) == 0.0
    assert share_below_black(frame - 100.0, 2.0) > 0.4
