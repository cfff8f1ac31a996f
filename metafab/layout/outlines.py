"""What a pillar of a size is drawn as: a rectangle, or the polygon of an ellipse, a cross or rounded corners.

Polygons have their vertices on the database grid, are their own mirror images in both axes, and swap x and y with
width and length, so that a mask may be mirrored and turned. A round outline is circumscribed: its sides touch the true
curve, those at the axes just where the curve is widest, so that width, length and gaps along the axes are exact. Its
corners stand out by at most :data:`CHORD_NM`, and rounding moves them by at most 0.71 database units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.spec import Design

IntArray = NDArray[np.int64]
Shape = Literal["rectangle", "rounded", "ellipse", "cross"]

#: How far a polygon's corners stand out of the curve that it stands for, at most.
CHORD_NM = 0.6

#: Of each shape, as the kernels know it.
_KINDS: dict[Shape, int] = {"rectangle": 0, "rounded": 1, "ellipse": 2, "cross": 3}


@dataclass(frozen=True)
class Outline:
    """The outline of every size.

    Attributes:
        shape: of the cross-section.
        database_unit_nm: size of one database unit (dbu).
        radius_dbu: of rounded corners; of a pillar whose shorter side is less than twice as long, half that side.
    """

    shape: Shape
    database_unit_nm: float
    radius_dbu: float = 0.0

    @classmethod
    def of(cls, design: Design) -> Outline:
        """The outline of a design's pillars; of rectangles whose corners fabrication rounds, these rectangles."""
        cell, unit_nm = design.unit_cell.cell, design.mask.database_unit_nm
        radius_dbu = (cell.corner_radius_nm or 0.0) / unit_nm if design.mask.draw_corners else 0.0
        shape: Shape = "ellipse" if cell.shape == "circle" else cell.shape
        return cls("rounded" if radius_dbu else shape, unit_nm, radius_dbu)

    @property
    def is_rectangle(self) -> bool:
        """Whether pillars are drawn as they have always been."""
        return self.shape == "rectangle"

    @property
    def tolerance_nm(self) -> float:
        """Largest distance of the polygon from the curve that it stands for; 0 where it is exact."""
        exact = self.shape in {"rectangle", "cross"}
        return 0.0 if exact else CHORD_NM + math.sqrt(0.5) * self.database_unit_nm

    @property
    def kind(self) -> int:
        """The shape, for compiled loops."""
        return _KINDS[self.shape]

    def boxes(self, size_dbu: NDArray[np.int32]) -> NDArray[np.int32]:
        """Width and length of the box around each size, shape (n, 2); a cross reaches as far along both axes."""
        if self.shape != "cross":
            return size_dbu
        return np.asarray(np.repeat(size_dbu.max(axis=1, keepdims=True), 2, axis=1))

    def vertices(self, width_dbu: int, length_dbu: int) -> IntArray:
        """Corners about the centre, counter-clockwise, shape (n, 2); sizes are even numbers."""
        return _vertices(self, width_dbu, length_dbu)

    def area(self, size_dbu: NDArray[np.int32]) -> NDArray[np.float64]:
        """Area of each size's polygon, shape (n,), squared units: multiples of a half; of (0, 0) it is 0."""
        if self.is_rectangle:
            return np.asarray(np.prod(size_dbu.astype(np.float64), axis=1))
        return np.array([area_of(self.vertices(w, h)) if w else 0.0 for w, h in size_dbu.tolist()])

    def size_of(self, polygon: IntArray) -> tuple[int, int] | None:
        """(width, length) of the pillar that has this outline, shape (n, 2), anywhere on the grid; None if none has.

        Where the outline begins, which way it runs, and corners on straight sides make no difference. Of a cross the
        width is the larger.
        """
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        (width, length), twice = (high - low).tolist(), low + high
        if width <= 0 or length <= 0 or width % 2 or length % 2:
            return None
        about = plain(2 * polygon - twice) // 2
        if self.shape == "cross":
            corners = about[(about[:, 0] > 0) & (about[:, 1] > 0)]
            length = 2 * int(corners.min(initial=width))
        if length <= 0 or not np.array_equal(about, plain(self.vertices(width, length))):
            return None
        return width, length


#: Of pillars that are rectangles, whatever the unit.
RECTANGLE = Outline("rectangle", 1.0)


def plain(polygon: IntArray) -> IntArray:
    """The same polygon counter-clockwise from its lowest, then leftmost, corner, without corners on straight sides."""
    before, after = np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0)
    distinct = polygon[np.any(polygon != before, axis=1)]
    before, after = np.roll(distinct, 1, axis=0) - distinct, np.roll(distinct, -1, axis=0) - distinct
    kept = distinct[before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]]
    if len(kept) and area_of(kept) < 0.0:
        kept = kept[::-1]
    if not len(kept):
        return np.zeros((0, 2), dtype=np.int64)
    return np.asarray(np.roll(kept, -int(np.lexsort((kept[:, 0], kept[:, 1]))[0]), axis=0))


