"""Gaps between neighbouring pillars of a block of sites: beside, above and across both diagonals.

Pillars no larger than their cells can only come too close to one of their nearest neighbours (eight, or six on a
hexagonal lattice), provided that the smallest gap allowed does not exceed the pitch of the sites;
:func:`smallest_gap` looks at each pair once. The gap of a diagonal pair is the distance of their nearest corners; of
other outlines than rectangles that of the true curves, and their boxes only tell which pairs need not be looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.layout.outlines import RECTANGLE, Outline, distance
from metafab.layout.pillars import Lattice, SizeIndexArray

#: Pairs below the limit that are listed; all are counted.
LISTED = 1000


@dataclass(frozen=True)
class Gaps:
    """What :func:`smallest_gap` found.

    Attributes:
        smallest_dbu: smallest distance of two neighbours; infinity without any pair; negative where they overlap.
        below: pairs below the limit.
        overlapping: pairs that overlap or touch, a part of those below.
        too_small: shape (m,), flat index of the first site of the first :data:`LISTED` pairs below the limit.
        neighbour: shape (m,), which of the lattice's ``pairs`` it is.
    """

    smallest_dbu: float
    below: int
    overlapping: int
    too_small: NDArray[np.int64]
    neighbour: NDArray[np.int64]


def smallest_gap(
    size_index: SizeIndexArray,
    size_dbu: NDArray[np.int32],
    lattice: Lattice,
    limit_dbu: float = 0.0,
    rows: int | None = None,
    outline: Outline = RECTANGLE,
) -> Gaps:
    """Gaps of all pairs of neighbours in a block.

    Args:
        size_index: shape (n_y, n_x), 0 for no pillar.
        size_dbu: shape (n_sizes + 1, 2).
        lattice: for its periods and its pairs of neighbours.
        limit_dbu: pairs below it are counted and listed.
        rows: pairs whose first site lies in these first rows only; the others are neighbours. All unless given.
        outline: of the pillars.
    """
    rows = size_index.shape[0] if rows is None else rows
    if not HAS_NUMBA and outline.is_rectangle:
        return smallest_gap_vectorised(size_index, size_dbu, lattice, limit_dbu, rows)
    found = np.empty((LISTED, 2), dtype=np.int64)
    block, size, limit_square = (
        np.ascontiguousarray(size_index),
        size_dbu.astype(np.float64),
        limit_dbu * abs(limit_dbu),
    )
    pairs, centres = np.array(lattice.pairs), centre_distances(lattice)
    if outline.is_rectangle:
        square = float(_smallest_square(block, size, pairs, centres, rows))
        below, overlapping = 0, 0
        if square < limit_square:
            below, overlapping = _list_below(block, size, pairs, centres, limit_square, rows, found)
    else:
        box, drawn = outline.boxes(size_dbu).astype(np.float64), (outline.kind, outline.radius_dbu)
        square, below, overlapping = _list_shaped(block, size, box, drawn, pairs, centres, limit_square, rows, found)
    listed = min(below, LISTED)
    return Gaps(_signed_root(square), below, overlapping, found[:listed, 0], found[:listed, 1])


def smallest_gap_vectorised(
    size_index: SizeIndexArray, size_dbu: NDArray[np.int32], lattice: Lattice, limit_dbu: float, rows: int
) -> Gaps:
    """As :func:`smallest_gap`, in NumPy alone."""
    n_y, n_x = size_index.shape
    smallest, overlapping = np.inf, 0
    sites, neighbours = [], []
    for pair, ((down, right), (x, y)) in enumerate(zip(lattice.pairs, centre_distances(lattice), strict=True)):
        left, end = max(0, -right), min(rows, n_y - down)
        here = size_index[:end, left : n_x - max(0, right)]
        there = size_index[down : end + down, left + right : n_x + min(0, right)]
        gap_x = x - (size_dbu[here, 0] + size_dbu[there, 0]) / 2.0
        gap_y = y - (size_dbu[here, 1] + size_dbu[there, 1]) / 2.0
        square = np.where((here > 0) & (there > 0), signed_square(gap_x, gap_y), np.inf)
        smallest = min(smallest, float(square.min(initial=np.inf)))
        row, column = np.nonzero(square < limit_dbu * abs(limit_dbu))
        overlapping += int(np.count_nonzero(square[row, column] <= 0.0))
        sites.append(row * n_x + column + left)
        neighbours.append(np.full(row.size, pair))
    site, neighbour = np.concatenate(sites), np.concatenate(neighbours)
    order = np.lexsort((neighbour, site))[:LISTED]
    return Gaps(_signed_root(smallest), site.size, overlapping, site[order], neighbour[order])


def centre_distances(lattice: Lattice) -> FloatArray:
    """Distances along x and y of the centres of each of the lattice's ``pairs``, shape (n_pairs, 2), dbu."""
    down, right = np.abs(lattice.pairs).T
    return np.stack([right * lattice.period_dbu[0], down * lattice.period_dbu[1]], axis=1).astype(np.float64)


