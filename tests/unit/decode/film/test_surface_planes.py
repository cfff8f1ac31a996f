"""Pixels of a continuous surface that change their segment."""

from __future__ import annotations

import numpy as np

from metafab.decode.film.surface_planes import continued_surface


def test_pixels_that_move_take_the_depth_of_the_nearest_pixel_of_their_new_segment() -> None:
    row, column = np.mgrid[:6, :9]
    before = np.where(column < 4, 1, 2).astype(np.int32)
    before[0] = 0
    surface = np.where(column < 4, 2.0 + 0.1 * row, 3.0 + 0.01 * row)
    owner = before.copy()
    owner[2:4, 4:6] = 1
    found = continued_surface(surface, before, owner)
    np.testing.assert_allclose(found[2:4, 4:6], [[2.2, 2.2], [2.3, 2.3]])
    found[2:4, 4:6] = surface[2:4, 4:6]
    np.testing.assert_array_equal(found, surface)
    np.testing.assert_array_equal(continued_surface(surface, before, before), surface)
