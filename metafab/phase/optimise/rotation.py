"""Rotation of a helix: the theory of Eq. 2 of Shen 2023 (spiral zones), and the main lobe measured in a PSF.

In Eq. 2 with exponent 1/2 the mean u^2 of the zone of charge l is (l - 1/2) / L, so a rim defocus W adds W l / L to its
phase, up to a constant: exp(i l (phi + W / L)) is the mask turned by -W / L, and the PSF turns with it. W falls with
growing depth, so the main lobe turns counter-clockwise as the object recedes. This is the law of many narrow zones.

A zone has a width. Light of the zone l arrives at the radius v of the lobe with the amplitude A_l = 2 integral J_l(v u)
u du, so the mean u^2 is weighted with J_l(v u) u. In focus all A_l are positive and meet in phase on one ray. Where
they stay so, the orientation of the lobe follows the weighted regression of those means on l (:func:`ring_rotation`):
3.4 % slower than the law for two zones, 0.5 % for four.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar
from scipy.special import jv

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.phase.pupil import FocalPlane, Pupil, rim_defocus_per_dioptre_rad
from metafab.phase.terms.helices import zone_radii


def rotation_deg_per_dioptre(zones: int, aperture_radius_um: float, wavelength_um: float) -> float:
    """Turn of the main lobe per dioptre of the object's vergence (-225 / L for R = 1 mm at 800 nm).

    The law of many zones at exponent 1/2, which optimised helices are steered to. The plain spiral turns by
    :func:`ring_rotation`; one zone (a plain vortex) does not turn.
    """
    if zones == 1:
        return 0.0
    return -math.degrees(rim_defocus_per_dioptre_rad(aperture_radius_um, wavelength_um)) / zones


def ring_rotation(zones: int, exponent: float) -> tuple[float, float]:
    """Radius and rotation rate of the plain spiral's main lobe in focus, from one integral a zone; two zones or more.

    The radius is in optical units, the rate in rad per rad of rim defocus (-1 / L for many zones at exponent 1/2).
    """
    charge = np.arange(1, zones + 1)
    edges = np.concatenate([[0.0], zone_radii(zones, exponent)]) ** 2
    node, share = np.polynomial.legendre.leggauss(48)
    # u^2 and its weight at the nodes of every zone, shape (zones, 48).
    square = 0.5 * (np.outer(np.diff(edges), node) + (edges[1:] + edges[:-1])[:, None])
    weight = 0.5 * np.outer(np.diff(edges), share)

    def amplitude(v: float) -> FloatArray:
        return np.asarray(weight * jv(charge[:, None], v * np.sqrt(square)))

    # Before the first zero of the outermost zone's Bessel function nothing cancels.
    brightest = minimize_scalar(lambda v: -amplitude(v).sum(), bounds=(0.0, 2.0 * zones + 2.0), method="bounded")
    light = amplitude(brightest.x)
    strength, mean_square = light.sum(axis=1), (light * square).sum(axis=1) / light.sum(axis=1)
    centred = charge - (strength @ charge) / strength.sum()
    return float(brightest.x), -float((strength * centred) @ mean_square / (strength @ centred**2))


def full_turn_dioptre(zones: int, aperture_radius_um: float, wavelength_um: float) -> float:
    """Range of vergence over which the lobe turns by 360 degrees (1.6 L for R = 1 mm at 800 nm)."""
    rate = rotation_deg_per_dioptre(zones, aperture_radius_um, wavelength_um)
    return math.inf if rate == 0.0 else 360.0 / abs(rate)


def full_turn_defocus_rad(zones: int, depths: int) -> FloatArray:
    """Rim defocuses of one full turn, ascending: the middles of equal parts of (-pi L, pi L), shape (depths,)."""
    return ((2.0 * np.arange(depths) + 1.0) / depths - 1.0) * math.pi * zones


def helix_half_width(zones: int) -> float:
    """Half width of a window that holds the main lobe of every helix of L zones, optical units."""
    return 2.0 * zones + 6.0


@dataclass(frozen=True)
class MainLobe:
    """The brightest point of the PSF of x polarisation at each depth, to a fraction of a sample."""

    defocus_rad: FloatArray  #: Shape (n_depth,), rim defocus.
    peak: FloatArray  #: Shape (n_depth,), Strehl ratio.
    radius: FloatArray  #: Shape (n_depth,), distance from the geometric image point, optical units.
    #: Shape (n_depth,), orientation, counter-clockwise from +x, unwrapped over the depths in order.
    phi_deg: FloatArray

    def peak_gain(self, plain: MainLobe) -> float:
        """Mean peak over that of another lobe."""
        return float(self.peak.mean() / plain.peak.mean())

    def worst_gain(self, plain: MainLobe) -> float:
        """Smallest peak over the smallest peak of another lobe."""
        return float(self.peak.min() / plain.peak.min())


def main_lobe(pupil: Pupil, field: ComplexArray, defocus_rad: ArrayLike, half_width: float) -> MainLobe:
    """Measure the main lobe of a pupil field, shape (n,), within ``half_width`` of the axis (:func:`helix_half_width`).

    Rim defocuses, shape (n_depth,), stand in an order in which phi changes by less than 180 degrees.
    """
    plane = FocalPlane(pupil, half_width)
    defocus = np.atleast_1d(np.asarray(defocus_rad, dtype=np.float64))
    lobes = np.array([refined_peak(psf, plane) for psf in plane.psf(field, defocus)])
    phi_deg = np.degrees(np.unwrap(np.arctan2(lobes[:, 2], lobes[:, 1])))
    return MainLobe(defocus, lobes[:, 0], np.hypot(lobes[:, 1], lobes[:, 2]), phi_deg)


def refined_peak(psf: FloatArray, plane: FocalPlane) -> tuple[float, float, float]:
    """Top of the quadratic surface through the largest sample and its eight neighbours: value, v_x and v_y.

    The surface has a mixed derivative, because lobes are crescents: longer along the turn than across it. The Strehl
    ratios on ``plane`` have the shape (n_v, n_v); v is in optical units.
    """
    row, column = np.unravel_index(int(psf[1:-1, 1:-1].argmax()), (psf.shape[0] - 2, psf.shape[1] - 2))
    patch = psf[row : row + 3, column : column + 3]
    top = float(patch[1, 1])
    slope = 0.5 * np.array([patch[1, 2] - patch[1, 0], patch[2, 1] - patch[0, 1]])
    mixed = 0.25 * (patch[2, 2] - patch[2, 0] - patch[0, 2] + patch[0, 0])
    along_x, along_y = patch[1, 2] - 2.0 * top + patch[1, 0], patch[2, 1] - 2.0 * top + patch[0, 1]
    shift = np.zeros(2)
    if along_x < 0.0 and along_x * along_y > mixed**2:
        curvature = np.array([[along_x, mixed], [mixed, along_y]])
        shift = np.clip(np.linalg.solve(curvature, -slope), -1.0, 1.0)
    v_x, v_y = plane.axis[column + 1] + plane.step * shift[0], plane.axis[row + 1] + plane.step * shift[1]
    return top + 0.5 * float(slope @ shift), float(v_x), float(v_y)
