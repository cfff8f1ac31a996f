"""Terms that send light somewhere: lens, split lens, grating, axicon.

Every difference of a root and its value on the axis is written as a quotient, sqrt(a + b^2) - b = a / (sqrt(a +
b^2) + b), which loses no digits near the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation
from metafab.core.numeric.compiled import HAS_NUMBA, compiled


def _acts(only: Polarisation | None, polarisation: Polarisation) -> bool:
    return only is None or only == polarisation


@dataclass(frozen=True)
class LensPhase:
    """A hyperbolic lens on the axis: -k (sqrt(r^2 + s^2) - s), and for an object at a finite depth the same of it.

    Attributes:
        wavelength_um: vacuum wavelength.
        image_distance_um: distance s of the image (the focal length for an object at infinity).
        object_distance_um: distance of the object; infinite for parallel light.
        polarisation: the one that it acts on; None for both.
    """

    wavelength_um: float
    image_distance_um: float
    object_distance_um: float = math.inf
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if not _acts(self.polarisation, polarisation):
            return np.zeros((y_um.size, x_um.size))
        return _converging(self.wavelength_um, self.image_distance_um, self.object_distance_um, 0.0, x_um, y_um)


@dataclass(frozen=True)
class SplitLensPhase:
    """Off-axis lenses of Eqs. 3 and 4 of Shen 2023: x polarisation to -theta, y polarisation to +theta.

    The image of an object at ``object_distance_um`` on the axis lies at ``image_distance_um`` from the lens'
    centre in the direction of -+theta: for parallel light -(2 pi / lambda) [sqrt(x^2 + y^2 + f^2 +- 2 x f
    sin(theta)) - f].

    Attributes:
        wavelength_um: vacuum wavelength.
        image_distance_um: f of Eqs. 3 and 4, or the image distance of a finite conjugate.
        angle_deg: theta.
        object_distance_um: distance of the object; infinite in Eqs. 3 and 4.
        polarisation: the one that it acts on; None for both.
    """

    wavelength_um: float
    image_distance_um: float
    angle_deg: float
    object_distance_um: float = math.inf
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if not _acts(self.polarisation, polarisation):
            return np.zeros((y_um.size, x_um.size))
        sine = math.sin(math.radians(self.angle_deg)) * (1.0 if polarisation == "x" else -1.0)
        return _converging(self.wavelength_um, self.image_distance_um, self.object_distance_um, sine, x_um, y_um)


def _converging(
    wavelength_um: float, image_um: float, object_um: float, sine: float, x_um: FloatArray, y_um: FloatArray
) -> FloatArray:
    """-k (path from the surface to the image, and from the object to the surface, less those of the centre)."""
    path = (_path_compiled if HAS_NUMBA else path_vectorised)(image_um, object_um, sine, x_um, y_um)
    path *= -2.0 * math.pi / wavelength_um
    return path


def path_vectorised(image_um: float, object_um: float, sine: float, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
    """The path in NumPy alone, shape (n_y, n_x), um."""
    radius_squared = (y_um * y_um)[:, None] + x_um * x_um
    excess = radius_squared + (2.0 * image_um * sine) * x_um
    path = np.asarray(excess / (np.sqrt(excess + image_um**2) + image_um))
    if math.isfinite(object_um):
        path += radius_squared / (np.sqrt(radius_squared + object_um**2) + object_um)
    return path


@compiled
def _path_compiled(image_um: float, object_um: float, sine: float, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
    """As :func:`path_vectorised`, in one pass."""
    path = np.empty((y_um.size, x_um.size))
    shift = 2.0 * image_um * sine
    for row in range(y_um.size):
        y_squared = y_um[row] * y_um[row]
        for column in range(x_um.size):
            excess = y_squared + x_um[column] * x_um[column] + shift * x_um[column]
            path[row, column] = excess / (np.sqrt(excess + image_um * image_um) + image_um)
        if math.isfinite(object_um):
            for column in range(x_um.size):
                square = y_squared + x_um[column] * x_um[column]
                path[row, column] += square / (np.sqrt(square + object_um * object_um) + object_um)
    return path


@dataclass(frozen=True)
class GratingPhase:
    """A linear phase that deflects normal incidence by ``angle_deg`` towards ``azimuth_deg``.

    Attributes:
        wavelength_um: vacuum wavelength.
        angle_deg: angle of the deflected light to the axis, in the ambient of index 1.
        azimuth_deg: direction of the deflection, counter-clockwise from +x.
        polarisation: the one that it acts on; None for both.
    """

    wavelength_um: float
    angle_deg: float
    azimuth_deg: float = 0.0
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if not _acts(self.polarisation, polarisation):
            return np.zeros((y_um.size, x_um.size))
        slope = 2.0 * math.pi / self.wavelength_um * math.sin(math.radians(self.angle_deg))
        azimuth = math.radians(self.azimuth_deg)
        return np.asarray((slope * math.sin(azimuth) * y_um)[:, None] + slope * math.cos(azimuth) * x_um)


@dataclass(frozen=True)
class AxiconPhase:
    """A cone: every point's light leaves at ``angle_deg`` to the axis, towards it where the angle is positive.

    Attributes:
        wavelength_um: vacuum wavelength.
        angle_deg: half angle of the cone of light.
        polarisation: the one that it acts on; None for both.
    """

    wavelength_um: float
    angle_deg: float
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if not _acts(self.polarisation, polarisation):
            return np.zeros((y_um.size, x_um.size))
        slope = -2.0 * math.pi / self.wavelength_um * math.sin(math.radians(self.angle_deg))
        return np.asarray(slope * np.hypot(x_um, y_um[:, None]))


#: Terms that say where light goes and not how its PSF turns.
CARRIERS = (SplitLensPhase, LensPhase, GratingPhase, AxiconPhase)