def signed_square(gap_x: NDArray[np.float64], gap_y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distance of two rectangles; minus the squared depth where they overlap."""
    apart = np.maximum(gap_x, 0.0) ** 2 + np.maximum(gap_y, 0.0) ** 2
    depth = np.maximum(gap_x, gap_y)
    return np.asarray(np.where(depth < 0.0, -(depth**2), apart))


def _signed_root(square: float) -> float:
    return float(np.sign(square) * np.sqrt(abs(square)))


@compiled
def square_of_pair(gap_x: float, gap_y: float) -> float:
    """As :func:`signed_square`, of one pair."""
    depth = max(gap_x, gap_y)
    return -depth * depth if depth < 0.0 else max(gap_x, 0.0) * max(gap_x, 0.0) + max(gap_y, 0.0) * max(gap_y, 0.0)


@compiled
def _smallest_square(
    size_index: SizeIndexArray, size_dbu: FloatArray, pairs: NDArray[np.int64], centres: FloatArray, rows: int
) -> float:
    """Smallest signed square over all pairs; columns keep their own minimum, so that a row is vectorised.

    Sites without a pillar get a size of minus infinity, infinitely far from every neighbour.
    """
    n_y, n_x = size_index.shape
    smallest = np.full(n_x, np.inf)
    half = np.empty((2, 2, n_x))  # of rows in turn: half the widths, half the lengths
    for row in range(min(rows + 1, n_y)):
        here = half[row % 2]
        for column in range(n_x):
            size = size_index[row, column]
            here[0, column] = 0.5 * size_dbu[size, 0] if size > 0 else -np.inf
            here[1, column] = 0.5 * size_dbu[size, 1] if size > 0 else -np.inf
        for pair in range(len(pairs)):
            down, right = pairs[pair]
            # The pair's first site stands in the row before, or in this one, which may be beyond the first rows.
            if row < down or row - down >= rows:
                continue
            first, second = half[(row - down) % 2], here
            left, count = max(0, -right), max(0, n_x - abs(right))
            width, length = first[0, left : left + count], first[1, left : left + count]
            other_width, other_length = second[0, left + right :][:count], second[1, left + right :][:count]
            x, y = centres[pair]
            for k in range(count):
                square = square_of_pair(x - width[k] - other_width[k], y - length[k] - other_length[k])
                smallest[k] = min(smallest[k], square)
    return smallest.min() if n_x > 0 else np.inf


@compiled
def _list_below(
    size_index: SizeIndexArray,
    size_dbu: FloatArray,
    pairs: NDArray[np.int64],
    centres: FloatArray,
    limit_square: float,
    rows: int,
    found: NDArray[np.int64],
) -> tuple[int, int]:
    """Pairs below the limit and how many of them touch; the first are listed in ``found``."""
    n_y, n_x = size_index.shape
    count, overlapping = 0, 0
    for row in range(rows):
        for column in range(n_x):
            here = size_index[row, column]
            if here == 0:
                continue
            for pair in range(len(pairs)):
                i, j = row + pairs[pair, 0], column + pairs[pair, 1]
                there = size_index[i, j] if i < n_y and 0 <= j < n_x else 0
                if there == 0:
                    continue
                gap_x = centres[pair, 0] - 0.5 * (size_dbu[here, 0] + size_dbu[there, 0])
                gap_y = centres[pair, 1] - 0.5 * (size_dbu[here, 1] + size_dbu[there, 1])
                square = square_of_pair(gap_x, gap_y)
                if square < limit_square:
                    if count < len(found):
                        found[count, 0] = row * n_x + column
                        found[count, 1] = pair
                    count += 1
                    overlapping += square <= 0.0
    return count, overlapping


@compiled
def _list_shaped(
    size_index: SizeIndexArray,
    size_dbu: FloatArray,
    box_dbu: FloatArray,
    drawn: tuple[int, float],
    pairs: NDArray[np.int64],
    centres: FloatArray,
    limit_square: float,
    rows: int,
    found: NDArray[np.int64],
) -> tuple[float, int, int]:
    """Smallest signed square, pairs below the limit and how many of them touch, of outlines other than rectangles."""
    n_y, n_x = size_index.shape
    smallest, count, overlapping = np.inf, 0, 0
    for row in range(rows):
        for column in range(n_x):
            here = size_index[row, column]
            if here == 0:
                continue
            for pair in range(len(pairs)):
                i, j = row + pairs[pair, 0], column + pairs[pair, 1]
                there = size_index[i, j] if i < n_y and 0 <= j < n_x else 0
                if there == 0:
                    continue
                x, y = centres[pair, 0], centres[pair, 1]
                gap_x = x - 0.5 * (box_dbu[here, 0] + box_dbu[there, 0])
                gap_y = y - 0.5 * (box_dbu[here, 1] + box_dbu[there, 1])
                square = square_of_pair(gap_x, gap_y)
                if square >= max(limit_square, smallest):
                    continue
                # Along an axis outlines are as near as their boxes.
                if x > 0.0 and y > 0.0:
                    apart = distance(drawn[0], drawn[1], x, y, size_dbu[here], size_dbu[there])
                    square = apart * abs(apart)
                smallest = min(smallest, square)
                if square < limit_square:
                    if count < len(found):
                        found[count, 0] = row * n_x + column
                        found[count, 1] = pair
                    count += 1
                    overlapping += square <= 0.0
    return smallest, count, overlapping
