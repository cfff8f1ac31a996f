"""Gaps between neighbouring pillars: side by side, one above the other, and across both diagonals.

A pillar no larger than its cell can come too close only to its nearest neighbours (eight, or six on a hexagonal
lattice), provided that the smallest gap allowed does not exceed the pitch of the sites. :func:`smallest_gap` compares
each pair once. The gap of a diagonal pair of rectangles is the distance between their nearest corners. For other
outlines it is the distance between the curves; their bounding boxes only serve to skip pairs that are far apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.layout.outlines import RECTANGLE, Outline, distance
from metafab.layout.pillars import Lattice, SizeIndexArray

#: Pairs below the limit that are listed; all are counted.
LISTED = 1000


@dataclass(frozen=True)
class Gaps:
    """Gaps in a block of sites."""

    smallest_dbu: float  #: Smallest distance between two neighbours; infinite without a pair, negative for an overlap.
    below: int  #: Number of pairs below the limit.
    overlapping: int  #: Number of pairs that overlap or touch; they are also among ``below`` if the limit is positive.
    #: Shape (m,), flat index of the first site of each listed pair, at most :data:`LISTED`.
    too_small: NDArray[np.int64]
    neighbour: NDArray[np.int64]  #: Shape (m,), index of the listed pair's direction in ``Lattice.pairs``.


def smallest_gap(
    size_index: SizeIndexArray,
    size_dbu: NDArray[np.int32],
    lattice: Lattice,
    limit_dbu: float = 0.0,
    rows: int | None = None,
    outline: Outline = RECTANGLE,
) -> Gaps:
    """Measure the gaps of all pairs of neighbours in a block of sites.

    Args:
        size_index: shape (n_y, n_x), 0 for no pillar.
        size_dbu: shape (n_sizes + 1, 2), width and length.
        limit_dbu: pairs below this distance are counted and listed.
        rows: compare only pairs whose first site lies in these first rows; None for all.
    """
    rows = size_index.shape[0] if rows is None else rows
    block, size = np.ascontiguousarray(size_index), size_dbu.astype(np.float64)
    pairs, centres = np.array(lattice.pairs), centre_distances(lattice)
    limit_square = limit_dbu * abs(limit_dbu)
    listed = np.empty((LISTED, 2), dtype=np.int64)
    square, below, overlapping = np.inf, 0, 0
    # In most blocks no pair is below the limit, which this fast kernel shows.
    if outline.is_rectangle:
        square = float(_smallest_square(block, size, pairs, centres, rows))
    if not outline.is_rectangle or square < limit_square:
        box, curve = outline.boxes(size_dbu).astype(np.float64), (outline.kind, outline.radius_dbu)
        square, below, overlapping = _list_below(block, size, box, curve, pairs, centres, limit_square, rows, listed)
    listed = listed[: min(below, LISTED)]
    smallest_dbu = float(np.sign(square) * np.sqrt(abs(square)))
    return Gaps(smallest_dbu, below, overlapping, listed[:, 0], listed[:, 1])


def centre_distances(lattice: Lattice) -> FloatArray:
    """Distances along x and y between the centres of each of ``lattice.pairs``, shape (n_pairs, 2), dbu."""
    down, right = np.abs(lattice.pairs).T
    return np.stack([right * lattice.period_dbu[0], down * lattice.period_dbu[1]], axis=1).astype(np.float64)


@compiled
def signed_square(gap_x: float, gap_y: float) -> float:
    """Squared distance between two rectangles; minus the squared depth if they overlap.

    A gap along x or y is negative where the projections on that axis overlap.
    """
    depth = max(gap_x, gap_y)
    return -depth * depth if depth < 0.0 else max(gap_x, 0.0) * max(gap_x, 0.0) + max(gap_y, 0.0) * max(gap_y, 0.0)


@compiled
def _smallest_square(
    size_index: SizeIndexArray, size_dbu: FloatArray, pairs: NDArray[np.int64], centres: FloatArray, rows: int
) -> float:
    """Smallest signed square over all pairs of rectangles.

    Each column keeps its own minimum, so that the loop over a row is vectorised. A site without a pillar gets a size
    of minus infinity, which is infinitely far from every neighbour.
    """
    n_y, n_x = size_index.shape
    smallest = np.empty(n_x)  # Loops here and at the end: full and min take half a second to compile.
    for column in range(n_x):
        smallest[column] = np.inf
    half = np.empty((2, 2, n_x))  # half widths and half lengths of two rows in turn
    for row in range(min(rows + 1, n_y)):
        here = half[row % 2]
        for column in range(n_x):
            size = size_index[row, column]
            here[0, column] = 0.5 * size_dbu[size, 0] if size > 0 else -np.inf
            here[1, column] = 0.5 * size_dbu[size, 1] if size > 0 else -np.inf
        for pair in range(len(pairs)):
            down, right = pairs[pair]
            # The pair's first site lies ``down`` rows before its second; it must exist and be among the first ``rows``.
            if row < down or row - down >= rows:
                continue
            first, second = half[(row - down) % 2], here
            left, count = max(0, -right), max(0, n_x - abs(right))
            width, length = first[0, left : left + count], first[1, left : left + count]
            other_width, other_length = second[0, left + right :][:count], second[1, left + right :][:count]
            x, y = centres[pair]
            for k in range(count):
                square = signed_square(x - width[k] - other_width[k], y - length[k] - other_length[k])
                smallest[k] = min(smallest[k], square)
    least = np.inf
    for column in range(n_x):
        least = min(least, smallest[column])
    return least


@compiled
def _list_below(
    size_index: SizeIndexArray,
    size_dbu: FloatArray,
    box_dbu: FloatArray,
    curve: tuple[int, float],
    pairs: NDArray[np.int64],
    centres: FloatArray,
    limit_square: float,
    rows: int,
    listed: NDArray[np.int64],
) -> tuple[float, int, int]:
    """Smallest signed square, number of pairs below the limit, and number of these that touch; fills ``listed``."""
    n_y, n_x = size_index.shape
    smallest, count, overlapping = np.inf, 0, 0
    kind, radius = curve
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
                square = signed_square(gap_x, gap_y)
                if square >= max(limit_square, smallest):
                    continue
                # Along an axis, curves are as near as their boxes.
                if kind > 0 and x > 0.0 and y > 0.0:
                    apart = distance(kind, radius, x, y, size_dbu[here], size_dbu[there])
                    square = apart * abs(apart)
                smallest = min(smallest, square)
                if square < limit_square:
                    if count < len(listed):
                        listed[count, 0] = row * n_x + column
                        listed[count, 1] = pair
                    count += 1
                    overlapping += square <= 0.0
    return smallest, count, overlapping
