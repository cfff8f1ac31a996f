"""Interpolation of the pair over the field of view, and the spline weights that all interpolation uses."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf


def spline_weights(nodes: FloatArray, at: ArrayLike) -> FloatArray:
    """Weights of the values at ``nodes`` in their interpolating spline at ``at``: shape (*at.shape, n_nodes).

    Cubic, or of the highest order that the nodes allow; beyond the outer nodes, their values are kept.
    """
    points = np.asarray(at, dtype=np.float64)
    if nodes.size == 1:
        return np.ones((*points.shape, 1))
    spline = _cardinal_spline(tuple(nodes.tolist()))
    return np.asarray(spline(np.clip(points, nodes.min(), nodes.max())), dtype=np.float64)


@lru_cache(maxsize=32)
def _cardinal_spline(places: tuple[float, ...]) -> BSpline:
    """The interpolating splines of a 1 at one node and 0 at all others, for each node."""
    nodes = np.array(places)
    ascending = np.argsort(nodes)
    return make_interp_spline(nodes[ascending], np.eye(nodes.size)[ascending], k=min(3, nodes.size - 1))


def at_tangent(psf: Psf, tangent: tuple[float, float]) -> FloatArray:
    """Irradiance about the geometric image point of any direction inside the calibrated field.

    Args:
        psf: a stack with a field.
        tangent: (x/z, y/z) of the object.

    Returns:
        Shape (2, n_depth, n_y, n_x), 1/um^2.

    Raises:
        InputError: the stack has no field, or the direction is outside of it (nothing is extrapolated).
    """
    if psf.field is None:
        raise InputError.single(
            "PSF stack", "field", "a stack over the field of view", "one direction", "set `verify.field_points`"
        )
    nodes = (psf.field.tangent_x, psf.field.tangent_y)
    for name, value, grid in zip("xy", tangent, nodes, strict=True):
        if not grid[0] <= value <= grid[-1]:
            raise InputError.single(
                "PSF stack", f"tangent_{name}", f"a direction from {grid[0]:g} to {grid[-1]:g}", f"{value:g}",
                "compute the stack over a wider field",
            )  # fmt: skip
    w_x, w_y = (spline_weights(grid, value) for grid, value in zip(nodes, tangent, strict=True))
    return np.asarray(np.einsum("pdyxij,y,x->pdij", psf.field.psf, w_y, w_x, optimize=True), dtype=np.float64)
