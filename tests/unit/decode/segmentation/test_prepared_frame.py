"""Masks of a prepared frame."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.ndimage import binary_dilation

from metafab.decode.segmentation.prepared_frame import PreparedFrame, near_light


@given(lit=arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_images_are_made_sharp_two_pixels_beyond_what_is_lit(lit: np.ndarray) -> None:
    np.testing.assert_array_equal(near_light(lit), binary_dilation(lit, iterations=2))


def test_a_plain_wall_that_fills_the_frame_about_a_small_disc_is_no_object() -> None:
    y, x = np.ogrid[-200:200, -200:200]
    from_middle = np.hypot(y, x)
    wall = from_middle > 16.0
    light = np.stack([np.where(wall, 100.0, 60.0)] * 2)
    core = from_middle > 22.0
    frame: Any = SimpleNamespace(
        outline_reach=6.0, _smooth_cores=core, inner=light, mean=light, lit=np.ones_like(core), plain=wall
    )
    assert not PreparedFrame._about(frame, core).any()
