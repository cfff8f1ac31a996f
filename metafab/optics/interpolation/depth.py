"""PSF stacks along depth: interpolate between nodes, join, leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.interpolation.field import spline_weights
from metafab.optics.point_spread import Psf

_FEWEST_NODES = 4


def at_depths(psf: Psf, depths_m: Sequence[float] | FloatArray) -> FloatArray:
    """Irradiance at any depths inside the stack, by cubic splines in vergence 1/z.

    Args:
        psf: a stack of four depths or more (:func:`depth_nodes` spaces them for an error).
        depths_m: shape (n,), any order.

    Returns:
        Shape (2, n, n_y, n_x), 1/um^2; exactly the stored images at stored depths.

    Raises:
        InputError: a depth lies outside the stack (nothing is extrapolated), or the stack is too short.
    """
    wanted = np.atleast_1d(np.asarray(depths_m, dtype=np.float64))
    low, high = psf.depth_m[0], psf.depth_m[-1]
    if not np.all((wanted >= low * (1.0 - 1e-12)) & (wanted <= high * (1.0 + 1e-12))):
        outside = wanted[(wanted < low) | (wanted > high) | np.isnan(wanted)]
        raise InputError.single(
            "PSF stack",
            "depths_m",
            f"depths from {low:g} to {high:g} m",
            f"{outside[0]:g} m ({outside.size} outside)",
            "compute the stack over a wider range",
        )
    if np.all(np.isin(wanted, psf.depth_m)):
        return psf.psf[:, np.searchsorted(psf.depth_m, wanted)]
    if psf.depth_m.size < _FEWEST_NODES:
        raise InputError.single(
            "PSF stack", "depths_m", f"{_FEWEST_NODES} depths or more to interpolate between",
            f"{psf.depth_m.size}", "compute more depths",
        )  # fmt: skip
    weights = spline_weights(1.0 / psf.depth_m, 1.0 / wanted)
    return np.asarray(np.einsum("pdij,nd->pnij", psf.psf, weights, optimize=True))


def without_depths(psf: Psf, left_out: NDArray[np.bool_]) -> Psf:
    """The stack without the depths marked in ``left_out`` (n_depth,)."""
    kept = ~np.asarray(left_out)
    field = psf.field
    if field is not None:
        field = replace(field, psf=field.psf[:, kept], centre_um=field.centre_um[:, kept])
    return replace(
        psf,
        depth_m=psf.depth_m[kept],
        psf=psf.psf[:, kept],
        centre_um=psf.centre_um[:, kept],
        phi_deg=psf.phi_deg[kept],
        error=psf.error[kept],
        efficiency=psf.efficiency[:, kept],
        extinction_ratio=psf.extinction_ratio[kept],
        field=field,
    )


def concatenate(stacks: Sequence[Psf]) -> Psf:
    """One stack of several that share sampling and sensor; depths must ascend from one to the next.

    Figures in ``details`` are those of the first, ``seconds`` the sum; fields over the view are not joined.
    """
    if not stacks:
        raise ValueError("`stacks`: expected at least one")
    first = stacks[0]
    for other in stacks[1:]:
        if (other.pixel_um, other.psf.shape[2:], other.sensor_distance_um) != (
            first.pixel_um, first.psf.shape[2:], first.sensor_distance_um,
        ):  # fmt: skip
            raise ValueError("`stacks`: expected one sampling, window and sensor plane")
    depth_m = np.concatenate([s.depth_m for s in stacks])
    if np.any(np.diff(depth_m) <= 0.0):
        raise ValueError("`stacks`: expected ascending depths")
    if len(stacks) == 1:
        return first
    seconds = sum(float(s.details.get("seconds", 0.0)) for s in stacks)
    return replace(
        first,
        depth_m=depth_m,
        psf=np.concatenate([s.psf for s in stacks], axis=1),
        centre_um=np.concatenate([s.centre_um for s in stacks], axis=1),
        phi_deg=np.concatenate([s.phi_deg for s in stacks]),
        error=np.concatenate([s.error for s in stacks]),
        efficiency=np.concatenate([s.efficiency for s in stacks], axis=1),
        extinction_ratio=np.concatenate([s.extinction_ratio for s in stacks]),
        field=None,
        details={**first.details, "seconds": seconds},
    )
