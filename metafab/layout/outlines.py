"""Outline of a pillar in the mask: a rectangle, or the polygon of an ellipse, a cross, a ring or rounded corners.

Polygons have their vertices on the database grid and are symmetric about both axes. Exchanging width and length
exchanges x and y, so that a mask may be mirrored and turned. A round outline is circumscribed by its polygon: the sides
touch the curve, and those at the axes touch it where it is widest, so that width, length and gaps along the axes are
exact. The corners stand out by at most :data:`CHORD_NM`; rounding moves them by at most 0.71 database units.

A ring is one polygon: a slit without width along +x joins its outer side to its hole, as mask formats have no holes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.spec import Design

IntArray = NDArray[np.int64]
Shape = Literal["rectangle", "rounded", "ellipse", "cross", "ring"]

#: Largest distance of a polygon's corners from the curve that it approximates.
CHORD_NM = 0.6

#: Number of each shape in compiled kernels, which see a ring by its outer side.
_KINDS: dict[Shape, int] = {"rectangle": 0, "rounded": 1, "ellipse": 2, "cross": 3, "ring": 2}


@dataclass(frozen=True)
class Outline:
    """Outline of the pillars of a design, for every size."""

    shape: Shape  #: Shape of the cross-section.
    database_unit_nm: float  #: Size of one database unit (dbu).
    radius_dbu: float = 0.0  #: Radius of rounded corners; at most half the shorter side of a pillar is applied.
    wall_dbu: int = 0  #: Drawn thickness of a ring's wall; 0 where the diameter of its hole is given instead.
    hole_dbu: int = 0  #: Drawn diameter of a ring's hole, where that is given.

    @classmethod
    def of(cls, design: Design) -> Outline:
        """Return the outline that a design draws; corners that only fabrication rounds are drawn sharp."""
        cell, unit_nm = design.unit_cell.cell, design.mask.database_unit_nm
        radius_dbu = (cell.corner_radius_nm or 0.0) / unit_nm if design.mask.draw_corners else 0.0
        shape: Shape = "ellipse" if cell.shape == "circle" else cell.shape
        wall_nm, hole_nm = design.drawn_ring_nm
        return cls(
            "rounded" if radius_dbu else shape, unit_nm, radius_dbu, round(wall_nm / unit_nm), round(hole_nm / unit_nm)
        )

    @property
    def is_rectangle(self) -> bool:
        """Whether pillars are drawn as rectangles."""
        return self.shape == "rectangle"

    @property
    def tolerance_nm(self) -> float:
        """Largest distance of the polygon from the curve that it approximates; 0 if it is exact."""
        exact = self.shape in {"rectangle", "cross"}
        return 0.0 if exact else CHORD_NM + math.sqrt(0.5) * self.database_unit_nm

    @property
    def kind(self) -> int:
        """Number of the shape in compiled kernels: 0 rectangle, 1 rounded, 2 ellipse or ring, 3 cross."""
        return _KINDS[self.shape]

    def boxes(self, size_dbu: NDArray[np.int32]) -> NDArray[np.int32]:
        """Width and length of the bounding box of each size, shape (n, 2) like the sizes; that of a cross is square."""
        if self.shape != "cross":
            return size_dbu
        return np.asarray(np.repeat(size_dbu.max(axis=1, keepdims=True), 2, axis=1))

    def walls_and_holes(self, size_dbu: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Walls along x and y, shape (n, 2) like the sizes, and diameters of the holes, shape (n,), of drawn rings.

        Other shapes have no holes: the sizes themselves, and the largest integer, which keeps every rule of gaps.
        """
        if self.shape != "ring":
            return size_dbu, np.full(len(size_dbu), np.iinfo(np.int32).max, dtype=np.int32)
        hole = np.array([self.hole_of(width) for width in size_dbu[:, 0].tolist()], dtype=np.int32)
        return (size_dbu - hole[:, None]) // 2, hole

    def vertices(self, width_dbu: int, length_dbu: int) -> IntArray:
        """Corners relative to the centre, counter-clockwise, shape (n, 2); width and length are even numbers."""
        return _vertices(self, width_dbu, length_dbu)

    def polygons(self, size_dbu: NDArray[np.int64]) -> tuple[IntArray, ...]:
        """Vertices of each size index about its centre, shape (n, 2) each; a single point for index 0, no pillar.

        Sizes are even numbers, shape (n_sizes + 1, 2).
        """
        nothing = np.zeros((1, 2), dtype=np.int64)
        return nothing, *(self.vertices(width, length) for width, length in size_dbu[1:].tolist())

    def area(self, size_dbu: NDArray[np.int32]) -> FloatArray:
        """Area of the polygon of each size, shape (n,), squared database units, multiples of one half.

        Sizes are widths and lengths, shape (n, 2); the size (0, 0) has the area 0.
        """
        if self.is_rectangle:
            return np.asarray(np.prod(size_dbu.astype(np.float64), axis=1))
        return np.array([polygon_area(self.vertices(w, h)) if w else 0.0 for w, h in size_dbu.tolist()])

    def size_of(self, polygon: IntArray) -> tuple[int, int] | None:
        """(width, length) of the pillar whose outline is ``polygon``, shape (n, 2); None if there is no such pillar.

        The first corner, the sense of rotation and corners on straight sides make no difference. The width of a cross
        is the larger one.
        """
        if self.shape == "ring":
            return self._ring_of(polygon)
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        (width, length), twice_centre = (high - low).tolist(), low + high
        if width <= 0 or length <= 0 or width % 2 or length % 2:
            return None
        centred = canonical_polygon(2 * polygon - twice_centre) // 2
        if self.shape == "cross":
            corners = centred[(centred[:, 0] > 0) & (centred[:, 1] > 0)]
            length = 2 * int(corners.min(initial=width))
        if length <= 0 or not np.array_equal(centred, canonical_polygon(self.vertices(width, length))):
            return None
        return width, length

    def _ring_of(self, polygon: IntArray) -> tuple[int, int] | None:
        """(outer diameter, outer diameter) of a ring with its slit anywhere; None for other shapes."""
        loops, circle = _loops(polygon), Outline("ellipse", self.database_unit_nm)
        sizes = sorted((size for loop in loops if (size := circle.size_of(loop)) is not None), reverse=True)
        centres = {tuple((loop.min(axis=0) + loop.max(axis=0)).tolist()) for loop in loops}
        if len(loops) != 2 or len(sizes) != 2 or len(centres) != 1:
            return None
        outer, hole = sizes
        return outer if outer[0] == outer[1] and hole == (self.hole_of(outer[0]),) * 2 else None

    def hole_of(self, width_dbu: int) -> int:
        """Diameter of the hole of a drawn ring with an outer diameter, all in database units."""
        return width_dbu - 2 * self.wall_dbu if self.wall_dbu else self.hole_dbu


