"""Quarter of a cell cut into curved quadrilaterals: ellipses, rings, and rectangles with rounded corners.

The quarter reaches from the middle of the pillar to half a period. Mirror planes bound it. A quadrilateral is the
square -1..1 mapped onto a patch between four sides, each straight or an elliptic arc, by transfinite interpolation of
the sides (Gordon and Hall, Numer. Math. 21, 109, 1973). A coordinate may be gathered towards an end that lies on the
outline, where the field at the pillar's rims is singular: dx/du falls there to ``_SLOPE`` times its mean, as in
adaptive spatial resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.elements.mesh import Geometry
from metafab.cell.pillar import PillarCell
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault

#: A point (x, y), nm from the middle of the pillar.
Point = tuple[float, float]
#: Slope of a gathered coordinate at the end that it is gathered at, over its mean.
_SLOPE = 0.1
#: Corners of the square in the middle of a quarter disc, over its radius: on the axes, and on the diagonal.
_ON_AXIS, _ON_DIAGONAL = 0.55, 0.45
#: Smallest gap between pillars, as a share of the period: below it elements degenerate.
_SMALLEST_GAP = 0.02
#: Flat side of a rounded rectangle below which it is left out, as a share of the size.
_NO_SIDE = 1e-3
#: Phase of light along an element per additional order, rad, and most additional orders (rounded rectangles).
_PER_ORDER_RAD, _MOST_ORDERS = 1.6, 2


@dataclass(frozen=True)
class Arc:
    """Part of an ellipse with its axes along x and y."""

    centre_nm: Point  #: Centre.
    half_nm: Point  #: Half axes along x and y.
    from_rad: float  #: Eccentric anomaly where the arc begins.
    to_rad: float  #: Eccentric anomaly where it ends.

    def at(self, share: float) -> Point:
        """The point at a share of the arc, 0 to 1."""
        angle = self.from_rad + share * (self.to_rad - self.from_rad)
        return (
            self.centre_nm[0] + self.half_nm[0] * math.cos(angle),
            self.centre_nm[1] + self.half_nm[1] * math.sin(angle),
        )

    def part(self, begin: float, end: float) -> Arc:
        """The arc between two shares; reversed where ``begin`` exceeds ``end``."""
        span = self.to_rad - self.from_rad
        return Arc(self.centre_nm, self.half_nm, self.from_rad + begin * span, self.from_rad + end * span)

    def points(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and their derivatives by ``u``, -1 to 1; each of shape (2, n)."""
        slope = 0.5 * (self.to_rad - self.from_rad)
        angle = self.from_rad + slope * (u + 1.0)
        centre, half = np.array(self.centre_nm)[:, None], np.array(self.half_nm)[:, None]
        cosine, sine = np.cos(angle), np.sin(angle)
        return centre + half * np.stack([cosine, sine]), slope * half * np.stack([-sine, cosine])


