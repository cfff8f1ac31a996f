"""How the pair changes over the field of view: where the two images stand, and which depth they seem to have.

A mask's phases stay what they are while the object moves, so that all that changes is the path from the object over
the lens to the geometric image point. Its second order is a change of vergence (defocus), which the two carriers,
deflecting to opposite sides, give opposite signs to first order in the direction, and astigmatism of the same size:
along the split the curvature changes three times as much as across. How much nearer or farther an object then seems is
up to the mask; the helix pair takes the astigmatism for depth, too, and errs by 1.4 times the defocus.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray
from metafab.optics.interpolation.field import spline_weights
from metafab.optics.point_spread import Psf

#: Points of the lens, along radius and azimuth, that a change of path is fitted to.
_RADII, _AZIMUTHS = 12, 24
#: Depths that are tried for each that a stack holds, when PSFs are compared.
_TRIALS = 8


@dataclass(frozen=True)
class SpaceVariance:
    """Over a grid of object directions, for both polarisations.

    Attributes:
        tangent_x: shape (n_x,), x/z of the object; likewise ``tangent_y``.
        tangent_y: shape (n_y,).
        defocus_dioptre: shape (2, n_y, n_x), change of vergence, positive as if the object were nearer.
        astigmatism_dioptre: the same shape, half of what the vergence along x is above that along y.
        image_um: shape (2, n_y, n_x, 2), (x, y) of the geometric image points on the sensor.
        distortion_um: the same shape, what they miss the image of a pinhole at the lens' centre by.
    """

    tangent_x: FloatArray
    tangent_y: FloatArray
    defocus_dioptre: FloatArray
    astigmatism_dioptre: FloatArray
    image_um: FloatArray
    distortion_um: FloatArray


def space_variance(imaging: Imaging, tangent_x: FloatArray, tangent_y: FloatArray, depth_m: float) -> SpaceVariance:
    """Image points and aberrations over a grid of directions, by geometry alone; any depth has nearly the same."""
    grid = [(float(t_x), float(t_y)) for t_y in tangent_y for t_x in tangent_x]
    shape = (2, tangent_y.size, tangent_x.size)
    second = np.array([[aberration_dioptre(imaging, p, t, depth_m) for t in grid] for p in (0, 1)])
    defocus, astigmatism = np.moveaxis(second.reshape(*shape, 2), -1, 0)
    image = np.array([[imaging.image_point_um(p, t) for t in grid] for p in (0, 1)]).reshape(*shape, 2)
    pinhole = np.array([[imaging.image_point_um(p, (0.0, 0.0)) for _ in grid] for p in (0, 1)]).reshape(*shape, 2)
    pinhole -= imaging.sensor_distance_um * np.array(grid).reshape(*shape[1:], 2)
    return SpaceVariance(tangent_x, tangent_y, defocus, astigmatism, image, image - pinhole)


def aberration_dioptre(
    imaging: Imaging, polarisation: int, tangent: tuple[float, float], depth_m: float
) -> tuple[float, float]:
    """Defocus and astigmatism of an object beside the axis, to one polarisation.

    The change of path from the axis to the object's direction, at one depth, fitted by least squares over the circle
    that holds the aperture: its coefficients of (x^2 + y^2) / 2 and (x^2 - y^2) / 2, beside tilt, skew and coma.
    """
    rim_um = 0.5 * imaging.aperture_um
    radius = rim_um * np.sqrt((np.arange(_RADII) + 0.5) / _RADII)[:, None]
    azimuth = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    x, y = (radius * np.cos(azimuth)).ravel(), (radius * np.sin(azimuth)).ravel()
    rays = [Ray.towards_image(imaging, polarisation, depth_m, t) for t in (tangent, (0.0, 0.0))]
    change_um = rays[0].path_um(x, y) - rays[1].path_um(x, y)
    u, v = x / rim_um, y / rim_um
    square = u * u + v * v
    terms = np.stack([np.ones_like(u), u, v, square, u * u - v * v, u * v, square * u, square * v], axis=1)
    defocus, astigmatism = 2e6 * np.linalg.lstsq(terms, change_um, rcond=None)[0][3:5] / rim_um**2
    return float(defocus), float(astigmatism)


def seen_bias_dioptre(psf: Psf) -> FloatArray:
    """Vergence by which objects seem nearer than they are: that on the axis whose PSF is most like the field point's.

    Args:
        psf: a stack with a field.

    Returns:
        Shape (2, n_y, n_x), at the middle depth; NaN where the most like lies at an end of the stack.
    """
    if psf.field is None:
        raise ValueError("`psf`: expected a stack with a field of view, got the axis alone")
    middle = psf.depth_m.size // 2
    nodes = 1.0 / psf.depth_m
    trial = np.linspace(nodes.min(), nodes.max(), _TRIALS * nodes.size)
    weights = spline_weights(nodes, trial)
    n_y, n_x = psf.field.psf.shape[2:4]
    seen = np.empty((2, n_y, n_x))
    for p in (0, 1):
        known = weights @ psf.psf[p].reshape(nodes.size, -1)
        known /= np.linalg.norm(known, axis=1, keepdims=True)
        likeness = psf.field.psf[p, middle].reshape(n_y * n_x, -1).astype(np.float64) @ known.T
        seen[p] = np.array([_summit(trial, row) for row in likeness]).reshape(n_y, n_x) - nodes[middle]
    return seen


def _summit(places: FloatArray, values: FloatArray) -> float:
    """Where the largest value is, by a parabola through it and its neighbours; NaN at an end."""
    k = int(np.argmax(values))
    if k in {0, values.size - 1}:
        return float("nan")
    below, at, above = values[k - 1 : k + 2]
    return float(places[k] + 0.5 * (above - below) / (2.0 * at - below - above) * (places[1] - places[0]))
