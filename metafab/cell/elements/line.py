"""Numbering of the functions along one axis of the mesh, periodic or mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from metafab.cell.elements.shapes import shapes
from metafab.cell.rcwa.basis.coordinates import IntArray
from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class Places:
    """Functions of one family that an element has."""

    local: IntArray  #: Shape (k,), number of the function in :class:`metafab.cell.elements.shapes.Shapes`.
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
