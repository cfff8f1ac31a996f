"""Numerics of a PSF stack, and the ranges of all its inputs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from metafab.core.errors import Fault, InputError
from metafab.optics.geometry.imaging import FieldGrid, Imaging, Tangent
from metafab.optics.geometry.polarisation import Quantity, vectorial_effect
from metafab.spec import Design

#: Smallest target errors, for one wavelength and with a filter. Single precision leaves an error of 2e-6 and the
#: low-rank kernel a sixth of the target; with a filter, half the target is left for the pupil blocks.
_SMALLEST_TARGET, SMALLEST_TARGET_IN_BAND = 4e-6, 1e-5
#: Scalar propagation is used if its error is below this share of the target error; a target above the second number
#: counts as that number.
_SCALAR_SHARE, _LARGEST_SCALAR_TARGET = 0.1, 1e-2


@dataclass(frozen=True, kw_only=True)
class PsfNumerics:
    """Window, error and spectral band of a PSF stack."""

    window_px: int = 64  #: Points along a side of each square window.
    target_error: float = 1e-3  #: Largest relative L2 error of the irradiance, from 4e-6 (1e-5 with a filter) to 1.
    #: Full width of a flat-top filter about the design wavelength; None for one wavelength.
    filter_fwhm_nm: float | None = None
    #: Whether propagation is vectorial: the electric field stays perpendicular to each ray. None: scalar if that errs
    #: by a tenth of the target error at most (at 1e-3, up to an NA of 0.27); the stated error then contains it. False:
    #: scalar, without it in the stated error.
    vectorial: bool | None = None
    #: Compute the density of electric energy |E|^2, always vectorial, in place of the flux through the plane.
    energy: bool = False

    @classmethod
    def of(cls, design: Design) -> PsfNumerics:
        """Return the numerics of a design: window, error and propagation of ``[verify]``, filter of ``[optics]``."""
        verify = design.verify
        return cls(
            window_px=verify.window_px,
            target_error=verify.target_error,
            filter_fwhm_nm=None if design.optics is None else design.optics.filter_fwhm_nm,
            vectorial=verify.vectorial,
        )

    @property
    def block_error(self) -> float:
        """Share of the target error for the pupil blocks; the wavelengths of a filter take the other half."""
        return self.target_error * (1.0 if self.filter_fwhm_nm is None else 0.5)


def quantity_of(imaging: Imaging, numerics: PsfNumerics) -> tuple[Quantity, float]:
    """Return the irradiance that a stack computes, and the error of scalar propagation where that is chosen."""
    if numerics.energy or numerics.vectorial:
        return ("energy" if numerics.energy else "flux"), 0.0
    if numerics.vectorial is False:
        return "scalar", 0.0
    effect = vectorial_effect(imaging.numerical_aperture)
    allowed = _SCALAR_SHARE * min(numerics.target_error, _LARGEST_SCALAR_TARGET)
    return ("scalar", effect) if effect <= allowed else ("flux", 0.0)


def require_valid(
    imaging: Imaging, depths_m: Sequence[float], tangent: Tangent, grid: FieldGrid | None, numerics: PsfNumerics
) -> None:
    """Refuse inputs for which no PSF stack exists, all faults at once.

    InputError for depths or field points that do not ascend, numbers that are not finite or out of range, or pixels so
    coarse that their sum is not the power in the window.
    """
    faults = [*_depth_faults(depths_m), *_direction_faults(tangent, grid), *_numerics_faults(imaging, numerics)]
    if faults:
        raise InputError("optics", faults)
    directions = [tangent, *([] if grid is None else [(float(x), float(y)) for y in grid[1] for x in grid[0]])]
    require_fine_pixels(imaging, directions)


def require_fine_pixels(imaging: Imaging, directions: Sequence[Tangent]) -> None:
    """Refuse pixels so coarse that their sum is not the power in the window, by an InputError.

    The aperture band-limits the irradiance. Samples add up to its integral if the sampling frequency lies beyond that
    band.
    """
    finest_um = min(imaging.finest_fringe_um(p, direction) for p in (0, 1) for direction in directions)
    if imaging.pixel_um >= finest_um:
        raise InputError.single(
            "optics",
            "pixel_um",
            f"below {finest_um:.3g} um, the period of the finest fringe, so that pixels add up to the power in the "
            "window",
            f"{imaging.pixel_um:g} um",
            "sample finer, on a window of more points",
        )


def _depth_faults(depths_m: Sequence[float]) -> list[Fault]:
    positive = all(depth > 0.0 for depth in depths_m)
    if len(depths_m) and positive and all(b > a for a, b in pairwise(depths_m)):
        return []
    return [Fault("depths_m", "at least one positive depth, in ascending order", str(list(depths_m)), "sort them")]


def _direction_faults(tangent: Tangent, grid: FieldGrid | None) -> list[Fault]:
    faults = []
    if not all(math.isfinite(t) for t in tangent):
        faults.append(Fault("tangent", "two finite numbers, x/z and y/z", str(tangent)))
    for axis in grid or ():
        if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)) or np.any(np.diff(axis) <= 0.0):
            faults.append(Fault("field_tangents", "finite directions, in ascending order", str(axis), "sort them"))
    return faults


def _numerics_faults(imaging: Imaging, numerics: PsfNumerics) -> list[Fault]:
    faults = []
    if not 0.0 < imaging.pixel_um < math.inf:
        faults.append(Fault("pixel_um", "a finite number above 0", f"{imaging.pixel_um:g} um"))
    if not isinstance(numerics.window_px, int | np.integer) or numerics.window_px < 1:
        faults.append(Fault("window_px", "a whole number of points along a side, at least 1", str(numerics.window_px)))
    filter_nm = numerics.filter_fwhm_nm
    smallest = _SMALLEST_TARGET if filter_nm is None else SMALLEST_TARGET_IN_BAND
    if not smallest <= numerics.target_error < 1.0:
        expected = f"from {smallest:g}, the limit of single precision, to below 1"
        faults.append(Fault("target_error", expected, f"{numerics.target_error:g}"))
    if filter_nm is not None:
        wavelength_nm = 1e3 * imaging.wavelength_um
        sine = math.sin(math.radians(imaging.split_angle_deg))
        widest_nm = min(wavelength_nm, 2.0 * wavelength_nm * (1.0 / sine - 1.0) if sine > 0.0 else math.inf)
        if not 0.0 < filter_nm < widest_nm:
            expected = f"above 0 and below {widest_nm:.4g} nm, for a wavelength of {wavelength_nm:g} nm"
            faults.append(Fault("filter_fwhm_nm", expected, f"{filter_nm:g} nm"))
    return faults
