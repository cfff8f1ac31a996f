"""Polynomial functions on one side of an element, -1 to 1, and their numbers along an axis, periodic or mirrored.

Along each side a component of E is either continuous from element to element (*nodal*: the two vertex functions, then
integrated Legendre polynomials, which vanish at both ends) or not (*edge*: Legendre polynomials). The derivative of a
nodal function is an edge function (Schoeberl and Zaglmayr, COMPEL 24, 374, 2005).

In a row that is its own mirror image along x each function is paired with its image. Light along the axis keeps E_x
even and E_y odd (x light), or the reverse (y light). The sums of a function and of its image with that parity are half
of all functions, and a solution costs an eighth. A block that is its own image under a half turn keeps E_x and E_y even
under it, and E_z odd, for both polarisations: half of the functions likewise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import TypeAlias

import numpy as np

from metafab.cell.rcwa.basis.coordinates import IntArray
from metafab.core.conventions import FloatArray

#: Number of each function's image, and factor from the function to it.
Images: TypeAlias = tuple[IntArray, FloatArray]


@dataclass(frozen=True)
class Shapes:
    """Functions of order p at q nodes."""

    nodal: FloatArray  #: Shape (p + 1, q), those of the two ends, then p - 1 that vanish there, of alternating parity.
    edge: FloatArray  #: Shape (p, q), Legendre polynomials.
    slope: FloatArray  #: Shape (p + 1, p), derivative of each nodal function as a sum of edge functions.
    nodal_slope: FloatArray  #: Shape (p + 1, q), derivative of each nodal function.


def shapes(order: int, at: FloatArray) -> Shapes:
    """Functions of an order from 1 at nodes ``at``, shape (q,)."""
    legendre = np.polynomial.legendre.legvander(at, order).T
    nodal, slope = np.empty((order + 1, len(at))), np.zeros((order + 1, order))
    nodal[0], nodal[1] = 0.5 * (1.0 - at), 0.5 * (1.0 + at)
    slope[:2, 0] = -0.5, 0.5
    for k in range(1, order):
        scale = np.sqrt(0.5 * (2 * k + 1))
        nodal[k + 1] = scale * (legendre[k + 1] - legendre[k - 1]) / (2 * k + 1)
        slope[k + 1, k] = scale
    edge = np.asarray(legendre[:order], dtype=np.float64)
    return Shapes(nodal, edge, slope, slope @ edge)


@lru_cache(maxsize=64)
def graded_quadrature(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights over -1 to 1, shape (count,) each, gathered quadratically at both ends.

    With t from 0 to 1, a Gauss-Legendre rule in t is carried over by t^2 (3 - 2 t): powers of the distance from an end
    that have no derivative there are integrated to high order.
    """
    node, weight = np.polynomial.legendre.leggauss(count)
    t = 0.5 * (node + 1.0)
    return 2.0 * t**2 * (3.0 - 2.0 * t) - 1.0, weight * 6.0 * t * (1.0 - t)


@dataclass(frozen=True)
class Places:
    """Functions of one family that an element has."""

    local: IntArray  #: Shape (k,), number of the function in :class:`metafab.cell.elements.line.Shapes`.
    place: IntArray  #: Shape (k,), number along the axis.
    sign: FloatArray  #: Shape (k,), factor from the function along the axis to that of the element.


@dataclass(frozen=True)
class Line:
    """Both families along an axis of alternating pillars and gaps."""

    orders: tuple[int, ...]  #: Polynomial order of each element, the first pillar first.
    nodal: tuple[Places, ...]  #: Continuous functions of each element.
    edge: tuple[Places, ...]  #: Discontinuous functions of each element.
    nodal_count: int  #: Number of continuous functions.
    edge_count: int  #: Number of discontinuous functions.
    #: Parity of the continuous functions about the middle of every pillar and gap; None without a mirror.
    even: bool | None = None

    def gradient(self) -> FloatArray:
        """Derivative of the continuous functions, shape (edge_count, nodal_count)."""
        matrix = np.zeros((self.edge_count, self.nodal_count))
        for order, nodal, edge in zip(self.orders, self.nodal, self.edge, strict=True):
            slope = shapes(order, np.zeros(1)).slope
            np.add.at(
                matrix,
                (edge.place[:, None], nodal.place),
                nodal.sign * edge.sign[:, None] * slope[nodal.local][:, edge.local].T,
            )
        return matrix


def periodic_line(orders: tuple[int, ...]) -> Line:
    """Numbering of a period of elements; vertices first, then each element's own functions."""
    count = len(orders)
    inner, first = list(accumulate((p - 1 for p in orders), initial=count)), list(accumulate(orders, initial=0))
    nodal, edge = [], []
    for i, order in enumerate(orders):
        place = [i, (i + 1) % count, *range(inner[i], inner[i + 1])]
        nodal.append(Places(np.arange(order + 1), np.array(place), np.ones(order + 1)))
        edge.append(Places(np.arange(order), np.arange(first[i], first[i + 1]), np.ones(order)))
    return Line(orders, tuple(nodal), tuple(edge), inner[-1], first[-1])


