"""Planes and quadrics through the depths of pixels, by fits that outliers do not move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions

#: Rounds of the reweighted fit of a plane to a segment's pixels.
_REFITS = 3
#: Square of a pixel's distance from its segment, in standard errors, from which it is an outlier.
_OUTLIER = 16.0
#: A surface is curved where a plane's misfit is above the first number and a quadric's is below this share of it. A
#: ball has 8.7 and 0.15, walls behind outlines up to 2.4 and 0.8.
_UNFIT_PLANE, _CURVED_SHARE = 2.6, 0.5
#: That share where the quadric replaces several segments, relative to their misfit.
_RINGS_SHARE = 0.93
#: Least relative change of vergence by curvature.
_SMALLEST_RISE = 5e-3
#: Parameters of a quadric.
_QUADRIC = 6
#: Fewest pixels of a curved surface. One pixel in four is fitted, because windows of neighbours overlap.
_FEWEST_CURVED, _FITTED_SHARE = 200, 4


def plane_misfit(regions: Regions, pixels: PixelDepth, inside: NDArray[np.bool_], free: int) -> float:
    """Mean square distance of the pixels' depths from robust fits to their segments, in standard errors.

    Args:
        pixels: depth of each pixel.
        inside: shape (n_y, n_x), pixels that count; those without a segment count as outliers.
        free: fitted parameters of each segment: its depth (1), or its depth and slopes (3).

    Returns:
        The misfit, at most ``_OUTLIER``; inf without pixels.
    """
    if not inside.any():
        return float("inf")
    error = (pixels.relative_error * pixels.vergence_per_m)[inside]
    away = (pixels.vergence_per_m - regions.vergence_per_m(regions.grown))[inside] / error
    number, place = regions.grown[inside], np.nonzero(inside)
    for one in np.unique(number[number > 0]).tolist():
        mask = number == one
        row, column = (axis[mask].astype(np.float64) for axis in place)
        away[mask] -= robust_fit(_monomials(row, column)[0][:, :free] / error[mask][:, None], away[mask])[0]
    return mean_square(away)


def curved_surface(regions: Regions, pixels: PixelDepth, numbers: Sequence[int]) -> Plane | None:
    """Quadric through the depths of the pixels of one or several segments; None where planes explain them as well.

    Args:
        pixels: depth of each pixel.
        numbers: of the segments, from 1. Layers cut a curved surface into rings that touch each other.
    """
    inside = np.flatnonzero(pixels.claimed & np.isin(regions.grown if len(numbers) > 1 else regions.interior, numbers))
    if inside.size < _FEWEST_CURVED:
        return None
    fitted = np.zeros(regions.label.shape, dtype=bool)
    fitted.flat[inside[::_FITTED_SHARE]] = True
    of_planes = plane_misfit(regions, pixels, fitted, 3)
    if len(numbers) == 1 and of_planes < _UNFIT_PLANE:
        return None
    quadric = _Fit.of(pixels, fitted, _QUADRIC)
    share = _CURVED_SHARE if len(numbers) == 1 else _RINGS_SHARE
    if quadric.misfit > share * of_planes or quadric.bend < _SMALLEST_RISE * quadric.plane.vergence_per_m:
        return None
    return quadric.plane


def simplest_surface(pixels: PixelDepth, inside: NDArray[np.bool_]) -> Plane | None:
    """One depth, or else a plane, or else a quadric through the depths of pixels; None for too few pixels.

    Each must leave less than half of the misfit of the simpler one: the depths of pixels scatter by more than they
    state, and neighbours by the same.

    Args:
        pixels: depth of each pixel.
        inside: shape (n_y, n_x), pixels of one surface.
    """
    places = np.flatnonzero(inside & pixels.claimed)
    if places.size < _FEWEST_CURVED:
        return None
    fitted = np.zeros(inside.shape, dtype=bool)
    fitted.flat[places[::_FITTED_SHARE]] = True
    best, *others = (_Fit.of(pixels, fitted, free) for free in (1, 3, _QUADRIC))
    for finer in others:
        if finer.misfit < _CURVED_SHARE * best.misfit:
            best = finer
    return best.plane


@dataclass(frozen=True)
class _Fit:
    """Robust fit to the depths of pixels."""

    plane: Plane  #: The fitted surface.
    misfit: float  #: Mean square distance of the pixels' depths from it, in standard errors.
    bend: float  #: Range of its curved part over the pixels, 1/m.

    @classmethod
    def of(cls, pixels: PixelDepth, fitted: NDArray[np.bool_], free: int) -> _Fit:
        """Fit one depth (``free`` = 1), a plane (3) or a quadric (6) to the pixels ``fitted``, shape (n_y, n_x)."""
        vergence = pixels.vergence_per_m[fitted]
        error, middle = pixels.relative_error[fitted] * vergence, float(np.median(vergence))
        monomials, centre, half = _monomials(*(axis.astype(np.float64) for axis in np.nonzero(fitted)))
        away = (vergence - middle) / error
        on_surface, factors = robust_fit(monomials[:, :free] / error[:, None], away)
        factors = np.pad(factors, (0, _QUADRIC - free))
        bend = float(np.ptp(monomials[:, 3:] @ factors[3:]))
        rise, y, x, yy, yx, xx = (factors / half ** np.array([0, 1, 1, 2, 2, 2])).tolist()
        plane = Plane(middle + rise) if free == 1 else Plane(middle + rise, (y, x), centre, (yy, yx, xx))
        return cls(plane, mean_square(away - on_surface), bend)


def mean_square(away: FloatArray) -> float:
    """Mean square of distances in standard errors, shape (n,), each at most that of an outlier; NaN counts as one."""
    return float(np.minimum(np.nan_to_num(away * away, nan=_OUTLIER), _OUTLIER).mean())


def _monomials(row: FloatArray, column: FloatArray) -> tuple[FloatArray, tuple[float, float], float]:
    """1, y, x, y^2, y x and x^2 of places from their middle, over half their extent: shape (n, 6); middle and half."""
    middle = float(row.mean()), float(column.mean())
    half = max(1.0, 0.5 * float(np.ptp(row)), 0.5 * float(np.ptp(column)))
    y, x = (row - middle[0]) / half, (column - middle[1]) / half
    return np.stack([np.ones_like(y), y, x, y * y, y * x, x * x], axis=1), middle, half


def robust_fit(design: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Robust least squares of values in standard errors, most of them small, by a design of shape (n, n_free).

    Returns:
        The fitted values, shape (n,), and the factors of the design's columns, (n_free,).
    """
    fitted, factors = np.zeros_like(values), np.zeros(design.shape[1])
    for _ in range(_REFITS):
        weight = 1.0 / (1.0 + (values - fitted) ** 2 / _OUTLIER)
        normal = design.T @ (design * weight[:, None])
        factors = np.linalg.pinv(normal, hermitian=True) @ (design.T @ (weight * values))
        fitted = design @ factors
    return fitted, factors
