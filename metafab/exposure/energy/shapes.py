"""Shapes of exposed pillars as rectangles, whose energies have a closed form and add up.

A rectangle is itself. A round outline, the polygon of :class:`~metafab.layout.outlines.Outline`, is cut into strips
along x of its exact area, which follow it in steps of a share of the Gaussian's range. A Gaussian that is wider than
the pillar sees the rectangle of equal second moments, with the energy of the true area.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from metafab.core.conventions import FloatArray
from metafab.layout import PillarMap
from metafab.layout.outlines import RECTANGLE, Outline

#: Step along a side of the outline from one strip to the next, before it is halved, as a share of the range. Energies
#: err by less than 1.2e-4 of the term, the worst at the tip of an ellipse of 60 x 310 nm.
_STEP = 0.7
#: Range over the largest side from which a size acts by its second moments: the error is below 1.5e-5 of the term.
_WIDE = 1.0


@dataclass(frozen=True)
class Part:
    """One rectangle of each size, from the centre of the pillar: shape (n_sizes,) each."""

    share: FloatArray  #: Energy that counts, over that of the rectangle.
    half_width_nm: FloatArray  #: Half of the side along x.
    low_nm: FloatArray  #: Lower end along y.
    high_nm: FloatArray  #: Upper end along y.

    def along_y(self, y_nm: FloatArray | float, range_nm: FloatArray | float) -> FloatArray:
        """Energy of a Gaussian at ``y_nm`` of stripes from low to high end, times ``share``: shape (n_sizes,)."""
        ends = erf((y_nm - self.low_nm) / range_nm) - erf((y_nm - self.high_nm) / range_nm)
        return np.asarray(0.5 * self.share * ends)


@dataclass(frozen=True)
class Shapes:
    """Shapes of some sizes; the size (0, 0) is no pillar."""

    size_nm: FloatArray  #: Shape (n_sizes, 2), width and length.
    area_nm2: FloatArray  #: Shape (n_sizes,).
    sides_nm: FloatArray  #: Shape (n_sizes, 2), sides of the rectangle of equal second moments.
    has_corners: bool  #: Whether the shapes are rectangles, or rectangles with rounded corners.
    #: Corners of the first quadrant of each outline, from (width / 2, 0) upwards: shape (m, 2), m by size; empty for
    #: rectangles.
    quadrants_nm: tuple[FloatArray, ...] = ()

    @classmethod
    def of(cls, pillars: PillarMap, outline: Outline = RECTANGLE) -> Shapes:
        """Shapes of the sizes of a mask, drawn with an outline other than a cross or a ring."""
        size_nm = pillars.size_nm()
        if outline.is_rectangle:
            return cls(size_nm, size_nm.prod(axis=1), size_nm, True)
        polygons = outline.polygons(pillars.size_dbu.astype(np.int64))
        unit_nm = pillars.lattice.database_unit_nm
        corners = [np.asarray(polygon * unit_nm, dtype=np.float64) for polygon in polygons]
        return cls._drawn(size_nm, corners, outline.shape == "rounded")

    @classmethod
    def _drawn(cls, size_nm: FloatArray, corners_nm: Sequence[FloatArray], has_corners: bool) -> Shapes:
        """Return shapes from all corners of their outlines, or from those in the first quadrant."""
        quadrants = tuple(_quadrant(corners) for corners in corners_nm)
        area, along_x, along_y = np.array([_moments(quadrant) for quadrant in quadrants]).T
        sides = np.sqrt(12.0 * np.stack([along_x, along_y], axis=1) / np.maximum(area, 1e-9)[:, None])
        return cls(size_nm, 4.0 * area, sides, has_corners, quadrants)

    def turned(self) -> Shapes:
        """The shapes with x and y exchanged."""
        if self.quadrants_nm:
            turned = [quadrant[:, ::-1] for quadrant in self.quadrants_nm]
            return self._drawn(self.size_nm[:, ::-1], turned, self.has_corners)
        return Shapes(self.size_nm[:, ::-1], self.area_nm2, self.sides_nm[:, ::-1], self.has_corners)

    def some(self, sizes: NDArray[np.integer]) -> Shapes:
        """The shapes of some size indices, shape (n,)."""
        quadrants = tuple(self.quadrants_nm[size] for size in sizes.tolist()) if self.quadrants_nm else ()
        return Shapes(self.size_nm[sizes], self.area_nm2[sizes], self.sides_nm[sizes], self.has_corners, quadrants)

    def parts(self, range_nm: float, *, on_axis: bool = False, finer: int = 1) -> Iterator[Part]:
        """Rectangles whose energies of a Gaussian add up to that of each shape.

        ``on_axis`` counts the upper half twice in place of the lower one, for energies at y = 0; ``finer`` divides the
        steps along round outlines.
        """
        if not self.quadrants_nm or range_nm >= _WIDE * float(self.size_nm.max(initial=0.0)):
            box = self.sides_nm.prod(axis=1)
            share = np.divide(self.area_nm2, box, out=np.zeros_like(box), where=box > 0.0)
            half, end = 0.5 * self.sides_nm.T
            yield Part(share, half, -end, end)
            return
        mirrors = 1 if on_axis else 2
        for refined, weight in ((1, -1.0 / 3.0), (2, 4.0 / 3.0)):  # Richardson's extrapolation of the step to 0
            strips = [_strips(quadrant, _STEP / finer * range_nm, refined) for quadrant in self.quadrants_nm]
            padded = np.zeros((max(len(strip) for strip in strips), 3, len(strips)))
            for size, strip in enumerate(strips):
                padded[: len(strip), :, size] = strip
            share = np.full(len(strips), weight * 2.0 / mirrors)
            for half, low, high in padded:
                yield Part(share, half, low, high)
                if not on_axis:
                    yield Part(share, half, -high, -low)


def _quadrant(corners_nm: FloatArray) -> FloatArray:
    """Corners in the first quadrant, from the x axis upwards: shape (m, 2)."""
    inside = corners_nm[(corners_nm >= 0.0).all(axis=1)]
    upwards = inside[np.lexsort((-inside[:, 0], inside[:, 1]))]
    return np.concatenate([[(upwards[:, 0].max(), 0.0)], upwards])


def _moments(quadrant_nm: FloatArray) -> tuple[float, float, float]:
    """Integrals of 1, x^2 and y^2 over a quadrant."""
    (x, y), (next_x, next_y) = quadrant_nm[:-1].T, quadrant_nm[1:].T
    rise, middle = next_y - y, (y + next_y) ** 2 * (x + next_x) / 2.0
    along_x = (x**2 + next_x**2) * (x + next_x) / 12.0
    along_y = (y**2 * x + middle + next_y**2 * next_x) / 6.0
    return float(rise @ (x + next_x)) / 2.0, float(rise @ along_x), float(rise @ along_y)


def _strips(quadrant_nm: FloatArray, step_nm: float, refined: int) -> FloatArray:
    """Half width, lower and upper end of strips, shape (n, 3).

    Each side of the outline gets ``refined`` strips of equal height for each started step of its length.
    """
    length = np.hypot(*np.diff(quadrant_nm, axis=0).T)
    count = refined * np.maximum(1, np.ceil(length / step_nm)).astype(int)
    first = np.repeat(np.cumsum(count) - count, count)
    at = (np.arange(count.sum()) - first)[:, None] / np.repeat(count, count)[:, None]
    start, along = np.repeat(quadrant_nm[:-1], count, axis=0), np.repeat(np.diff(quadrant_nm, axis=0), count, axis=0)
    step = 1.0 / np.repeat(count, count)
    middle, low = start + (at + 0.5 * step[:, None]) * along, start + at * along
    return np.stack([middle[:, 0], low[:, 1], low[:, 1] + step * along[:, 1]], axis=1)
