"""Boundaries of a tile: the compiled loop writes the bytes of single elements."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from metafab.mask.gdsii.runs import rectangles_of
from metafab.mask.gdsii.writer import boundary, boundary_template, fill_boundaries
from tests.unit.mask.oasis.test_records import CORNERS, SIZES, TILES


@given(index=TILES, layer=st.integers(0, 255))
def test_boundaries_are_those_of_single_elements(index: np.ndarray, layer: int) -> None:
    words = np.empty((np.count_nonzero(index), 16), dtype=np.int32)
    swapped = boundary_template(layer, 0).byteswap()
    fill_boundaries(index, SIZES, CORNERS, (700, 600), (-350, 90_000_000), swapped, words)
    rows, columns = np.nonzero(index)
    size = index[rows, columns]
    corner = np.stack([-350 + 700 * columns, 90_000_000 + 600 * rows], axis=1) + CORNERS[size]
    rectangles, is_rectangle = rectangles_of(words.view(np.uint8).reshape(-1, 64), 20)
    assert is_rectangle.all()
    assert np.array_equal(rectangles, np.concatenate([corner, SIZES[size]], axis=1))
    for (x, y), (width, length), element in zip(corner.tolist(), SIZES[size].tolist(), words, strict=True):
        ring = np.array([[x, y], [x + width, y], [x + width, y + length], [x, y + length]])
        assert element.tobytes() == boundary(ring, layer, 0).astype(">i4").tobytes()
