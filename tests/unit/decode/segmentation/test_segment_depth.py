"""The interior of a segment, its texture, and the error of its depth."""

from __future__ import annotations

import numpy as np

from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segment_depth import interior, is_textured, with_error_of_straight
from metafab.decode.segmentation.segments import SegmentDepth


def test_texture_at_the_outline_alone_is_none() -> None:
    region = np.zeros((60, 60), dtype=bool)
    region[5:55, 5:55] = True
    outline = region.copy()
    outline[15:45, 15:45] = False
    assert not is_textured(region, outline, 10)
    assert is_textured(region, region, 10)
    assert is_textured(region, outline, 30)  # too small to have an inside


def test_the_inside_of_a_segment_keeps_away_from_other_depths_alone() -> None:
    segment = np.zeros((120, 120), dtype=np.int32)
    segment[10:110, 10:60], segment[10:110, 60:110] = 1, 2
    inner = interior(segment, 1, 1)
    assert inner[10, 10]  # beside darkness
    assert not inner[:, 36:].any()  # 24 pixels from the other depth
    assert inner[10:110, 10:36].all()
    segment[:, :57] = 0  # too narrow for a distance of 24, or of anything
    np.testing.assert_array_equal(interior(segment, 1, 1), segment == 1)


def test_pixels_along_a_straight_line_are_no_independent_samples() -> None:
    rng, mask = np.random.default_rng(1), np.zeros((40, 60), dtype=bool)
    mask[10:22, 5:55] = True
    row, column = np.mgrid[:40, :60]
    depth = SegmentDepth(300.0, 1e-3, 0.99, 1.0, Plane(300.0), float(mask.sum()))

    def error(light: np.ndarray) -> float:
        return with_error_of_straight(depth, light.astype(np.float32), mask, 0.8).relative_error

    texture = 1000.0 + 100.0 * rng.normal(size=mask.shape)
    assert error(texture) == depth.relative_error
    level = 1000.0 + 900.0 * np.tanh((row - 15.5) / 1.5)
    turned = 1000.0 + 900.0 * np.tanh((0.8 * (row - 15.5) + 0.6 * (column - 30.0)) / 1.5)
    # 600 pixels of 0.8 samples; the gradient of a tanh of 1.5 px falls on 4.5 rows: (600 x 0.8 / 4.5)^0.5 = 10.3.
    assert 8e-3 < error(level) < 13e-3
    assert error(turned) > 5e-3
    # Many lines beside each other are many samples.
    stripes = 1000.0 + 900.0 * np.sin(row * 1.1)
    assert error(stripes) < 0.75 * error(level)