@dataclass(frozen=True)
class Quad:
    """One element."""

    corners_nm: tuple[Point, Point, Point, Point]  #: Points at (u, v) = (-1, -1), (1, -1), (1, 1) and (-1, 1).
    inside: bool  #: Whether it lies in the pillar.
    bottom: Arc | None = None  #: Arc of the side v = -1, along u; None for a straight side. Likewise the others.
    top: Arc | None = None  #: Arc of the side v = 1, along u.
    left: Arc | None = None  #: Arc of the side u = -1, along v.
    right: Arc | None = None  #: Arc of the side u = 1, along v.
    #: Ends (of u, of v) at which the coordinate is gathered: -1 or 1, 0 for none. Elements that share a side gather
    #: along it alike.
    gathered: tuple[int, int] = (0, 0)

    #: Polynomial orders (along u, along v) beyond the mesh's. Elements that share a side have one order along it.
    extra: tuple[int, int] = (0, 0)

    def orders(self, order: int) -> tuple[int, int]:
        """Polynomial orders along u and v where the mesh has ``order``."""
        return max(1, order + self.extra[0]), max(1, order + self.extra[1])

    @property
    def sides(self) -> tuple[tuple[Point, Point], ...]:
        """Start and end of the sides bottom, top, left and right."""
        a, b, c, d = self.corners_nm
        return (a, b), (d, c), (a, d), (b, c)

    def geometry(self, at_u: FloatArray, at_v: FloatArray) -> Geometry:
        """The map at the products of coordinates along u, shape (n_u,), and along v, shape (n_v,)."""
        (u, by_u), (v, by_v) = _gathered(at_u, self.gathered[0]), _gathered(at_v, self.gathered[1])
        curves = (self.bottom, self.top, self.left, self.right)
        places = (u, u, v, v)
        (low, d_low), (high, d_high), (left, d_left), (right, d_right) = (
            _straight(*ends, place) if arc is None else arc.points(place)
            for arc, ends, place in zip(curves, self.sides, places, strict=True)
        )
        corners = np.array(self.corners_nm).T  # (x, y) by corner
        of_u, of_v = np.stack([0.5 * (1.0 - u), 0.5 * (1.0 + u)]), np.stack([0.5 * (1.0 - v), 0.5 * (1.0 + v)])
        half_u, half_v = _slopes(u), _slopes(v)

        def blend(
            rows: tuple[FloatArray, FloatArray],
            columns: tuple[FloatArray, FloatArray],
            u_hats: FloatArray,
            v_hats: FloatArray,
        ) -> FloatArray:
            along_u = rows[0][:, :, None] * v_hats[0] + rows[1][:, :, None] * v_hats[1]
            along_v = columns[0][:, None, :] * u_hats[0][:, None] + columns[1][:, None, :] * u_hats[1][:, None]
            hats = np.stack([np.multiply.outer(u_hats[i], v_hats[j]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
            return np.asarray(along_u + along_v - np.tensordot(corners, hats, axes=1))

        x, y = blend((low, high), (left, right), of_u, of_v)
        x_u, y_u = blend((d_low, d_high), (left, right), half_u, of_v) * by_u[:, None]
        x_v, y_v = blend((low, high), (d_left, d_right), of_u, half_v) * by_v
        return Geometry(x, y, x_u, x_v, y_u, y_v)


def _straight(begin: Point, end: Point, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points of a straight side and their derivatives, each of shape (2, n)."""
    middle, half = 0.5 * np.add(begin, end)[:, None], 0.5 * np.subtract(end, begin)[:, None]
    return middle + half * u, half * np.ones_like(u)


def _slopes(u: FloatArray) -> FloatArray:
    """Derivatives of the two linear functions, shape (2, n)."""
    return np.stack([np.full_like(u, -0.5), np.full_like(u, 0.5)])


def _gathered(u: FloatArray, end: int) -> tuple[FloatArray, FloatArray]:
    """The gathered coordinate and its derivative: quadratic, -1 to 1."""
    bend = end * (1.0 - _SLOPE)
    return u + 0.5 * bend * (1.0 - u**2), 1.0 - bend * u


@dataclass(frozen=True)
class QuarterMesh:
    """Elements of a quarter cell."""

    quads: tuple[Quad, ...]  #: The elements.
    half_nm: Point  #: (x, y) size of the quarter.
    #: Middle of the quarter, about which a half turn brings the elements to the other half of a hexagonal lattice's
    #: quarter; None where they fill the quarter.
    turned_about_nm: Point | None = None
    #: Whether the elements repeat along x and along y, after ``half_nm`` each, instead of ending at mirror planes.
    repeats: tuple[bool, bool] = (False, False)


def is_treated(cell: PillarCell) -> bool:
    """Whether :func:`quarter_mesh` has elements for a cell, and light and layers keep its symmetry."""
    return not untreated(cell)


def untreated(cell: PillarCell) -> list[Fault]:
    """Faults of a cell that has no elements.

    Elements exist for upright ellipses, rings and rounded rectangles of dielectrics, with a gap between pillars, under
    light along z. Layers have the pillar's own outline or none.
    """
    purpose = "spectral elements"
    faults = cell.untreated(purpose, treated=("under, over", "is_staggered", "shape, corner_radius_nm"))
    shapes = "an ellipse or a ring" if cell.is_staggered else "an ellipse, a ring or a rounded rectangle"
    is_rounded = cell.shape == "rectangle" and cell.corner_radius_nm > 0.0 and not cell.is_staggered
    if cell.shape not in {"ellipse", "ring"} and not is_rounded:
        faults.append(Fault("shape, corner_radius_nm", f"{shapes} for {purpose}", cell.shape))
    half_nm, radius_nm = _sizes(cell)
    reach = [radius / half for radius, half in zip(radius_nm, half_nm, strict=True)]
    reached = math.hypot(*reach) if cell.is_staggered else max(reach)
    if min(radius_nm) <= 0.0:
        got = f"{cell.width_nm:g} x {cell.length_nm:g} nm"
        faults.append(Fault("width_nm, length_nm", f"sizes above 0 for {purpose}", got))
    elif reached > 1.0 - _SMALLEST_GAP:
        largest = [2.0 * radius * (1.0 - _SMALLEST_GAP) / reached for radius in radius_nm]
        expected = f"at most {largest[0]:.4g} x {largest[1]:.4g} nm, of pillars of this form, for {purpose}"
        faults.append(Fault("width_nm, length_nm", expected, f"{cell.width_nm:g} x {cell.length_nm:g} nm"))
    layers = (*cell.under, *cell.over)
    if any(each.n_inside != each.n_around and (each.width_nm, each.length_nm) != (None, None) for each in layers):
        faults.append(Fault("under, over", f"layers of the pillar's outline for {purpose}", "another outline"))
    indices = {
        "n_pillar": (cell.n_pillar,),
        "n_ambient": (cell.n_ambient,),
        "n_substrate": cell.n_substrate,
        "under, over": [n for each in layers for n in (each.n_inside, each.n_around)],
    }
    for name, values in indices.items():
        metals = [n for n in map(complex, values) if (n**2).real <= 0.0]
        if metals:
            faults.append(Fault(name, f"dielectrics for {purpose}", f"the index of a metal, {metals[0]:g}"))
    return faults


def quarter_mesh(cell: PillarCell) -> QuarterMesh:
    """Elements of a cell that :func:`is_treated`.

    A hexagonal lattice takes the half of the quarter of its centred cell of two rows that lies about one pillar.
    """
    half_nm, radius_nm = _sizes(cell)
    if cell.shape == "rectangle":
        return _rounded(cell, half_nm, radius_nm)
    arc = Arc((0.0, 0.0), radius_nm, 0.0, 0.5 * math.pi)
    middle = (0.5 * half_nm[0], 0.5 * half_nm[1]) if cell.is_staggered else None
    around = _around(arc, (half_nm[0], 0.0), middle or half_nm, (0.0, half_nm[1]))
    if cell.shape == "ring":
        hole, wall = (
            replace(arc, half_nm=(0.5 * size, 0.5 * size))
            for size in (cell.hole_nm, 0.5 * (cell.hole_nm + cell.width_nm))
        )
        inside = (*_disc(hole, inside=False), *_between(hole, wall, -1), *_between(wall, arc, 1))
        return QuarterMesh((*inside, *around), half_nm, middle)
    return QuarterMesh((*_disc(arc), *around), half_nm, middle)


def _sizes(cell: PillarCell) -> tuple[Point, Point]:
    """(x, y) of the quarter and of half the pillar, nm; the rows of a hexagonal lattice are half its centred cell."""
    period_x, period_y = cell.period_nm
    half_nm = (0.5 * period_x, period_y if cell.is_staggered else 0.5 * period_y)
    return half_nm, (0.5 * cell.width_nm, 0.5 * cell.length_nm)


def _rounded(cell: PillarCell, half_nm: Point, size_nm: Point) -> QuarterMesh:
    """A rectangle of half size ``size_nm`` with rounded corners, in up to eight elements, and the gap around it.

    The gap has the order of the mesh, the pillar one less, as the field varies most beside the outline's walls. Each
    rises with the phase of light along the element.
    """
    (far_x, far_y), (x3, y3) = half_nm, size_nm
    radius_nm = min(cell.corner_radius_nm, x3, y3)
    x1, y1 = (0.0 if size - radius_nm < _NO_SIDE * size else size - radius_nm for size in size_nm)
    arc = Arc((x1, y1), (x3 - x1, y3 - y1), 0.0, 0.5 * math.pi)
    layers = (*cell.under, *cell.over)
    outside = max(map(abs, (cell.n_ambient, *cell.n_substrate, *(each.n_around for each in layers))))
    densest = max(outside, *map(abs, (cell.n_pillar, *(each.n_inside for each in layers))))

    def rise(length_nm: float, n: float) -> int:
        return min(_MOST_ORDERS, int(cell.k0_per_nm * n * length_nm / _PER_ORDER_RAD))

    flat_x, flat_y, corner = (rise(length_nm, densest) - 1 for length_nm in (x1, y1, 2.0 * radius_nm))
    gap = rise(max(far_x - x3, far_y - y3), outside)
    disc = _disc(arc, extra=corner)
    x2, y2 = disc[0].corners_nm[1][0], disc[0].corners_nm[3][1]

    def box(
        x: Point, y: Point, extra: tuple[int, int], gathered: tuple[int, int] = (0, 0), *, inside: bool = True
    ) -> list[Quad]:
        points = (x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])
        return [Quad(points, inside, gathered=gathered, extra=extra)] if x[1] > x[0] and y[1] > y[0] else []

    quads = [
        *box((0.0, x1), (0.0, y1), (flat_x, flat_y)),
        *box((x1, x2), (0.0, y1), (corner, flat_y)),
        *box((x2, x3), (0.0, y1), (corner, flat_y), (1, 0)),
        *box((0.0, x1), (y1, y2), (flat_x, corner)),
        *box((0.0, x1), (y2, y3), (flat_x, corner), (0, 1)),
        *disc,
        *box((x3, far_x), (0.0, y1), (gap, flat_y), (-1, 0), inside=False),
        *box((0.0, x1), (y3, far_y), (flat_x, gap), (0, -1), inside=False),
        *_around(arc, (far_x, y1), half_nm, (x1, far_y), extra=(corner, gap)),
    ]
    return QuarterMesh(tuple(quads), half_nm)


def _disc(arc: Arc, *, inside: bool = True, extra: int = 0) -> tuple[Quad, Quad, Quad]:
    """A quarter disc within its arc of a quarter turn, with ``extra`` orders."""
    o = arc.centre_nm
    begin, middle, end = (arc.at(share) for share in (0.0, 0.5, 1.0))

    def within(one: Point, other: Point, share: float) -> Point:
        return (o[0] + share * (one[0] + other[0] - 2.0 * o[0]), o[1] + share * (one[1] + other[1] - 2.0 * o[1]))

    a, b, c = within(begin, o, _ON_AXIS), within(end, o, _ON_AXIS), within(begin, end, _ON_DIAGONAL)
    return (
        Quad((o, a, c, b), inside, extra=(extra, extra)),
        Quad((a, begin, middle, c), inside, right=arc.part(0.0, 0.5), gathered=(1, 0), extra=(extra, extra)),
        Quad((b, c, middle, end), inside, top=arc.part(1.0, 0.5), gathered=(0, 1), extra=(extra, extra)),
    )


def _between(inner: Arc, outer: Arc, gathered: int) -> tuple[Quad, Quad]:
    """A quarter of a pillar's wall between two arcs, gathered at the inner (-1) or the outer one (1)."""
    (a, b, c), (d, e, f) = ([arc.at(share) for share in (0.0, 0.5, 1.0)] for arc in (inner, outer))
    return (
        Quad((a, d, e, b), True, left=inner.part(0.0, 0.5), right=outer.part(0.0, 0.5), gathered=(gathered, 0)),
        Quad((c, b, e, f), True, bottom=inner.part(1.0, 0.5), top=outer.part(1.0, 0.5), gathered=(0, gathered)),
    )


def _around(
    arc: Arc, beside: Point, beyond: Point, above: Point, *, extra: tuple[int, int] = (0, 0)
) -> tuple[Quad, Quad]:
    """The two elements between an arc and the points beside its start, beyond its middle and above its end.

    ``extra`` are the additional orders along the arc and across the gap.
    """
    begin, middle, end = (arc.at(share) for share in (0.0, 0.5, 1.0))
    right = Quad((begin, beside, beyond, middle), inside=False, left=arc.part(0.0, 0.5), gathered=(-1, 0))
    top = Quad((end, middle, beyond, above), inside=False, bottom=arc.part(1.0, 0.5), gathered=(0, -1))
    return replace(right, extra=extra[::-1]), replace(top, extra=extra)
