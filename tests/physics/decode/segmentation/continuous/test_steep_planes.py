"""Steep planes over a small field, which layers cut into stripes too steep for the cells of larger ones."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.decode.segmentation.continuous import pictures

SHAPE, MIDDLE_M = (160, 128), 0.0029


@pytest.mark.parametrize(("axis", "rise", "seed"), [(1, 0.2, 1), (1, 0.27, 1), (0, 0.27, 2), (1, 0.15, 2)])
def test_a_steep_plane_is_no_stairs(axis: int, rise: float, seed: int) -> None:
    """Flat stripes were 4.0, 1.5 and 5.8 % off, with 76, 96 and 75 % decoded; all four planes are 0.1 to 0.2 % off.

    The slope of the last one is measured along the plane: from the depths of cells it comes out 17 % too steep, and the
    plane is 0.7 % off.
    """
    light = np.exp(0.4 * np.random.default_rng(seed).normal(size=SHAPE))
    across = np.linspace(-0.5, 0.5, SHAPE[axis])
    depth_m = np.broadcast_to(MIDDLE_M / (1.0 - rise * (across[:, None] if axis == 0 else across)), SHAPE)
    psf = pictures.calibration()
    error, _ = pictures.judged(pictures.photographed(light, depth_m, psf), psf)
    assert np.nanmean(error) < 0.004
    assert np.isfinite(error).mean() > 0.98
