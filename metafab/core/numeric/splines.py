"""Interpolating splines as weights of the values at their nodes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from metafab.core.conventions import FloatArray


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
    places = np.array(nodes)
    ascending = np.argsort(places)
    return make_interp_spline(places[ascending], np.eye(places.size)[ascending], k=min(3, places.size - 1))
