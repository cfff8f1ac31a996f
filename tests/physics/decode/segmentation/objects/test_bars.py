"""Bars narrower than a window before a wall: found along their length with an honest error, or left without depth."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.spec import SceneObject
from tests.physics.decode.segmentation.objects.test_small_objects import WALL_M, decoded, errors_of

#: 5 x 140 px; the PSF is 12 px wide.
SIZE = (0.012, 0.34)


@pytest.mark.parametrize("contrast", [1.0, 2.0])
def test_a_bar_is_found_at_its_depth(contrast: float) -> None:
    """Of a contrast of 2, the product of the twins is negative along the bar; without its segment it had no depth."""
    image, frame = decoded(SceneObject(depth_m=0.0027, size=SIZE, polarisation_contrast=contrast))
    errors, wall = errors_of(image, frame, 2), errors_of(image, frame, 1)
    bar = max((one for one in image.segments if one.depth_m < 0.0031), key=lambda one: one.pixels)
    assert np.isfinite(errors).mean() > 0.6
    # Measured: 0.2 to 2.2 % in twelve draws, 0.6 to 3.8 % stated. In this one, a segment as wide as a window mixed the
    # depths of bar and wall, 6 % off with 0.5 % stated.
    assert abs(np.nanmedian(errors)) < min(1.3 * bar.error_m / bar.depth_m, 0.04)
    claimed_as_wall = np.abs((1.0 + errors) * 0.0027 / WALL_M - 1.0) < 0.05
    assert claimed_as_wall.mean() < 0.1
    # The bar's segment is no wider than its light: pixels of the wall that took its depth were 4 % and more.
    assert (np.abs(wall) > 0.05).mean() < 0.015


def test_a_stripe_of_another_contrast_on_the_wall_is_no_bar() -> None:
    image, frame = decoded(SceneObject(depth_m=0.9999 * WALL_M, size=SIZE, polarisation_contrast=2.0))
    assert all(abs(one.depth_m / WALL_M - 1.0) < 0.02 for one in image.segments)
    assert np.nanmax(np.abs(errors_of(image, frame, 1))) < 0.02
