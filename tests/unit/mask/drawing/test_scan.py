"""Pillars sorted by size, strip and line, and counted by size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from metafab.mask.drawing.scan import Scan, count_sizes, sorted_by_size
from metafab.mask.oasis.records import SCANS

TILES = arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.integers(0, 5))


@given(index=TILES)
def test_sizes_are_counted(index: np.ndarray) -> None:
    assert count_sizes(index, 7).tolist() == [np.count_nonzero(index == size) for size in range(7)]


@given(index=TILES, scan=st.builds(Scan, along_y=st.booleans(), strip_sites=st.integers(1, 50)))
def test_pillars_are_sorted_by_size_strip_and_line(index: np.ndarray, scan: Scan) -> None:
    row, column, end_of = sorted_by_size(index, 6, scan)
    rows, columns = np.nonzero(index)
    along, across = (rows, columns) if scan.along_y else (columns, rows)
    order = np.lexsort((along, across, along // scan.strip_sites, index[rows, columns]))
    assert np.array_equal(row, rows[order])
    assert np.array_equal(column, columns[order])
    assert np.array_equal(np.diff(end_of), np.bincount(index[index > 0], minlength=6)[1:])


@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("shape", [(476, 300), (239, 714), (40, 238)])
def test_every_pillar_of_a_tile_wider_than_a_strip_is_listed_once(shape: tuple[int, int], scan: Scan) -> None:
    """The last strip is narrower."""
    index = np.random.default_rng(7).integers(0, 6, shape).astype(np.uint16)
    row, column, end_of = sorted_by_size(index, 6, scan)
    assert np.array_equal(np.diff(end_of), np.bincount(index.ravel())[1:])
    assert np.array_equal(np.sort(row * shape[1] + column), np.flatnonzero(index))
    assert np.array_equal(index[row, column], np.repeat(np.arange(1, 6), np.diff(end_of)))
