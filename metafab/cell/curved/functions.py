"""Functions of a quarter cell: their numbers over the elements, and their values at quadrature points.

The transverse E is a sum of edge elements (Nedelec) of one polynomial order p, E_z of continuous ones: on each element
the products of :mod:`metafab.cell.elements.line`. Neighbours share the functions of their common side. On mirror
planes at which E is normal, tangential E and E_z vanish: the functions of these sides are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.curved.mesh import Point, Quad, QuarterMesh
from metafab.cell.elements.basis import Element
from metafab.cell.elements.line import shapes
from metafab.cell.rcwa.basis.coordinates import IntArray
from metafab.core.conventions import POLARISATIONS, FloatArray, Polarisation

#: Quadrature nodes along a side beyond the order.
_NODES = 5
#: Digits after the point, nm, to which two elements must agree on a common vertex.
_DIGITS = 6
#: Digits after the point to which shares of a period are rounded.
_SHARE_DIGITS = 9

#: Numbers of functions, -1 for those that are left out, and the factor from each to the function of an element.
_Numbers = tuple[IntArray, FloatArray]


@dataclass(frozen=True)
class Functions:
    """Functions of a quarter cell for one symmetry of the light."""

    elements: tuple[Element, ...]  #: Values of the functions on each element.
    gradient: FloatArray  #: Shape (n_e, n_z), gradient of each function of E_z among those of E.


def functions_of(mesh: QuarterMesh, light: Polarisation, order: int) -> Functions:
    """Number and evaluate the functions of a polynomial order, from 2, on the elements of the quarter.

    ``light`` is the incident polarisation: tangential E vanishes on the mirror planes that it is normal to.
    """
    numbering = _Numbering(mesh, light, order)
    numbered = [numbering.of_element(quad) for quad in mesh.quads]
    gradient = np.zeros((numbering.n_e, numbering.n_z))
    elements = []
    for quad, (along_u, along_v, along_z) in zip(mesh.quads, numbered, strict=True):
        elements.append(_element(quad, quad.orders(order), (along_u, along_v, along_z)))
        # Gradient of N_i(u) N_j(v): N_i' is a sum of edge functions along u, and likewise along v.
        turned = tuple(each.T for each in along_z)
        of_u, of_v = (shapes(each, np.zeros(1)).slope for each in quad.orders(order))
        for slope, (number, sign), (z, sign_z) in (
            (of_u, along_u, along_z),
            (of_v, (along_v[0].T, along_v[1].T), turned),
        ):
            for i, k in np.argwhere(slope):
                both = (number[k] >= 0) & (z[i] >= 0)
                gradient[number[k][both], z[i][both]] = slope[i, k] * (sign[k] * sign_z[i])[both]
    return Functions(tuple(elements), gradient)


def _element(quad: Quad, orders: tuple[int, int], numbers: tuple[_Numbers, _Numbers, _Numbers]) -> Element:
    """Values of the functions of one element of ``orders`` along u and v."""
    count = max(orders) + _NODES
    node, weight = np.polynomial.legendre.leggauss(count)
    (u, v), place = (shapes(order, node) for order in orders), quad.geometry(node, node)
    zero = np.zeros(1)

    def product(of_u: FloatArray, of_v: FloatArray) -> FloatArray:
        return (of_u[:, None, :, None] * of_v[None, :, None, :]).reshape(-1, count, count)

    def kept(values: FloatArray, at: list[_Numbers]) -> tuple[IntArray, FloatArray]:
        number, sign = (np.concatenate([each[i].ravel() for each in at]) for i in (0, 1))
        some = number >= 0
        signed = values[..., some, :, :] * sign[some, None, None]
        return number[some], signed.reshape(*signed.shape[:-2], count * count)

    along_u, along_v, along_z = numbers
    e_u, e_v = place.physical(product(u.edge, v.nodal), zero), place.physical(zero, product(u.nodal, v.edge))
    curl = np.concatenate([-product(u.edge, v.nodal_slope), product(u.nodal_slope, v.edge)]) / place.area
    at_e, fields = kept(np.concatenate([np.stack(e_u), np.stack(e_v)], axis=1), [along_u, along_v])
    at_z, e_z = kept(product(u.nodal, v.nodal), [along_z])
    return Element(
        place=at_e,
        e=fields,
        curl=kept(curl, [along_u, along_v])[1],
        place_z=at_z,
        e_z=e_z,
        weight=(np.multiply.outer(weight, weight) * np.abs(place.area)).ravel(),
        at=np.stack([place.x.ravel(), place.y.ravel()]),
        is_pillar=quad.inside,
    )


class _Numbering:
    """Numbers of the functions, given in the order in which elements ask for them.

    Attributes:
        n_e: functions of E numbered so far.
        n_z: functions of E_z numbered so far.
    """

    def __init__(self, mesh: QuarterMesh, light: Polarisation, order: int) -> None:
        self._mesh, self._axis, self._order = mesh, POLARISATIONS.index(light), order
        self._turned_about = None if mesh.turned_about_nm is None else _rounded(mesh.turned_about_nm)
        self._vertices: dict[Point, int] = {}
        self._sides: dict[tuple[Point, Point, bool], tuple[IntArray, IntArray]] = {}
        self.n_e = self.n_z = 0

    def of_element(self, quad: Quad) -> tuple[_Numbers, _Numbers, _Numbers]:
        """Numbers of E along u, shape (p, q + 1), along v, (p + 1, q), and of E_z, (p + 1, q + 1)."""
        p, q = orders = quad.orders(self._order)
        numbers = np.empty((p, q + 1), np.intp), np.empty((p + 1, q), np.intp), np.empty((p + 1, q + 1), np.intp)
        signs = np.ones((p, q + 1)), np.ones((p + 1, q)), np.ones((p + 1, q + 1))
        for i, side in enumerate(quad.sides):
            axis, end = divmod(i, 2)
            of_e, of_z, sign = self._side(*side, orders[axis])
            # A side has every function along it, and across it only the linear one that is 1 there.
            if axis == 0:
                numbers[0][:, end], numbers[2][2:, end] = of_e, of_z
                signs[0][:, end], signs[2][2:, end] = sign, sign
            else:
                numbers[1][end], numbers[2][end, 2:] = of_e, of_z
                signs[1][end], signs[2][end, 2:] = sign, sign
        for corner, at in zip(quad.corners_nm, ((0, 0), (1, 0), (1, 1), (0, 1)), strict=True):
            numbers[2][at], signs[2][at] = self._vertex(corner)
        numbers[0][:, 2:], numbers[1][2:], numbers[2][2:, 2:] = (
            self._new_e(p * (q - 1)).reshape(p, q - 1),
            self._new_e((p - 1) * q).reshape(p - 1, q),
            self._new_z((p - 1) * (q - 1)).reshape(p - 1, q - 1),
        )
        along_u, along_v, along_z = zip(numbers, signs, strict=True)
        return along_u, along_v, along_z

    def _side(self, begin: Point, end: Point, order: int) -> tuple[IntArray, IntArray, float]:
        """Numbers of E along a side, shape (p,), and of E_z within it, shape (p - 1,), and the sign of both."""
        (one, sign), (other, of_end) = self._canonical(begin), self._canonical(end)
        if self._is_on_cut(begin) and self._is_on_cut(end):
            sign, sense = min(sign, of_end), one < other  # the middle of a turn is its own image
        else:
            one, other, sign = self._repeated(begin), self._repeated(end), 1.0
            # In a period of two sites, two sides with the same ends run in opposite senses.
            sense = _rounded(begin) < _rounded(end)
        ends = one, other
        if (*ends, sense) not in self._sides:
            if (*ends[::-1], not sense) in self._sides:
                raise ValueError(f"the side from {one} to {other} runs against that of its neighbour")
            left_out = self._is_normal(one, other)
            self._sides[*ends, sense] = (
                (np.full(order, -1), np.full(order - 1, -1))
                if left_out
                else (self._new_e(order), self._new_z(order - 1))
            )
        return (*self._sides[*ends, sense], sign)

    def _vertex(self, point: Point) -> tuple[int, float]:
        at, sign = self._canonical(point)
        if at not in self._vertices:
            left_out = self._is_normal(at) or at == self._turned_about
            self._vertices[at] = -1 if left_out else int(self._new_z(1)[0])
        return self._vertices[at], sign

    def _canonical(self, point: Point) -> tuple[Point, float]:
        """Vertex that numbers the functions at ``point``, and their sign: on a half's cut, the half turn's image."""
        centre = self._mesh.turned_about_nm
        if centre is None or not self._is_on_cut(point) or point[0] > centre[0] * (1.0 - 1e-9):
            return self._repeated(point), 1.0
        return _rounded((2.0 * centre[0] - point[0], 2.0 * centre[1] - point[1])), -1.0

    def _repeated(self, point: Point) -> Point:
        """The point in the first period that has the functions of ``point``."""
        # Shares of the period are rounded, not lengths: of a rounded length, the period need not be a multiple.
        x, y = (
            round(at / period, _SHARE_DIGITS) % 1.0 * period if repeats else at
            for at, period, repeats in zip(point, self._mesh.half_nm, self._mesh.repeats, strict=True)
        )
        return _rounded((x, y))

    def _is_on_cut(self, point: Point) -> bool:
        """Whether a point lies on the diagonal that cuts a hexagonal lattice's quarter in halves."""
        (x, y), half = point, self._mesh.half_nm
        return self._mesh.turned_about_nm is not None and abs(x / half[0] + y / half[1] - 1.0) < 1e-9

    def _is_normal(self, *points: Point) -> bool:
        """Whether the points lie on one mirror plane at which E is normal."""
        if self._mesh.repeats[self._axis]:
            return False
        planes = (0.0, round(self._mesh.half_nm[self._axis], _DIGITS))
        return any(all(point[self._axis] == plane for point in points) for plane in planes)

    def _new_e(self, count: int) -> IntArray:
        self.n_e += count
        return np.arange(self.n_e - count, self.n_e)

    def _new_z(self, count: int) -> IntArray:
        self.n_z += count
        return np.arange(self.n_z - count, self.n_z)


def _rounded(point: Point) -> Point:
    """A point as a key: rounded, with 0 for -0."""
    return round(point[0], _DIGITS) + 0.0, round(point[1], _DIGITS) + 0.0
