"""Variation of the pair over the field of view: image points, aberrations and depth bias.

The phases of a mask are fixed, so that an object off the axis changes only the path over the lens to its geometric
image point. The second order of this change is a defocus and an astigmatism of the same size: along the split the
curvature changes three times as much as across. To first order in the direction, both have opposite signs for the two
polarisations, which the carriers deflect to opposite sides. The resulting depth bias depends on the mask: the helix
pair responds to astigmatism, too, and errs by 1.4 times the defocus.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.figures import SpaceVariance
from metafab.core.numeric.interpolation import parabolic_maximum, spline_weights
from metafab.optics.geometry.imaging import Imaging, Tangent
from metafab.optics.geometry.path import Ray
from metafab.optics.point_spread import Psf

#: Points of the lens along radius and azimuth at which the change of path is fitted.
_RADII, _AZIMUTHS = 12, 24
#: Trial depths per depth of the stack when PSFs are compared.
_TRIALS = 8


def space_variance(imaging: Imaging, tangent_x: FloatArray, tangent_y: FloatArray, depth_m: float) -> SpaceVariance:
    """Return image points and aberrations over a grid of directions x/z and y/z, shapes (n_x,) and (n_y,).

    They hardly depend on the depth.
    """
    grid = [(float(t_x), float(t_y)) for t_y in tangent_y for t_x in tangent_x]
    shape = (2, tangent_y.size, tangent_x.size)
    second = np.array([[aberration_dioptre(imaging, p, t, depth_m) for t in grid] for p in (0, 1)])
    defocus, astigmatism = np.moveaxis(second.reshape(*shape, 2), -1, 0)
    image = np.array([[imaging.image_point_um(p, t) for t in grid] for p in (0, 1)]).reshape(*shape, 2)
    pinhole = np.array([[imaging.image_point_um(p, (0.0, 0.0)) for _ in grid] for p in (0, 1)]).reshape(*shape, 2)
    pinhole -= imaging.sensor_distance_um * np.array(grid).reshape(*shape[1:], 2)
    return SpaceVariance(tangent_x, tangent_y, defocus, astigmatism, image - pinhole)


def aberration_dioptre(
    imaging: Imaging, polarisation: int, tangent: tuple[float, float], depth_m: float
) -> tuple[float, float]:
    """Return defocus and astigmatism of an object off the axis for one polarisation.

    They are the coefficients of (x^2 + y^2) / 2 and (x^2 - y^2) / 2 in a least-squares fit, with tilt, skew and coma,
    to the change of path from the axis to the direction of the object, over the circle around the aperture.
    """
    u, v, change_um = _path_change(imaging, polarisation, ((0.0, 0.0), tangent), depth_m)
    square = u * u + v * v
    terms = np.stack([np.ones_like(u), u, v, square, u * u - v * v, u * v, square * u, square * v], axis=1)
    rim_um = 0.5 * imaging.aperture_um
    defocus, astigmatism = 2e6 * np.linalg.lstsq(terms, change_um, rcond=None)[0][3:5] / rim_um**2
    return float(defocus), float(astigmatism)


def wavefront_change_rad(
    imaging: Imaging, polarisation: int, tangents: tuple[Tangent, Tangent], depth_m: float
) -> float:
    """Return the rms difference of the wavefronts of two object directions over the aperture, tilt taken out."""
    u, v, change_um = _path_change(imaging, polarisation, tangents, depth_m)
    terms = np.stack([np.ones_like(u), u, v], axis=1)
    return imaging.wavenumber * float((change_um - terms @ np.linalg.lstsq(terms, change_um, rcond=None)[0]).std())


def _path_change(
    imaging: Imaging, polarisation: int, tangents: tuple[Tangent, Tangent], depth_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (u, v) of the circle around the aperture, over its radius, and the change of path, um, shape (n,) each."""
    rim_um = 0.5 * imaging.aperture_um
    radius = rim_um * np.sqrt((np.arange(_RADII) + 0.5) / _RADII)[:, None]
    azimuth = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    x, y = (radius * np.cos(azimuth)).ravel(), (radius * np.sin(azimuth)).ravel()
    before, after = (Ray.towards_image(imaging, polarisation, depth_m, t).path_um(x, y) for t in tangents)
    return x / rim_um, y / rim_um, after - before


def depth_bias_dioptre(psf: Psf) -> FloatArray:
    """Return the apparent minus the true vergence over the field, shape (2, n_y, n_x), at the stack's middle depth.

    The apparent vergence is that of the PSF on the axis with the largest correlation with the PSF at the field point;
    NaN where that is at an end of the stack. ValueError for a stack without a field.
    """
    if psf.field is None:
        raise ValueError("`psf`: expected a stack with a field of view, got the axis alone")
    middle = psf.depth_m.size // 2
    nodes = 1.0 / psf.depth_m
    trial = np.linspace(nodes.min(), nodes.max(), _TRIALS * nodes.size)
    weights = spline_weights(nodes, trial)
    n_y, n_x = psf.field.psf.shape[2:4]
    bias = np.empty((2, n_y, n_x))
    for p in (0, 1):
        axial = weights @ psf.psf[p].reshape(nodes.size, -1)
        axial /= np.linalg.norm(axial, axis=1, keepdims=True)
        correlation = psf.field.psf[p, middle].reshape(n_y * n_x, -1).astype(np.float64) @ axial.T
        place = np.array([parabolic_maximum(row) for row in correlation]).reshape(n_y, n_x)
        bias[p] = trial[0] + place * (trial[1] - trial[0]) - nodes[middle]
    return bias
