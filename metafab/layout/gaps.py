"""Gaps between neighbouring pillars of a block of sites, beside, above and across both diagonals.

Pillars no larger than their cells can only come too close to one of their eight nearest neighbours, provided
that the smallest gap allowed does not exceed the period; :func:`smallest_gap` looks at each pair once. The gap
of a diagonal pair is the distance of their nearest corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.layout.pillars import Lattice, SizeIndexArray

#: (rows, columns) from a site to the four neighbours with which it makes a pair.
PAIRS = ((0, 1), (1, 0), (1, 1), (1, -1))

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
        neighbour: shape (m,), which of :data:`PAIRS` it is.
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
) -> Gaps:
    """Gaps of all pairs of neighbours in a block.

    Args:
        size_index: shape (n_y, n_x), 0 for no pillar.
        size_dbu: shape (n_sizes + 1, 2).
        lattice: for its periods.
        limit_dbu: pairs below it are counted and listed.
        rows: pairs whose first site lies in these first rows only; the others are neighbours. All unless given.
    """
    rows = size_index.shape[0] if rows is None else rows
    if not HAS_NUMBA:
        return smallest_gap_vectorised(size_index, size_dbu, lattice, limit_dbu, rows)
    found = np.empty((LISTED, 2), dtype=np.int64)
    block, size, limit_square = (
        np.ascontiguousarray(size_index),
        size_dbu.astype(np.float64),
        limit_dbu * abs(limit_dbu),
    )
    square = float(_smallest_square(block, size, *lattice.period_dbu, rows))
    below, overlapping = 0, 0
    if square < limit_square:
        below, overlapping = _list_below(block, size, *lattice.period_dbu, limit_square, rows, found)
    listed = min(below, LISTED)
    return Gaps(_signed_root(square), below, overlapping, found[:listed, 0], found[:listed, 1])


def smallest_gap_vectorised(
    size_index: SizeIndexArray, size_dbu: NDArray[np.int32], lattice: Lattice, limit_dbu: float, rows: int
) -> Gaps:
    """As :func:`smallest_gap`, in NumPy alone."""
    n_y, n_x = size_index.shape
    p_x, p_y = lattice.period_dbu
    smallest, overlapping = np.inf, 0
    sites, neighbours = [], []
    for pair, (down, right) in enumerate(PAIRS):
        left, end = max(0, -right), min(rows, n_y - down)
        here = size_index[:end, left : n_x - max(0, right)]
        there = size_index[down : end + down, left + right : n_x + min(0, right)]
        gap_x = abs(right) * p_x - (size_dbu[here, 0] + size_dbu[there, 0]) / 2.0
        gap_y = down * p_y - (size_dbu[here, 1] + size_dbu[there, 1]) / 2.0
        square = np.where((here > 0) & (there > 0), signed_square(gap_x, gap_y), np.inf)
        smallest = min(smallest, float(square.min(initial=np.inf)))
        row, column = np.nonzero(square < limit_dbu * abs(limit_dbu))
        overlapping += int(np.count_nonzero(square[row, column] <= 0.0))
        sites.append(row * n_x + column + left)
        neighbours.append(np.full(row.size, pair))
    site, neighbour = np.concatenate(sites), np.concatenate(neighbours)
    order = np.lexsort((neighbour, site))[:LISTED]
    return Gaps(_signed_root(smallest), site.size, overlapping, site[order], neighbour[order])


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
def _smallest_square(size_index: SizeIndexArray, size_dbu: FloatArray, p_x: int, p_y: int, rows: int) -> float:
    """Smallest signed square over all pairs; columns keep their own minimum, so that a row is vectorised.

    Sites without a pillar get a size of minus infinity, infinitely far from every neighbour.
    """
    n_y, n_x = size_index.shape
    smallest = np.full(n_x, np.inf)
    width, length = np.empty((2, n_x)), np.empty((2, n_x))
    for row in range(min(rows + 1, n_y)):
        here, above = (row + 1) % 2, row % 2  # `here` is the row before, `above` the one that is read now
        for column in range(n_x):
            size = size_index[row, column]
            width[above, column] = 0.5 * size_dbu[size, 0] if size > 0 else -np.inf
            length[above, column] = 0.5 * size_dbu[size, 1] if size > 0 else -np.inf
        if row > 0:
            for column in range(n_x):
                gap_x = -width[here, column] - width[above, column]
                gap_y = p_y - length[here, column] - length[above, column]
                smallest[column] = min(smallest[column], square_of_pair(gap_x, gap_y))
            for column in range(n_x - 1):
                gap_x = p_x - width[here, column] - width[above, column + 1]
                gap_y = p_y - length[here, column] - length[above, column + 1]
                smallest[column] = min(smallest[column], square_of_pair(gap_x, gap_y))
            for column in range(n_x - 1):
                gap_x = p_x - width[here, column + 1] - width[above, column]
                gap_y = p_y - length[here, column + 1] - length[above, column]
                smallest[column] = min(smallest[column], square_of_pair(gap_x, gap_y))
        if row < rows:
            for column in range(n_x - 1):
                gap_x = p_x - width[above, column] - width[above, column + 1]
                gap_y = -length[above, column] - length[above, column + 1]
                smallest[column] = min(smallest[column], square_of_pair(gap_x, gap_y))
    return smallest.min() if n_x > 0 else np.inf


@compiled
def _list_below(
    size_index: SizeIndexArray,
    size_dbu: FloatArray,
    p_x: int,
    p_y: int,
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
            for pair in range(4):
                down = 0 if pair == 0 else 1
                right = 1 if pair == 0 else pair - 1 if pair < 3 else -1
                if row + down >= n_y or column + right >= n_x or column + right < 0:
                    continue
                there = size_index[row + down, column + right]
                if there == 0:
                    continue
                gap_x = abs(right) * p_x - 0.5 * (size_dbu[here, 0] + size_dbu[there, 0])
                gap_y = down * p_y - 0.5 * (size_dbu[here, 1] + size_dbu[there, 1])
                square = square_of_pair(gap_x, gap_y)
                if square < limit_square:
                    if count < len(found):
                        found[count, 0] = row * n_x + column
                        found[count, 1] = pair
                    count += 1
                    overlapping += square <= 0.0
    return count, overlapping
