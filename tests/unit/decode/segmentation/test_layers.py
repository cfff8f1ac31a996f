"""Layers of depth, and connected pixels of one layer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_opening
from scipy.special import ndtri

from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.layers import connected_segments, depth_layers, grown, opened


def test_the_mixture_along_an_outline_is_no_segment_of_its_own() -> None:
    layer = np.ones((60, 90), dtype=np.int32)
    layer[:, 45:] = 2
    layer[10:30, 40:50] = 3  # 200 pixels of every second: 800 of the frame, just a window
    lit = np.ones(layer.shape, dtype=bool)
    assert connected_segments(layer, lit, 32, 2).max() == 2
    assert connected_segments(np.where(layer == 3, 3, 0), lit, 32, 2).max() == 1  # by itself it is one


def test_growth_stops_at_its_reach() -> None:
    segment = np.zeros((9, 9), dtype=np.int32)
    segment[4, 4] = 7
    assert (grown(segment, 2.0) > 0).sum() == 13
    assert not grown(np.zeros((9, 9), dtype=np.int32), 2.0).any()


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_opened_masks_are_those_of_scipy(steps: int) -> None:
    mask = np.random.default_rng(steps).random((31, 47)) < 0.93
    given = mask.copy()
    assert (opened(mask, steps) == binary_opening(mask, iterations=steps)).all()
    assert (mask == given).all()


@pytest.mark.parametrize("nearest", [2.9, 2.93, 2.96])
def test_layers_lie_between_the_bins_of_the_histogram(nearest: float) -> None:
    """The bins follow the extreme depths: at their middles, a layer moved by up to half a bin of 0.025 / m."""
    vergence = 2.0 + 0.03 * ndtri((np.arange(3600) + 0.5) / 3600).reshape(60, 60)
    vergence[0, 0] = nearest
    pixels = PixelDepth(vergence, np.full(vergence.shape, 0.003), np.ones(vergence.shape, dtype=bool))
    assert depth_layers(pixels, 0.1)[0] == pytest.approx(2.0, abs=0.003)
