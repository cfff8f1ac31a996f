"""Masks of a prepared frame."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.ndimage import binary_dilation

from metafab.decode.segmentation.prepared_frame import near_light


@given(lit=arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_images_are_made_sharp_two_pixels_beyond_what_is_lit(lit: np.ndarray) -> None:
    np.testing.assert_array_equal(near_light(lit), binary_dilation(lit, iterations=2))
