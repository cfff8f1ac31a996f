"""PSF stacks between their nodes in depth and direction; joined stacks and selected depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.interpolation import spline_weights
from metafab.optics.geometry.imaging import Tangent
from metafab.optics.point_spread import Psf

#: Fewest depths between which a cubic spline interpolates.
_FEWEST_NODES = 4
#: Axis of the depths in each array of a stack.
_DEPTH_AXIS = {
    "depth_m": 0,
    "psf": 1,
    "centre_um": 1,
    "phi_deg": 0,
    "error": 0,
    "efficiency": 1,
    "extinction_ratio": 0,
}


def at_depths(psf: Psf, depths_m: Sequence[float] | FloatArray) -> FloatArray:
    """Interpolate the irradiance of four depths or more by cubic splines in vergence 1/z.

    The wanted depths, shape (n,), have any order; :func:`metafab.optics.depth_nodes` spaces those of a stack for a
    target error.

    Returns:
        Shape (2, n, n_y, n_x), 1/um^2; exactly the stored images at stored depths.

    Raises:
        InputError: a depth lies outside the stack (nothing is extrapolated), or the stack is too short.
    """
    wanted = np.atleast_1d(np.asarray(depths_m, dtype=np.float64))
    low, high = psf.depth_m[0], psf.depth_m[-1]
    if not np.all((wanted >= low * (1.0 - 1e-12)) & (wanted <= high * (1.0 + 1e-12))):
        outside = wanted[(wanted < low) | (wanted > high) | np.isnan(wanted)]
        expected, got = f"depths from {low:g} to {high:g} m", f"{outside[0]:g} m ({outside.size} outside)"
        raise InputError.single("PSF stack", "depths_m", expected, got, "compute the stack over a wider range")
    if np.all(np.isin(wanted, psf.depth_m)):
        return psf.psf[:, np.searchsorted(psf.depth_m, wanted)]
    if psf.depth_m.size < _FEWEST_NODES:
        expected = f"{_FEWEST_NODES} depths or more to interpolate between"
        raise InputError.single("PSF stack", "depths_m", expected, f"{psf.depth_m.size}", "compute more depths")
    weights = spline_weights(1.0 / psf.depth_m, 1.0 / wanted)
    return np.asarray(np.einsum("pdij,nd->pnij", psf.psf, weights, optimize=True))


def at_tangent(psf: Psf, tangent: Tangent) -> FloatArray:
    """Interpolate the irradiance about the geometric image point to any direction (x/z, y/z) inside the field.

    Its shape is (2, n_depth, n_y, n_x), 1/um^2. InputError if the stack has no field, or the direction lies outside it
    (nothing is extrapolated).
    """
    if psf.field is None:
        expected = "a stack over the field of view"
        raise InputError.single("PSF stack", "field", expected, "one direction", "set `verify.field_points`")
    nodes = (psf.field.tangent_x, psf.field.tangent_y)
    for name, value, grid in zip("xy", tangent, nodes, strict=True):
        if not grid[0] <= value <= grid[-1]:
            expected = f"a direction from {grid[0]:g} to {grid[-1]:g}"
            remedy = "compute the stack over a wider field"
            raise InputError.single("PSF stack", f"tangent_{name}", expected, f"{value:g}", remedy)
    w_x, w_y = (spline_weights(grid, value) for grid, value in zip(nodes, tangent, strict=True))
    return np.asarray(np.einsum("pdyxij,y,x->pdij", psf.field.psf, w_y, w_x, optimize=True), dtype=np.float64)


def without_depths(psf: Psf, left_out: NDArray[np.bool_]) -> Psf:
    """Return the stack without the depths marked in ``left_out``, shape (n_depth,)."""
    kept, field = np.flatnonzero(~np.asarray(left_out)), psf.field
    if field is not None:
        field = replace(field, psf=field.psf[:, kept], centre_um=field.centre_um[:, kept])
    ghost = None if psf.ghost is None else without_depths(psf.ghost, left_out)
    arrays: dict[str, Any] = {name: np.take(getattr(psf, name), kept, axis) for name, axis in _DEPTH_AXIS.items()}
    return replace(psf, **arrays, field=field, ghost=ghost)


def concatenate(stacks: Sequence[Psf]) -> Psf:
    """Join stacks of the same sampling and sensor along depth.

    Details are those of the first stack with the sum of all times. Fields are dropped. ValueError for no stacks,
    different sampling, or depths that do not ascend from one stack to the next.
    """
    if not stacks:
        raise ValueError("`stacks`: expected at least one")
    first = stacks[0]
    sampling = {(stack.pixel_um, stack.psf.shape[2:], stack.sensor_distance_um) for stack in stacks}
    if len(sampling) > 1:
        raise ValueError("`stacks`: expected one sampling, window and sensor plane")
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(stack, name) for stack in stacks], axis) for name, axis in _DEPTH_AXIS.items()
    }
    if np.any(np.diff(arrays["depth_m"]) <= 0.0):
        raise ValueError("`stacks`: expected ascending depths")
    if len(stacks) == 1:
        return first
    ghosts = [stack.ghost for stack in stacks if stack.ghost is not None]
    details = replace(first.details, seconds=sum(stack.details.seconds for stack in stacks))
    return replace(first, **arrays, field=None, ghost=concatenate(ghosts) if ghosts else None, details=details)
