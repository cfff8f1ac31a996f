"""Functions of a row that is its own mirror image along x: each function is paired with its image.

Light along the axis keeps E_x even and E_y odd (x light), or the reverse (y light). The sums of a function and of its
image with that parity are half of all functions, and a solution costs an eighth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.elements.line import Line
from metafab.cell.rcwa.basis.coordinates import IntArray
from metafab.core.conventions import FloatArray


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
        across: continuous and discontinuous functions along y.
        corner: shape (n_x,), number of the function of the corners at each vertex along x; -1 for none.
        even: whether E_x is even and E_y and E_z are odd.
    """
    nodal, nodal_sign = _images(line, nodal=True)
    edge, edge_sign = _images(line, nodal=False)
    sign = 1.0 if even else -1.0
    own = np.flatnonzero(corner >= 0)
    corners = np.empty(len(own), dtype=np.intp)
    corners[corner[own]] = corner[::-1][own]
    n_nodal, n_edge = across
    u, v, z = (
        ((image[:, None] * count + np.arange(count)).ravel(), np.repeat(signs, count))
        for image, signs, count in (
            (edge, sign * edge_sign, n_nodal),
            (nodal, -sign * nodal_sign, n_edge),
            (nodal, -sign * nodal_sign, n_nodal),
        )
    )
    odd = np.full(len(corners), -sign)
    n_u, n_v, n_z = len(u[0]), len(v[0]), len(z[0])
    return (
        Fold.of(np.concatenate([u[0], n_u + v[0], n_u + n_v + corners]), np.concatenate([u[1], v[1], odd])),
        Fold.of(np.concatenate([z[0], n_z + corners]), np.concatenate([z[1], odd])),
    )


def _images(line: Line, *, nodal: bool) -> tuple[IntArray, FloatArray]:
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
