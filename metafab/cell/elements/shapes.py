"""Polynomial functions on one side of an element, -1 to 1, and the quadrature of singular integrands over it.

Along each side a component of E is either continuous from element to element (*nodal*: the two vertex functions, then
integrated Legendre polynomials, which vanish at both ends) or not (*edge*: Legendre polynomials). The derivative of a
nodal function is an edge function (Schoeberl and Zaglmayr, COMPEL 24, 374, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metafab.core.conventions import FloatArray


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
