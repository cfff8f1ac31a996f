"""Compiled and vectorised encoders write the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from metafab.layout import Lattice, PillarTile
from metafab.mask.drawing.cells import Stamp, count_sizes, tile_cell
from metafab.mask.gdsii.rectangles import rectangles_of, rectangles_vectorised
from metafab.mask.gdsii.writer import boundary_template, fill_boundaries, fill_boundaries_vectorised
from metafab.mask.oasis.records import (
    SCANS,
    Scan,
    best_scan,
    deflate,
    rectangle_records,
    rectangle_records_vectorised,
    sorted_by_size_vectorised,
)

SIZES = np.array([[0, 0], [20, 30], [50, 20], [20, 50], [52, 50], [700, 64]], dtype=np.int64)
# Not centred: what is drawn may be any rectangle about a site.
CORNERS = np.array([[0, 0], [-10, -15], [-25, -10], [-10, 40], [-26, -25], [-350, -32]], dtype=np.int64)
TILES = arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.integers(0, 5))


@given(
    index=TILES.filter(np.any),
    row=st.integers(0, 300),
    periods=st.sampled_from([(700, 700), (700, 600)]),
    scan=st.builds(Scan, along_y=st.booleans(), strip_sites=st.integers(1, 50)),
    absolute=st.booleans(),
)
def test_oasis_records(index: np.ndarray, row: int, periods: tuple[int, int], scan: Scan, absolute: bool) -> None:
    lattice, tile, stamp = Lattice(periods, (400, 400), 0.5), PillarTile(row, 17, index), Stamp(SIZES, CORNERS, 1, 300)
    arguments = (tile, lattice, stamp, tile_cell(lattice, tile, stamp), scan)
    compiled = rectangle_records(*arguments, absolute=absolute)
    assert compiled == rectangle_records_vectorised(*arguments, absolute=absolute)


@given(index=TILES)
def test_sizes_are_counted(index: np.ndarray) -> None:
    assert count_sizes(index, 7).tolist() == [np.count_nonzero(index == size) for size in range(7)]


@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("shape", [(476, 300), (239, 714), (40, 238)])
def test_oasis_records_of_tiles_wider_than_a_strip(shape: tuple[int, int], scan: Scan) -> None:
    """Every pillar must be listed once, the last strip being narrower."""
    index = np.random.default_rng(7).integers(0, 6, shape).astype(np.uint16)
    lattice, tile, stamp = Lattice((700, 600), (800, 800), 0.5), PillarTile(3, 17, index), Stamp(SIZES, CORNERS, 1, 0)
    arguments = (tile, lattice, stamp, tile_cell(lattice, tile, stamp), scan)
    assert rectangle_records(*arguments) == rectangle_records_vectorised(*arguments)
    row, column, end_of = sorted_by_size_vectorised(index, len(SIZES), scan)
    assert np.array_equal(np.diff(end_of), np.bincount(index.ravel())[1:])
    assert np.array_equal(np.sort(row * shape[1] + column), np.flatnonzero(index))
    assert np.array_equal(index[row, column], np.repeat(np.arange(1, 6), np.diff(end_of)))


@pytest.mark.parametrize("centre", [(0, 0), (0, 1900), (1900, 0), (1300, 1300), (2400, 600), (600, 2400)])
def test_the_better_scan_is_found_from_few_sizes(centre: tuple[int, int]) -> None:
    """Tiles of a lens that splits along x; at the last centre the worse of the two scans takes a third more."""
    sizes = np.array([[0, 0], *([200 + 4 * w, 200 + 4 * k] for w in range(40) for k in range(40))], dtype=np.int64)
    row, column = (np.arange(-238, 238) + at for at in centre)
    lens = -7.7e-6 * (column[None, :] ** 2 + row[:, None] ** 2)
    width, length = (np.floor((lens + turn * column) % 1.0 * 40).astype(np.int64) for turn in (0.061, -0.061))
    lattice, stamp = Lattice((700, 700), (5714, 5714), 0.5), Stamp(sizes, -(sizes // 2), 1, 0)
    tile = PillarTile(0, 0, (1 + 40 * width + length).astype(np.uint16))
    arguments = (tile, lattice, stamp, tile_cell(lattice, tile, stamp))
    lengths = {scan: len(deflate(rectangle_records(*arguments, scan))) for scan in SCANS}
    assert lengths[best_scan(*arguments)] < 1.06 * min(lengths.values())


@given(index=TILES, layer=st.integers(0, 255))
def test_gdsii_boundaries(index: np.ndarray, layer: int) -> None:
    arguments = (index, SIZES, CORNERS, (700, 600), (-350, 90_000_000), boundary_template(layer, 0))
    compiled, vectorised = (np.empty((np.count_nonzero(index), 16), dtype=np.int32) for _ in range(2))
    fill_boundaries(*arguments, compiled)
    fill_boundaries_vectorised(*arguments, vectorised)
    assert np.array_equal(compiled, vectorised)
    elements = compiled.view(np.uint8).reshape(-1, 64)
    rectangles, is_rectangle = rectangles_of(elements, 20)
    assert is_rectangle.all()
    rows, columns = np.nonzero(index)
    size = index[rows, columns]
    centre = np.stack([-350 + 700 * columns, 90_000_000 + 600 * rows], axis=1)
    assert np.array_equal(rectangles, np.concatenate([centre + CORNERS[size], SIZES[size]], axis=1))


@pytest.mark.parametrize("read", [rectangles_of, rectangles_vectorised])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("start", range(4))
def test_rings_from_any_corner_in_either_sense(read: Callable[..., Any], start: int, turned: bool) -> None:
    ring = np.roll(np.array([[-5, 3], [7, 3], [7, 9], [-5, 9]]), start, axis=0)[:: -1 if turned else 1]
    whole = np.concatenate([ring, ring[:1]])
    slanted, is_open, flat = whole.copy(), whole.copy(), whole.copy()
    slanted[1] += 1
    is_open[4] += 1
    flat[:, 0] = 2
    rings = np.stack([whole, slanted, is_open, flat])
    rectangles, is_rectangle = read(rings.astype(">i4").view(np.uint8).reshape(4, 40), 0)
    assert is_rectangle.tolist() == [True, False, False, False]
    assert rectangles[0].tolist() == [-5, 3, 12, 6]