def mirrored_line(orders: tuple[int, int], *, even: bool) -> Line:
    """Numbering of one pillar and one gap, with the continuous functions even or odd about the middle of each."""
    nodal, edge = [], []
    nodal_count, edge_count = 1, 0
    for i, order in enumerate(orders):
        inner = np.array([k for k in range(2, order + 1) if (k % 2 == 0) == even], dtype=np.intp)
        ends = np.array([1.0, 1.0 if even else -1.0])
        place = np.concatenate([[0, 0], nodal_count + np.arange(len(inner))])
        # The function of the vertices is 1 at the pillar's far wall, and 1 or -1 at its near one.
        sign = np.concatenate([ends[::-1] if i == 0 else ends, np.ones(len(inner))])
        nodal.append(Places(np.concatenate([[0, 1], inner]), place, sign))
        own = np.array([k for k in range(order) if (k % 2 == 0) != even], dtype=np.intp)
        edge.append(Places(own, edge_count + np.arange(len(own)), np.ones(len(own))))
        nodal_count, edge_count = nodal_count + len(inner), edge_count + len(own)
    return Line(orders, tuple(nodal), tuple(edge), nodal_count, edge_count, even)


@dataclass(frozen=True)
class Fold:
    """Sums of the functions of a basis with their images, each a new function."""

    number: IntArray  #: Shape (n,), number of the sum that a function is part of; -1 for none.
    factor: FloatArray  #: Shape (n,), 1 or -1, factor of the function in that sum.
    first: IntArray  #: Shape (n_sums,), a function of factor 1 of each sum.

    @classmethod
    def of(cls, image: IntArray, sign: FloatArray) -> Fold:
        """Sums of the functions i with ``sign[i]`` times function ``image[i]``, shape (n,) each."""
        own = np.arange(len(image))
        first = own[(own < image) | ((own == image) & (sign > 0.0))]
        number, factor = np.full(len(image), -1), np.ones(len(image))
        number[first] = number[image[first]] = np.arange(len(first))
        factor[image[first]] = sign[first]
        return cls(number, factor, first)

    def folded(self, matrix: FloatArray, into: Fold) -> FloatArray:
        """A map from these functions to those of ``into``, between the sums: shape (into.n_sums, n_sums)."""
        inside = self.number >= 0
        total = np.zeros((len(into.first), len(self.first)))
        np.add.at(total.T, self.number[inside], (matrix[into.first][:, inside] * self.factor[inside]).T)
        return total


def folds(line: Line, across: tuple[int, int], corner: IntArray, *, even: bool) -> tuple[Fold, Fold]:
    """Sums of the functions of E and of those of E_z.

    Args:
        line: numbering along x, periodic.
        across: numbers of continuous and of discontinuous functions along y.
        corner: shape (n_x,), number of the function of the corners at each vertex along x; -1 for none.
        even: whether E_x is even and E_y and E_z are odd.
    """
    sign = 1.0 if even else -1.0
    nodal, edge = _images(line, nodal=True), _images(line, nodal=False)
    whole = tuple((np.arange(count), np.ones(count)) for count in across)
    own = np.flatnonzero(corner >= 0)
    corners = np.empty(len(own), dtype=np.intp)
    corners[corner[own]] = corner[::-1][own]
    u, v, z = _both(edge, whole[0], sign), _both(nodal, whole[1], -sign), _both(nodal, whole[0], -sign)
    return _folds_of(u, v, z, (corners, np.full(len(corners), -sign)))


def half_turn_folds(along_x: Line, along_y: Line, corner: IntArray) -> tuple[Fold, Fold]:
    """Sums of the functions of E, equal to their images under a half turn of the block, and of those of E_z, opposite.

    Args:
        along_x: numbering along x, periodic.
        along_y: numbering along y, periodic.
        corner: shape (2 n_y, 2 n_x), number of the function of the corners at each vertex; -1 for none.
    """
    nodal_x, edge_x, nodal_y, edge_y = (
        _images(line, nodal=nodal) for line in (along_x, along_y) for nodal in (True, False)
    )
    own = corner >= 0
    corners = np.empty(np.count_nonzero(own), dtype=np.intp)
    corners[corner[own]] = corner[::-1, ::-1][own]
    u, v, z = _both(edge_x, nodal_y, 1.0), _both(nodal_x, edge_y, 1.0), _both(nodal_x, nodal_y, -1.0)
    return _folds_of(u, v, z, (corners, np.full(len(corners), -1.0)))


def _both(along_x: Images, along_y: Images, sign: float) -> Images:
    """Images of the products of functions along x and along y, times a sign."""
    count = len(along_y[0])
    return (along_x[0][:, None] * count + along_y[0]).ravel(), sign * np.outer(along_x[1], along_y[1]).ravel()


def _folds_of(u: Images, v: Images, z: Images, corners: Images) -> tuple[Fold, Fold]:
    """Folds of E, from the images of its functions along u, along v and of corners, and of E_z."""
    n_u, n_v, n_z = len(u[0]), len(v[0]), len(z[0])
    return (
        Fold.of(np.concatenate([u[0], n_u + v[0], n_u + n_v + corners[0]]), np.concatenate([u[1], v[1], corners[1]])),
        Fold.of(np.concatenate([z[0], n_z + corners[0]]), np.concatenate([z[1], corners[1]])),
    )


def _images(line: Line, *, nodal: bool) -> Images:
    """Image of each function along a periodic line under the mirror of the period, and its sign."""
    count = line.nodal_count if nodal else line.edge_count
    image, sign = np.empty(count, dtype=np.intp), np.ones(count)
    elements = line.nodal if nodal else line.edge
    for a, here in enumerate(elements):
        there = elements[(len(elements) - 2 - a) % len(elements)]
        if nodal:
            # The ends change places; the functions within have alternating parity.
            image[here.place[:2]], image[here.place[2:]] = there.place[1::-1], there.place[2:]
            sign[here.place[2:]] = (-1.0) ** here.local[2:]
        else:
            image[here.place] = there.place
            sign[here.place] = (-1.0) ** here.local
    return image, sign
