"""Curved quadrilaterals: the square -1..1 mapped onto a patch between four sides, each straight or an elliptic arc.

The map is transfinite interpolation of the four sides (Gordon and Hall, Numer. Math. 21, 109, 1973). A coordinate may
be gathered towards an end that lies on the outline, where the field at the pillar's rims is singular: dx/du falls there
to ``_SLOPE`` times its mean, as in adaptive spatial resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.cell.elements.mesh import Geometry
from metafab.core.conventions import FloatArray

#: A point (x, y), nm from the middle of the pillar.
Point = tuple[float, float]
#: Slope of a gathered coordinate at the end that it is gathered at, over its mean.
_SLOPE = 0.1


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
        """Begin and end of the sides bottom, top, left and right."""
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
