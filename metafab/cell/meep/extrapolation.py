"""From several resolutions to the limit of vanishing pixels, with an error that the spread supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray

#: Order of Meep's scheme with smoothed interfaces (Farjadpour et al., Opt. Lett. 31, 2972, 2006).
ORDER = 2


@dataclass(frozen=True)
class Extrapolated:
    """The limit and how far it can be trusted.

    Attributes:
        value: shape (n_values,).
        error: estimate of the largest absolute error among the values.
    """

    value: ComplexArray
    error: float


def richardson(pixel_um: Sequence[float], values: Sequence[ComplexArray]) -> Extrapolated:
    """Limit of v(h) = v + c h^2 by least squares over all resolutions.

    Where walls stand between grid points changes from one resolution to the next, and the coefficient c a
    little with it; the fit averages over that. The error is the largest of: the change when the coarsest
    resolution is left out, the misfit of the finest, and a tenth of the correction that was made to it.

    Args:
        pixel_um: at least two grid spacings, in any order.
        values: for each, shape (n_values,).
    """
    if len(pixel_um) < 2 or len(pixel_um) != len(values):
        raise ValueError(f"`pixel_um`: expected two or more, as many as `values`, got {len(pixel_um)}")
    order = np.argsort(pixel_um)[::-1]
    h, v = np.asarray(pixel_um, dtype=np.float64)[order], np.asarray(values, dtype=np.complex128)[order]
    fitted, slope = _fit(h, v)
    correction = float(np.max(np.abs(fitted - v[-1])))
    if len(h) == 2:
        # Nothing checks the order: half the correction is what a first-order rest of it would be.
        return Extrapolated(fitted, 0.5 * correction)
    finer, _ = _fit(h[1:], v[1:])
    spread = float(np.max(np.abs(fitted - finer)))
    misfit = float(np.max(np.abs(v[-1] - fitted - slope * h[-1] ** ORDER)))
    return Extrapolated(fitted, max(spread, misfit, 0.1 * correction))


def _fit(h: np.ndarray, v: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Weighted least squares; finer grids count more, as misfits shrink with h^2."""
    weight = 1.0 / h**ORDER
    design = np.stack([np.ones_like(h), h**ORDER], axis=1) * weight[:, None]
    solution = np.linalg.lstsq(design, v * weight[:, None], rcond=None)[0]
    return solution[0], solution[1]
