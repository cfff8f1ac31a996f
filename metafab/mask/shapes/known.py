"""Pillars among the shapes of a file: rectangles, or the polygons that a design's pillars are drawn as."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from metafab.layout.outlines import RECTANGLE, Outline
from metafab.mask.shapes.hierarchy import IntArray


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
