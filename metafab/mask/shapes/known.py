"""Which shapes of a file are pillars: rectangles, or the polygons that a design's pillars are drawn as."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from metafab.layout.outlines import RECTANGLE, Outline
from metafab.mask.shapes.hierarchy import IntArray, rectangle_of


@dataclass(frozen=True)
class KnownShapes:
    """Tells pillars from other shapes.

    Attributes:
        outline: of the pillars; sizes and unit of the design.
    """

    outline: Outline = RECTANGLE
    _seen: dict[tuple[bytes, float], IntArray | None] = field(default_factory=dict)

    @property
    def are_rectangles(self) -> bool:
        """Whether any axis-parallel rectangle is a pillar, whatever the unit."""
        return self.outline.is_rectangle

    def __call__(self, ring: IntArray, unit_nm: float) -> IntArray | None:
        """The rectangle about the same centre, as wide and long as the pillar with this outline; None if none has it.

        Args:
            ring: corners, shape (n, 2), closed or not, in units of the file.
            unit_nm: that unit.

        Returns:
            x, y, width, length in units of the file.
        """
        if self.are_rectangles:
            return rectangle_of(ring)
        key = (ring - ring[0]).tobytes(), unit_nm
        if key not in self._seen:
            self._seen[key] = self._about(ring - ring[0], unit_nm)
        found = self._seen[key]
        return None if found is None else found + np.append(ring[0], [0, 0])

    def _about(self, ring: IntArray, unit_nm: float) -> IntArray | None:
        ratio = Fraction(unit_nm / self.outline.database_unit_nm).limit_denominator(1_000_000)
        scaled, rest = np.divmod(ring * ratio.numerator, ratio.denominator)
        size_dbu = None if rest.any() else self.outline.size_of(scaled)
        if size_dbu is None:
            return None
        # Corners lie at half the sizes, so these, and their differences, are whole numbers of the file's units, too.
        size = np.array(size_dbu) * ratio.denominator // ratio.numerator
        low, high = ring.min(axis=0), ring.max(axis=0)
        return np.concatenate([low + (high - low - size) // 2, size])


#: Of designs with rectangular pillars.
RECTANGLES = KnownShapes()
