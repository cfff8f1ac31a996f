"""Robust planes about each pixel, on planes, noise and outlines that are known."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.segmentation.continuous.local_planes import smoothed_levels

SHAPE = (50, 60)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
EVEN = np.ones(SHAPE, dtype=np.float32)


@pytest.mark.parametrize("deviation", [1.0, 3.0, 18.0])  # the last one's surroundings are sampled every third pixel
def test_a_plane_stays(deviation: float) -> None:
    plane = 20.0 + 0.15 * ROW - 0.1 * COLUMN
    # The ridge of 1e-3 per squared pixel takes its share of the slopes: less where samples reach farther.
    np.testing.assert_allclose(smoothed_levels(plane, EVEN, deviation, 1.0), plane, atol=3e-3)


def test_noise_falls_and_an_outline_stays() -> None:
    rng = np.random.default_rng(1)
    true = np.where(COLUMN < 30, 10.0 + 0.1 * ROW, 22.0)
    noisy = true + 0.3 * rng.normal(size=SHAPE)
    smooth = smoothed_levels(noisy, EVEN, 4.0, 1.0)
    inside = (ROW > 8) & (ROW < 42)
    # Within 4 pixels, a Gaussian weight holds 4 pi 4^2 = 200 pixels, half as many next to the outline, where the slope
    # across it counts four times: 0.3 sqrt(4 / 100) = 0.06 at most, and 0.02 away from it.
    for distance, most in ((0, 0.08), (10, 0.03)):
        some = inside & (np.abs(COLUMN - 29.5) > distance) & (np.abs(COLUMN - 29.5) < 20)
        assert np.sqrt(np.mean((smooth - true)[some] ** 2)) < most
    assert np.abs(smooth - true).max() < 1.0  # no pixel takes the other side's level


def test_pixels_count_by_their_weight() -> None:
    wrong = (ROW + COLUMN) % 2 == 0
    level = np.where(wrong, 10.8, 10.0)
    weight = np.where(wrong, 1e-3, 1.0).astype(np.float32)
    # Of two equal numbers, the wrong ones hold 1e-3 of the weight.
    assert np.abs(smoothed_levels(level, weight, 3.0, 1.0) - 10.0)[~wrong].max() < 2e-3


def test_a_small_step_stays_where_the_light_changes() -> None:
    # Within the tolerance, no weight of the levels tells the sides apart.
    level, dark, bright = np.where(COLUMN < 30, 10.0, 11.0), np.float32(0.0), np.float32(1.5)
    light = np.where(COLUMN < 30, dark, bright)
    beside = np.abs(COLUMN - 29.5) < 3.0
    blurred, kept = (np.abs(smoothed_levels(level, EVEN, 4.0, 2.0, one) - level) for one in (None, light))
    # The other side weighs 1 / (1 + (1.5 / 0.3)^2) = 1/26 as much.
    assert kept[beside].mean() < 0.2 * blurred[beside].mean()
    even = np.full(SHAPE, bright)
    np.testing.assert_array_equal(smoothed_levels(level, EVEN, 4.0, 2.0, even), smoothed_levels(level, EVEN, 4.0, 2.0))