#: Outline of rectangular pillars, for any database unit.
RECTANGLE = Outline("rectangle", 1.0)


def canonical_polygon(polygon: IntArray) -> IntArray:
    """Return a polygon counter-clockwise from its lowest, then leftmost, corner, without corners on straight sides.

    Corners of shape (n, 2) in either sense give (m, 2) with m <= n; (0, 2) if the polygon has no area.
    """
    distinct = polygon[np.any(polygon != np.roll(polygon, 1, axis=0), axis=1)]
    before, after = np.roll(distinct, 1, axis=0) - distinct, np.roll(distinct, -1, axis=0) - distinct
    corners = distinct[before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]]
    if not len(corners):
        return np.zeros((0, 2), dtype=np.int64)
    if polygon_area(corners) < 0.0:
        corners = corners[::-1]
    return np.asarray(np.roll(corners, -int(np.lexsort((corners[:, 0], corners[:, 1]))[0]), axis=0))


def polygon_area(polygon: IntArray) -> float:
    """Signed area of a polygon of shape (n, 2), positive if it runs counter-clockwise."""
    x, y = polygon.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0


@lru_cache(maxsize=1 << 16)
def _vertices(outline: Outline, width: int, length: int) -> IntArray:
    half = np.array([width // 2, length // 2], dtype=np.int64)
    quadrant = half[None]
    if outline.shape == "cross" and width != length:
        arm, reach = sorted(half.tolist())
        quadrant = np.array([[reach, arm], [arm, arm], [arm, reach]], dtype=np.int64)
    elif outline.shape in {"ellipse", "rounded", "ring"}:
        radii_dbu = half.astype(np.float64)
        if outline.shape == "rounded":
            radii_dbu = np.full(2, min(outline.radius_dbu, *half.tolist()))
        arc = (half - radii_dbu) + radii_dbu * _tangent_polygon(radii_dbu.max() * outline.database_unit_nm)
        quadrant = np.rint(arc).astype(np.int64)
    upper = np.concatenate([quadrant, quadrant[::-1] * [-1, 1]])
    around = canonical_polygon(np.concatenate([upper, -upper]))
    if outline.shape != "ring":
        return around
    hole = outline.hole_of(width)
    if not 0 < hole < width:
        raise ValueError(f"no ring of {outline} has an outer diameter of {width} database units")
    within = _vertices(Outline("ellipse", outline.database_unit_nm), hole, hole)
    return canonical_polygon(np.concatenate([_from_axis(around), _from_axis(within)[::-1]]))


def _loops(polygon: IntArray) -> list[IntArray]:
    """Closed loops of a polygon of shape (n, 2) without its slits, sides that it runs along both ways."""
    corners = [tuple(corner) for corner in polygon.tolist()]
    sides = {side for side in zip(corners, [*corners[1:], corners[0]], strict=True) if side[0] != side[1]}
    after = {begin: end for begin, end in sides if (end, begin) not in sides}
    loops = []
    while after:
        loop, place = [], next(iter(after))
        while place in after:
            loop.append(place)
            place = after.pop(place)
        loops.append(np.array(loop, dtype=np.int64))
    return loops


def _from_axis(polygon: IntArray) -> IntArray:
    """The polygon of shape (n, 2) closed at its point on +x: shape (n + 2, 2), counter-clockwise from there."""
    first = int(np.argmax(np.where(polygon[:, 1] >= 0, polygon[:, 0] - 1e-9 * polygon[:, 1], -np.inf)))
    start = np.array([[polygon[first, 0], 0]])
    return np.concatenate([start, np.roll(polygon, -first, axis=0), start])


def _tangent_polygon(radius_nm: float) -> FloatArray:
    """Corners in the first quadrant of a regular polygon around the unit circle, whose sides touch it at the axes."""
    sides = 4 * math.ceil(math.pi / math.acos(radius_nm / (radius_nm + CHORD_NM)) / 4.0)
    angle = (np.arange(sides // 4) + 0.5) * (2.0 * math.pi / sides)
    x = np.cos(angle) / math.cos(math.pi / sides)
    x[0] = 1.0  # without rounding error, so that the outermost side lies on the bounding box
    return np.stack([x, x[::-1]], axis=1)


@compiled
def _rectangle_distance(gap_x: float, gap_y: float) -> float:
    """Distance between two rectangles with these gaps along the axes; minus the depth if they overlap."""
    depth = max(gap_x, gap_y)
    return float(depth if depth < 0.0 else np.sqrt(max(gap_x, 0.0) ** 2 + max(gap_y, 0.0) ** 2))


@compiled
def _separation(angle: float, x: float, y: float, a: FloatArray, b: FloatArray) -> float:
    """Separation of two ellipses of sizes ``a`` and ``b`` along a direction; its maximum is their distance."""
    c, s = np.cos(angle), np.sin(angle)
    reach = np.sqrt((a[0] * c) ** 2 + (a[1] * s) ** 2) + np.sqrt((b[0] * c) ** 2 + (b[1] * s) ** 2)
    return float(x * c + y * s - 0.5 * reach)


@compiled
def _ellipse_distance(x: float, y: float, a: FloatArray, b: FloatArray) -> float:
    """Largest separation over all directions: 17 samples of a quarter turn, then ternary search."""
    best, step = 0, 0.5 * np.pi / 16
    for k in range(1, 17):
        if _separation(k * step, x, y, a, b) > _separation(best * step, x, y, a, b):
            best = k
    low, high = max((best - 1) * step, 0.0), min((best + 1) * step, 0.5 * np.pi)
    for _ in range(40):
        third = (high - low) / 3.0
        if _separation(low + third, x, y, a, b) < _separation(high - third, x, y, a, b):
            low += third
        else:
            high -= third
    return float(_separation(0.5 * (low + high), x, y, a, b))


@compiled
def distance(kind: int, radius: float, x: float, y: float, a: FloatArray, b: FloatArray) -> float:
    """Distance between two pillars of sizes (width, length) ``a`` and ``b``, shape (2,); negative if they overlap.

    ``kind`` is :attr:`Outline.kind`; for round outlines the curve is meant, not its polygon. ``x`` and ``y``, at least
    0, are the distances between the centres.
    """
    gap_x, gap_y = x - 0.5 * (a[0] + b[0]), y - 0.5 * (a[1] + b[1])
    if kind == 1:
        # A rounded rectangle is a smaller rectangle grown by the radius in all directions.
        rounds = min(radius, 0.5 * a[0], 0.5 * a[1]) + min(radius, 0.5 * b[0], 0.5 * b[1])
        return float(_rectangle_distance(gap_x + rounds, gap_y + rounds) - rounds)
    if kind == 2:
        return _ellipse_distance(x, y, a, b)
    if kind == 3:
        turned = _rectangle_distance(x - 0.5 * (a[1] + b[1]), y - 0.5 * (a[0] + b[0]))
        one = _rectangle_distance(x - 0.5 * (a[0] + b[1]), y - 0.5 * (a[1] + b[0]))
        other = _rectangle_distance(x - 0.5 * (a[1] + b[0]), y - 0.5 * (a[0] + b[1]))
        return min(_rectangle_distance(gap_x, gap_y), turned, one, other)
    return _rectangle_distance(gap_x, gap_y)
