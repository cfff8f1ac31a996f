"""Interpolation on a centred grid, by splines, and of a maximum between samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline

from metafab.core.conventions import FloatArray

Number = TypeVar("Number", np.float64, np.complex128)


def spline_weights(nodes: FloatArray, at: ArrayLike) -> FloatArray:
    """Return the weights of the values at ``nodes`` in their interpolating spline at ``at``, which has any shape.

    The spline is cubic, or of the highest order that the nodes allow. Beyond the outer nodes it is constant. Nodes have
    the shape (n_nodes,) and ascend or descend; weights have the shape (*at.shape, n_nodes).
    """
    points = np.asarray(at, dtype=np.float64)
    if nodes.size == 1:
        return np.ones((*points.shape, 1))
    spline = _cardinal_splines(tuple(nodes.tolist()))
    return np.asarray(spline(np.clip(points, nodes.min(), nodes.max())), dtype=np.float64)


@lru_cache(maxsize=32)
def _cardinal_splines(nodes: tuple[float, ...]) -> BSpline:
    """The splines that are 1 at one node and 0 at all others, one per node."""
    return _spline_through(np.array(nodes), np.eye(len(nodes)), 0)


def _spline_through(nodes: FloatArray, values: FloatArray, axis: int) -> BSpline:
    """Interpolating spline of values along ``axis``, cubic or of the highest order that two or more nodes allow."""
    ascending = np.argsort(nodes)
    return make_interp_spline(nodes[ascending], values.take(ascending, axis), k=min(3, nodes.size - 1), axis=axis)


@dataclass(frozen=True)
class LocalSplines:
    """The B-splines in which the splines of :func:`spline_weights` are sums of few terms at each place."""

    knots: FloatArray  #: Shape (n_knots,).
    order: int  #: Order, 0 for a single node.
    ends: tuple[float, float]  #: Lowest and highest node, beyond which the value at the end holds.

    @classmethod
    def fitted(cls, nodes: FloatArray, values: FloatArray, axis: int) -> tuple[LocalSplines, FloatArray]:
        """The B-splines, and the coefficients of the spline through values of any shape along ``axis``: that shape.

        ``nodes``, shape (n,), are the places of the values along that axis.
        """
        ends = float(nodes.min()), float(nodes.max())
        if nodes.size == 1:
            return cls(np.array([ends[0], ends[0] + 1.0]), 0, ends), values
        spline = _spline_through(nodes, values, axis)
        return cls(spline.t, spline.k, ends), np.moveaxis(spline.c, 0, axis)

    def at(self, places: FloatArray) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Number of the first nonzero B-spline at places, shape (n,), and the values of all nonzero ones there.

        Shapes (n,) and (n, order + 1).
        """
        design = BSpline.design_matrix(np.clip(places, *self.ends), self.knots, self.order)
        weights = design.data.reshape(places.size, self.order + 1)
        return design.indices[:: self.order + 1].astype(np.int32), weights.astype(np.float32)


def bilinear_on_grid(samples: NDArray[Number], x: FloatArray, y: FloatArray) -> NDArray[Number]:
    """Interpolate samples at the points of a rectangular grid, shape (n_y, n_x); outside, the border's values are held.

    Samples, shape (m_y, m_x), at least 2 x 2, real or complex, are centred on the origin, lowest y first. Positions x,
    shape (n_x,), and y, shape (n_y,), are in units of their pitch.
    """
    row, share_y = _neighbours(y, samples.shape[0])
    column, share_x = _neighbours(x, samples.shape[1])
    rows = samples[row] * (1.0 - share_y)[:, None] + samples[row + 1] * share_y[:, None]
    return np.asarray(rows[:, column] * (1.0 - share_x) + rows[:, column + 1] * share_x)


def _neighbours(position: FloatArray, count: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Lower neighbour and share of the upper one, for positions from the centre of ``count`` samples."""
    index = np.clip(position + 0.5 * (count - 1), 0.0, count - 1.0)
    lower = np.minimum(index.astype(np.int64), count - 2)
    return lower, index - lower


def parabolic_maximum(values: FloatArray) -> float:
    """Return the index of the maximum of ``values``, shape (n,), by a parabola through the three highest samples.

    NaN if the largest sample is the first or the last one.
    """
    top = int(np.argmax(values))
    if top in {0, values.size - 1}:
        return math.nan
    below, at, above = values[top - 1 : top + 2]
    return float(top + 0.5 * (above - below) / (2.0 * at - below - above))