def area_of(polygon: IntArray) -> float:
    """Signed area of a polygon, shape (n, 2), positive if it runs counter-clockwise."""
    x, y = polygon.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0


@lru_cache(maxsize=1 << 16)
def _vertices(outline: Outline, width: int, length: int) -> IntArray:
    half = np.array([width // 2, length // 2], dtype=np.int64)
    if outline.shape == "cross":
        (arm, reach), (x, y) = sorted(half.tolist()), half.tolist()
        if x == y:
            return plain(_mirrored(half[None]))
        return plain(_mirrored(np.array([[reach, arm], [arm, arm], [arm, reach]], dtype=np.int64)))
    if outline.is_rectangle:
        return plain(_mirrored(half[None]))
    round_dbu = half.astype(np.float64)
    if outline.shape == "rounded":
        round_dbu = np.full(2, min(outline.radius_dbu, *half.tolist()))
    arc = (half - round_dbu) + round_dbu * _touching(round_dbu.max() * outline.database_unit_nm)
    return plain(_mirrored(np.rint(arc).astype(np.int64)))


def _touching(radius_nm: float) -> NDArray[np.float64]:
    """Corners, in the first quadrant, of a regular polygon whose sides touch the unit circle, two at the axes."""
    sides = 4 * math.ceil(math.pi / math.acos(radius_nm / (radius_nm + CHORD_NM)) / 4.0)
    angle = (np.arange(sides // 4) + 0.5) * (2.0 * math.pi / sides)
    x = np.cos(angle) / math.cos(math.pi / sides)
    x[0] = 1.0  # exactly, so that the widest side lies on the box
    return np.stack([x, x[::-1]], axis=1)


def _mirrored(quadrant: IntArray) -> IntArray:
    """The whole outline from its corners in the first quadrant, counter-clockwise from the x axis on."""
    upper = np.concatenate([quadrant, quadrant[::-1] * [-1, 1]])
    return np.concatenate([upper, -upper])


@compiled
def _of_rectangles(gap_x: float, gap_y: float) -> float:
    """Distance of two rectangles; minus the depth where they overlap."""
    depth = max(gap_x, gap_y)
    return float(depth if depth < 0.0 else np.sqrt(max(gap_x, 0.0) ** 2 + max(gap_y, 0.0) ** 2))


@compiled
def _beyond(angle: float, x: float, y: float, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """How far apart two ellipses of sizes ``a`` and ``b`` lie in a direction: their distance is the largest of it."""
    c, s = np.cos(angle), np.sin(angle)
    reach = np.sqrt((a[0] * c) ** 2 + (a[1] * s) ** 2) + np.sqrt((b[0] * c) ** 2 + (b[1] * s) ** 2)
    return float(x * c + y * s - 0.5 * reach)


@compiled
def _of_ellipses(x: float, y: float, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    best, step = 0, 0.5 * np.pi / 16
    for k in range(1, 17):
        if _beyond(k * step, x, y, a, b) > _beyond(best * step, x, y, a, b):
            best = k
    low, high = max((best - 1) * step, 0.0), min((best + 1) * step, 0.5 * np.pi)
    for _ in range(40):
        third = (high - low) / 3.0
        if _beyond(low + third, x, y, a, b) < _beyond(high - third, x, y, a, b):
            low += third
        else:
            high -= third
    return float(_beyond(0.5 * (low + high), x, y, a, b))


@compiled
def distance(kind: int, radius: float, x: float, y: float, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Distance of two pillars whose centres are ``x`` and ``y`` >= 0 apart; negative where they overlap.

    Args:
        kind: :attr:`Outline.kind`; of round outlines the true curve is meant, not its polygon.
        radius: of rounded corners.
        x: along x; likewise ``y``.
        y: see ``x``.
        a: (width, length) of one; likewise ``b``.
        b: see ``a``.
    """
    gap_x, gap_y = x - 0.5 * (a[0] + b[0]), y - 0.5 * (a[1] + b[1])
    if kind == 1:
        # A rounded rectangle is a smaller one and all that is within its radius of it.
        rounds = min(radius, 0.5 * a[0], 0.5 * a[1]) + min(radius, 0.5 * b[0], 0.5 * b[1])
        return float(_of_rectangles(gap_x + rounds, gap_y + rounds) - rounds)
    if kind == 2:
        return _of_ellipses(x, y, a, b)
    if kind == 3:
        turned = _of_rectangles(x - 0.5 * (a[1] + b[1]), y - 0.5 * (a[0] + b[0]))
        one = _of_rectangles(x - 0.5 * (a[0] + b[1]), y - 0.5 * (a[1] + b[0]))
        other = _of_rectangles(x - 0.5 * (a[1] + b[0]), y - 0.5 * (a[0] + b[1]))
        return min(_of_rectangles(gap_x, gap_y), turned, one, other)
    return _of_rectangles(gap_x, gap_y)
