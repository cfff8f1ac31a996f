"""What may be asked of a PSF stack: depths, directions, samples, error and filter; all else is refused in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.optics.geometry.imaging import Imaging

Tangent = tuple[float, float]
Grid = tuple[FloatArray, FloatArray]

#: Single precision leaves 2e-6 and low rank a fifth of the target; a filter leaves the blocks half the target.
_SMALLEST_TARGET, _SMALLEST_TARGET_IN_BAND = 4e-6, 1e-5


def require_answerable(
    imaging: Imaging,
    depths_m: Sequence[float],
    tangent: Tangent,
    grid: Grid | None,
    window_px: int,
    target_error: float,
    filter_fwhm_nm: float | None,
) -> None:
    """Refuse what no PSF stack can answer, all faults at once.

    Raises:
        InputError: depths or field points that are not ascending, numbers that are none or out of range, or pixels
            so coarse that their sum is not the power in the window.
    """
    faults = [
        *_depth_faults(depths_m),
        *_direction_faults(tangent, grid),
        *_number_faults(imaging, window_px, target_error, filter_fwhm_nm),
    ]
    if faults:
        raise InputError("optics", faults)
    directions = [tangent, *([] if grid is None else [(float(x), float(y)) for y in grid[1] for x in grid[0]])]
    require_summable(imaging, directions)


def require_summable(imaging: Imaging, directions: Sequence[Tangent]) -> None:
    """Refuse pixels that the finest fringe of the irradiance outruns: efficiencies are sums over pixels.

    The irradiance is band-limited by the aperture (it is the pupil's autocorrelation in frequency); a sum of samples
    is its integral where the sampling frequency lies beyond that band.
    """
    finest_um = min(imaging.finest_fringe_um(p, tangent) for p in (0, 1) for tangent in directions)
    if imaging.pixel_um >= finest_um:
        raise InputError.single(
            "optics", "pixel_um", f"below {finest_um:.3g} um, the period of the finest fringe, for pixels to add up to "
            "the power in the window", f"{imaging.pixel_um:g} um", "sample finer, on a window of more points",
        )  # fmt: skip


def _depth_faults(depths_m: Sequence[float]) -> list[Fault]:
    positive = all(depth > 0.0 for depth in depths_m)
    if len(depths_m) and positive and all(b > a for a, b in pairwise(depths_m)):
        return []
    return [Fault("depths_m", "at least one positive depth, in ascending order", str(list(depths_m)), "sort them")]


def _direction_faults(tangent: Tangent, grid: Grid | None) -> list[Fault]:
    faults = []
    if not all(math.isfinite(t) for t in tangent):
        faults.append(Fault("tangent", "two finite numbers, x/z and y/z", str(tangent)))
    for axis in () if grid is None else grid:
        if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)) or np.any(np.diff(axis) <= 0.0):
            faults.append(Fault("field_tangents", "finite directions, in ascending order", str(axis), "sort them"))
    return faults


def _number_faults(imaging: Imaging, window_px: int, target_error: float, filter_fwhm_nm: float | None) -> list[Fault]:
    faults = []
    if not 0.0 < imaging.pixel_um < math.inf:
        faults.append(Fault("pixel_um", "a number above zero", f"{imaging.pixel_um:g} um"))
    if window_px < 1:
        faults.append(Fault("window_px", "at least 1 point a side", str(window_px)))
    smallest = _SMALLEST_TARGET if filter_fwhm_nm is None else _SMALLEST_TARGET_IN_BAND
    if not smallest <= target_error < 1.0:
        expected = f"{smallest:g}, which single precision allows, or more, and below 1"
        faults.append(Fault("target_error", expected, f"{target_error:g}"))
    if filter_fwhm_nm is not None:
        wavelength_nm = 1e3 * imaging.wavelength_um
        sine = math.sin(math.radians(imaging.split_angle_deg))
        widest_nm = min(wavelength_nm, 2.0 * wavelength_nm * (1.0 / sine - 1.0) if sine > 0.0 else math.inf)
        if not 0.0 < filter_fwhm_nm < widest_nm:
            expected = f"above 0 and below {widest_nm:.4g} nm, about a wavelength of {wavelength_nm:g} nm"
            faults.append(Fault("filter_fwhm_nm", expected, f"{filter_fwhm_nm:g} nm"))
    return faults
