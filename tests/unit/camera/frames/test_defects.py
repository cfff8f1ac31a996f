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
def test_an_image_has_no_dead_pixels(mean_e: float) -> None:
    found = [int(dead_pixels(photograph(seed, mean_e), 2.0).sum()) for seed in range(3)]
    assert max(found) <= 2e-3 * 120 * 80  # the sharpest black dots


@pytest.mark.parametrize("lines", [slice(40, 41), slice(40, 42)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("level", [0.0, -100.0])
def test_dead_rows_and_columns_are_found(lines: slice, axis: int, level: float) -> None:
    frame = photograph(1, 3000.0, blur_px=2.0)
    np.moveaxis(frame, axis, 0)[lines] = level
    lit = np.zeros(frame.shape, dtype=bool)
    np.moveaxis(lit, axis, 0)[lines] = True
    dead = dead_pixels(frame, 2.0)
    assert dead[~lit].mean() < 1e-3
    lit[:, 80:] = False
    assert dead[lit].mean() > 0.9


def test_single_dead_pixels_are_found_in_the_light_alone() -> None:
    frame, rng = photograph(2, 3000.0, blur_px=2.0), np.random.default_rng(0)
    row, column = rng.integers(5, 115, 60), rng.integers(5, 155, 60)
    frame[row, column] = 0.0
    dead = dead_pixels(frame, 2.0)
    in_light = column < 75
    assert dead[row[in_light], column[in_light]].mean() > 0.9
    assert not dead[row[~in_light & (column > 85)], column[~in_light & (column > 85)]].any()


def test_values_that_are_none_are_not_called_dead() -> None:
    frame = photograph(3, 3000.0, blur_px=2.0)
    frame[10, 10] = np.nan
    assert not dead_pixels(frame, 2.0)[9:12, 9:12].any()


def test_a_black_level_that_is_too_high_shows() -> None:
    frame = photograph(4, 3000.0)
    assert share_below_black(frame, 2.0) == 0.0
    assert share_below_black(frame - 100.0, 2.0) > 0.4
