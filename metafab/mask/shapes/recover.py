"""Shapes of a file -> pillars -> sizes at lattice sites; rectangles that do not fit are kept apart, never dropped."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.storage.scratch import release, scratch
from metafab.layout import Lattice
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import SizeIndexArray
from metafab.mask.shapes.hierarchy import IntArray

PLACED, OFF_SITE, DUPLICATE, OFF_GRID, TOO_MANY_SIZES = range(5)

#: Rectangles that are kept with their places; beyond, they are only counted.
KEPT = 200_000

#: Rectangles after which the pages of an array on disk are released, some 10 MB where tiles follow each other.
_RELEASED = 1 << 22


@dataclass(frozen=True, eq=False)
class Leftover:
    """Shapes on the pillar layer that are not pillars of the lattice."""

    count: int  #: Number of shapes.
    #: Bounding boxes of up to :data:`KEPT` of them, shape (m, 4), x, y of the lower left corner, width, height.
    boxes_nm: FloatArray


class Recovery:
    """Collects rectangles into an array of size indices over a lattice.

    Args:
        lattice: expected sites of the pillars.
        unit_ratio: file unit in database units of the lattice.
        source: the file, for messages.
        at_dbu: (x, y) of the centre of the lattice in the file.

    Attributes:
        size_index: shape ``lattice.shape``; indices into the sizes that :meth:`finish` returns; on disk where it is
            large.
    """

    def __init__(self, lattice: Lattice, unit_ratio: Fraction, source: str, at_dbu: tuple[int, int]) -> None:
        self._every = 2 if lattice.hexagonal else 1
        self._ratio = np.array([unit_ratio.numerator, unit_ratio.denominator], dtype=np.int64)
        self._source = source
        self._origin = np.array([lattice.x_dbu()[0] + at_dbu[0], lattice.y_dbu()[0] + at_dbu[1]], dtype=np.int64)
        self._period = np.array(lattice.period_dbu, dtype=np.int64)
        # Index of every (width, length) up to a pillar's cell, filled in the order of appearance.
        self._index_of = np.zeros((lattice.cell_dbu[0] + 1, lattice.cell_dbu[1] + 1), dtype=np.uint16)
        self._sizes = np.zeros((np.iinfo(np.uint16).max + 1, 2), dtype=np.int32)
        self._size_count = np.ones(1, dtype=np.int64)
        self._kept: dict[int, list[IntArray]] = {OFF_SITE: [], DUPLICATE: [], OFF_GRID: []}
        self._counts = dict.fromkeys(self._kept, 0)
        self.size_index: SizeIndexArray = scratch(lattice.shape, np.uint16)
        self._unreleased = 0

    def add(self, rectangles: IntArray, shift: IntArray) -> None:
        """Put rectangles (x, y, width, height), shape (n, 4), file units, moved by ``shift``, (2,), at their sites.

        InputError for more sizes than indices.
        """
        self._unreleased += len(rectangles)
        if self._unreleased >= _RELEASED:
            release(self.size_index)
            self._unreleased = 0
        verdict = np.empty(len(rectangles), dtype=np.uint8)
        failures = _place(
            np.ascontiguousarray(rectangles),
            shift,
            self._ratio,
            (self._origin, self._period),
            self._every,
            (self._index_of, self._sizes, self._size_count),
            self.size_index,
            verdict,
        )
        if not failures:
            return
        if np.any(verdict == TOO_MANY_SIZES):
            expected = "up to 65535 sizes"
            raise InputError.single(self._source, "pillars", expected, "more", "is this the mask of a metafab design?")
        for kind, kept in self._kept.items():
            strays = rectangles[verdict == kind]
            room = KEPT - min(self._counts[kind], KEPT)
            if len(strays) and room:
                kept.append(strays[:room] + np.concatenate([shift, [0, 0]]))
            self._counts[kind] += len(strays)

    def count(self, kind: int) -> int:
        """Number of rectangles that were kept apart as ``OFF_SITE``, ``DUPLICATE`` or ``OFF_GRID``."""
        return self._counts[kind]

    def leftover(self, kind: int, unit_nm: float) -> Leftover:
        """Return the rectangles that were kept apart as ``OFF_SITE``, ``DUPLICATE`` or ``OFF_GRID``."""
        return Leftover(self._counts[kind], np.concatenate([np.empty((0, 4)), *self._kept[kind]]) * unit_nm)

    def finish(self) -> NDArray[np.int32]:
        """Sort the sizes by width and length, renumber the sites, and return the sizes, shape (n_sizes + 1, 2)."""
        count = int(self._size_count[0])
        sizes = self._sizes[:count]
        order = np.lexsort((sizes[:, 1], sizes[:, 0]))
        rank = np.empty(count, dtype=np.uint16)
        rank[order] = np.arange(count)
        for start in range(0, len(self.size_index), 256):
            rows = self.size_index[start : start + 256]
            np.take(rank, rows, out=rows, mode="clip")  # all are valid; with "raise", the output is buffered
            release(rows)
        return np.ascontiguousarray(sizes[order])


@compiled
def _place(
    rectangles: IntArray,
    shift: IntArray,
    ratio: IntArray,
    sites: tuple[IntArray, IntArray],
    every: int,
    table: tuple[SizeIndexArray, NDArray[np.int32], IntArray],
    size_index: SizeIndexArray,
    verdict: NDArray[np.uint8],
) -> int:
    """Place rectangles; return the number of those that are not placed.

    A site is a place of the grid whose row and column add up to a multiple of ``every``.
    """
    # Numbers of their own stay in registers; stores into arrays could change entries of others.
    shift_x, shift_y, factor, divisor = shift[0], shift[1], ratio[0], ratio[1]
    origin_x, origin_y, pitch_x, pitch_y = sites[0][0], sites[0][1], 2 * sites[1][0], 2 * sites[1][1]
    index_of, sizes, size_count = table
    failures = 0
    n_y, n_x = size_index.shape
    widest, longest = index_of.shape[0] - 1, index_of.shape[1] - 1
    inverse_x, inverse_y = 1.0 / pitch_x, 1.0 / pitch_y
    verdict[:] = PLACED
    for i in range(len(rectangles)):
        x, y = rectangles[i, 0] + shift_x, rectangles[i, 1] + shift_y
        width, length = rectangles[i, 2], rectangles[i, 3]
        if factor != divisor:
            x, y, width, length = x * factor, y * factor, width * factor, length * factor
            if x % divisor or y % divisor or width % divisor or length % divisor:
                verdict[i] = OFF_GRID
                failures += 1
                continue
            x, y, width, length = x // divisor, y // divisor, width // divisor, length // divisor
        twice_x, twice_y = 2 * (x - origin_x) + width, 2 * (y - origin_y) + length
        # The rounded product is the quotient if that is whole, which the next line verifies.
        column, row = np.int64(np.rint(twice_x * inverse_x)), np.int64(np.rint(twice_y * inverse_y))
        on_site = twice_x == column * pitch_x and twice_y == row * pitch_y
        inside = 0 <= column < n_x and 0 <= row < n_y and width <= widest and length <= longest
        if not (on_site and inside) or (every > 1 and (row + column) % every != 0):
            verdict[i] = OFF_SITE
            failures += 1
            continue
        if size_index[row, column] != 0:
            verdict[i] = DUPLICATE
            failures += 1
            continue
        size = np.int64(index_of[width, length])
        if size == 0:
            size = size_count[0]
            if size == len(sizes):
                verdict[i] = TOO_MANY_SIZES
                return failures + 1
            sizes[size, 0], sizes[size, 1] = width, length
            index_of[width, length] = size
            size_count[0] += 1
        size_index[row, column] = size
    return failures


@dataclass(frozen=True)
class KnownShapes:
    """Distinguishes pillars from other shapes."""

    outline: Outline = RECTANGLE  #: Outline of the pillars, in the unit of the design.
    # Rectangle of each ring, relative to its first corner, by the bytes of the ring and the unit.
    _rectangles: dict[tuple[bytes, float], IntArray | None] = field(default_factory=dict)

    @property
    def are_rectangles(self) -> bool:
        """Whether any axis-parallel rectangle is a pillar, in any unit."""
        return self.outline.is_rectangle

    def __call__(self, ring: IntArray, unit_nm: float) -> IntArray | None:
        """Return the rectangle (x, y, width, length) of a pillar, shape (4,), in units of the file; None for others.

        The ring of corners has the shape (n, 2), closed or not.
        """
        if self.are_rectangles:
            return rectangle_of(ring)
        key = (ring - ring[0]).tobytes(), unit_nm
        if key not in self._rectangles:
            self._rectangles[key] = self._rectangle(ring - ring[0], unit_nm)
        rectangle = self._rectangles[key]
        return None if rectangle is None else rectangle + np.append(ring[0], [0, 0])

    def _rectangle(self, ring: IntArray, unit_nm: float) -> IntArray | None:
        ratio = Fraction(unit_nm / self.outline.database_unit_nm).limit_denominator(1_000_000)
        scaled, rest = np.divmod(ring * ratio.numerator, ratio.denominator)
        size_dbu = None if rest.any() else self.outline.size_of(scaled)
        if size_dbu is None:
            return None
        # Corners lie at half the sizes, so that sizes and their differences are whole numbers of file units as well.
        size = np.array(size_dbu) * ratio.denominator // ratio.numerator
        low, high = ring.min(axis=0), ring.max(axis=0)
        return np.concatenate([low + (high - low - size) // 2, size])


#: Known shapes of designs with rectangular pillars.
RECTANGLES = KnownShapes()


def rectangle_of(points: IntArray) -> IntArray | None:
    """Return the axis-parallel rectangle (x, y, width, height), shape (4,), that a ring of corners is; else None.

    The ring has the shape (n, 2), closed or open.
    """
    if len(points) == 5 and np.array_equal(points[0], points[4]):
        points = points[:4]
    if len(points) != 4:
        return None
    step = np.roll(points, -1, axis=0) - points
    alternating = np.all(step[::2, 0] == 0) and np.all(step[1::2, 1] == 0)
    alternating |= bool(np.all(step[::2, 1] == 0) and np.all(step[1::2, 0] == 0))
    low, high = points.min(axis=0), points.max(axis=0)
    if not alternating or np.any(high == low):
        return None
    return np.concatenate([low, high - low])
