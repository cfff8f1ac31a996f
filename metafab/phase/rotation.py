"""Rotation of a helix: the theory of Eq. 2, and the main lobe as it is measured in a PSF.

In Eq. 2 with exponent 1/2 the zone of charge l has the mean u^2 of l / L, so a rim defocus W adds W l / L to it:
exp(i l (phi + W / L)) is the mask turned by -W / L, and the PSF turns with it. W falls with growing depth, so
the main lobe turns counter-clockwise as the object recedes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.phase.pupil import FocalPlane, Pupil, rim_defocus_per_dioptre_rad


def rotation_deg_per_dioptre(zones: int, aperture_radius_um: float, wavelength_um: float) -> float:
    """Turn of the main lobe per dioptre of the object's vergence (-225 / L for R = 1 mm at 800 nm).

    Exact in the limit of many zones at exponent 1/2; one zone (a plain vortex) does not turn at all.
    """
    if zones == 1:
        return 0.0
    return -math.degrees(rim_defocus_per_dioptre_rad(aperture_radius_um, wavelength_um)) / zones


def full_turn_dioptre(zones: int, aperture_radius_um: float, wavelength_um: float) -> float:
    """Range of vergence over which the lobe turns by 360 degrees (1.6 L for R = 1 mm at 800 nm)."""
    rate = rotation_deg_per_dioptre(zones, aperture_radius_um, wavelength_um)
    return math.inf if rate == 0.0 else 360.0 / abs(rate)


def full_turn_defocus_rad(zones: int, depths: int) -> FloatArray:
    """Rim defocuses that cover one full turn evenly, shape (depths,): middles of equal parts of (-pi L, pi L)."""
    return ((2.0 * np.arange(depths) + 1.0) / depths - 1.0) * math.pi * zones


@dataclass(frozen=True)
class MainLobe:
    """The brightest point of the PSF of x polarisation at each depth, found to a fraction of a sample.

    Attributes:
        defocus_rad: shape (n_depth,), rim defocus.
        peak: shape (n_depth,), Strehl ratio.
        radius: shape (n_depth,), distance from the geometric image point, optical units.
        phi_deg: shape (n_depth,), orientation, counter-clockwise from +x, unwrapped over the depths in order.
    """

    defocus_rad: FloatArray
    peak: FloatArray
    radius: FloatArray
    phi_deg: FloatArray


def main_lobe(pupil: Pupil, field: ComplexArray, defocus_rad: ArrayLike, half_width: float) -> MainLobe:
    """Measure the main lobe of a pupil field.

    Args:
        pupil: the samples.
        field: shape (n,), complex transmission of the samples.
        defocus_rad: shape (n_depth,), rim defocuses in an order in which phi changes by less than 180 degrees.
        half_width: of the window that is searched, optical units; twice the zones plus 6 holds every helix.
    """
    plane = FocalPlane(pupil, half_width)
    defocus = np.atleast_1d(np.asarray(defocus_rad, dtype=np.float64))
    lobes = np.array([_refined_peak(psf, plane) for psf in plane.psf(field, defocus)])
    phi_deg = np.degrees(np.unwrap(np.arctan2(lobes[:, 2], lobes[:, 1])))
    return MainLobe(defocus, lobes[:, 0], np.hypot(lobes[:, 1], lobes[:, 2]), phi_deg)


def _refined_peak(psf: FloatArray, plane: FocalPlane) -> tuple[float, float, float]:
    """(value, v_x, v_y) at the top of the parabolas through the largest sample and its neighbours."""
    row, column = np.unravel_index(int(psf[1:-1, 1:-1].argmax()), (psf.shape[0] - 2, psf.shape[1] - 2))
    row, column = row + 1, column + 1
    top = float(psf[row, column])
    value, position = top, []
    for low, high, index in (
        (psf[row, column - 1], psf[row, column + 1], column),
        (psf[row - 1, column], psf[row + 1, column], row),
    ):
        curvature = low - 2.0 * top + high
        shift = float(np.clip(0.5 * (low - high) / curvature, -1.0, 1.0)) if curvature < 0.0 else 0.0
        value -= 0.25 * float(low - high) * shift
        position.append(float(plane.axis[index]) + shift * plane.step)
    return value, position[0], position[1]
