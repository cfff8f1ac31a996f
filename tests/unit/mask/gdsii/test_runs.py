"""Rings of five points in GDSII elements as rectangles."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.mask.gdsii.runs import rectangles_of


@pytest.mark.parametrize("offset", [0, 2, 20])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("start", range(4))
def test_rings_from_any_corner_in_either_sense(offset: int, start: int, turned: bool) -> None:
    ring = np.roll(np.array([[-5, 3], [7, 3], [7, 9], [-5, 9]]), start, axis=0)[:: -1 if turned else 1]
    whole = np.concatenate([ring, ring[:1]])
    slanted, is_open, flat = whole.copy(), whole.copy(), whole.copy()
    slanted[1] += 1
    is_open[4] += 1
    flat[:, 0] = 2
    rings = np.stack([whole, slanted, is_open, flat])
    elements = np.zeros((4, offset + 44), dtype=np.uint8)
    elements[:, offset : offset + 40] = rings.astype(">i4").view(np.uint8).reshape(4, 40)
    rectangles, is_rectangle = rectangles_of(elements, offset)
    assert is_rectangle.tolist() == [True, False, False, False]
    assert rectangles[0].tolist() == [-5, 3, 12, 6]
