"""Terms that deflect or focus light: lens, split lens, grating, axicon.

A root less its value on the axis is computed as sqrt(a + b^2) - b = a / (sqrt(a + b^2) + b), without cancellation near
the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation
from metafab.core.numeric.compiled import compiled
from metafab.phase.terms.profile import PhaseProfile, PolarisedTerm


class Carrier(PolarisedTerm):
    """Base of the terms that send all light somewhere and leave the shape of the PSF to the others."""


@dataclass(frozen=True, kw_only=True)
class LensPhase(Carrier):
    """On-axis hyperbolic lens: -k (sqrt(r^2 + s^2) - s), and for a finite object distance g likewise with g for s."""

    wavelength_um: float  #: Vacuum wavelength.
    image_distance_um: float  #: Distance s of the image (the focal length for an object at infinity).
    object_distance_um: float = math.inf  #: Distance of the object; infinite for parallel light.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        path = path_um(self.image_distance_um, self.object_distance_um, 0.0, 0.0, x_um, y_um)
        return np.asarray(-2.0 * math.pi / self.wavelength_um * path)


@dataclass(frozen=True, kw_only=True)
class SplitLensPhase(Carrier):
    """Off-axis lenses of Eqs. 3 and 4 of Shen 2023: x polarisation to -theta, y polarisation to +theta.

    The image of an object at ``object_distance_um`` on the axis lies at ``image_distance_um`` from the centre of the
    lens in the direction -theta (x) or +theta (y). For parallel light the phase is -(2 pi / lambda) [sqrt(x^2 + y^2 +
    f^2 +- 2 x f sin(theta)) - f].
    """

    wavelength_um: float  #: Vacuum wavelength.
    image_distance_um: float  #: f of Eqs. 3 and 4, or the image distance of a finite conjugate.
    angle_deg: float  #: theta.
    object_distance_um: float = math.inf  #: Distance of the object; infinite in Eqs. 3 and 4.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        sine = math.sin(math.radians(self.angle_deg)) * (1.0 if polarisation == "x" else -1.0)
        path = path_um(self.image_distance_um, self.object_distance_um, sine, 0.0, x_um, y_um)
        return np.asarray(-2.0 * math.pi / self.wavelength_um * path)


@compiled
def path_um(
    image_um: float, object_um: float, sine_x: float, sine_y: float, x_um: FloatArray, y_um: FloatArray
) -> FloatArray:
    """Return the path from an on-axis object through each lens point to its image, less the path through the centre.

    Image and object distances are from the lens' centre, the object's infinite for parallel light. ``sine_x`` and
    ``sine_y`` are minus the direction cosines of the image. Lens points x, shape (n_x,), and y, shape (n_y,), give the
    shape (n_y, n_x).
    """
    path = np.empty((y_um.size, x_um.size))
    shift_x, shift_y = 2.0 * image_um * sine_x, 2.0 * image_um * sine_y
    for row in range(y_um.size):
        y_squared = y_um[row] * y_um[row]
        tilted = y_squared + shift_y * y_um[row]
        for column in range(x_um.size):
            excess = tilted + x_um[column] * x_um[column] + shift_x * x_um[column]
            path[row, column] = excess / (np.sqrt(excess + image_um * image_um) + image_um)
        if math.isfinite(object_um):
            for column in range(x_um.size):
                square = y_squared + x_um[column] * x_um[column]
                path[row, column] += square / (np.sqrt(square + object_um * object_um) + object_um)
    return path


@dataclass(frozen=True, kw_only=True)
class GratingPhase(Carrier):
    """A linear phase that deflects normal incidence by ``angle_deg`` towards ``azimuth_deg``."""

    wavelength_um: float  #: Vacuum wavelength.
    angle_deg: float  #: Angle between the deflected light and the axis, in an ambient of index 1.
    azimuth_deg: float = 0.0  #: Direction of the deflection, counter-clockwise from +x.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        slope = 2.0 * math.pi / self.wavelength_um * math.sin(math.radians(self.angle_deg))
        azimuth = math.radians(self.azimuth_deg)
        return np.asarray((slope * math.sin(azimuth) * y_um)[:, None] + slope * math.cos(azimuth) * x_um)


@dataclass(frozen=True, kw_only=True)
class AxiconPhase(Carrier):
    """Axicon: deflects light by ``angle_deg``, towards the axis for a positive angle."""

    wavelength_um: float  #: Vacuum wavelength.
    angle_deg: float  #: Half angle of the cone.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        slope = -2.0 * math.pi / self.wavelength_um * math.sin(math.radians(self.angle_deg))
        return np.asarray(slope * np.hypot(x_um, y_um[:, None]))


def without_carriers(profile: PhaseProfile) -> PhaseProfile:
    """Return the profile without its carriers: the part that shapes the PSF."""
    return replace(profile, terms=tuple(term for term in profile.terms if not isinstance(term, Carrier)))
