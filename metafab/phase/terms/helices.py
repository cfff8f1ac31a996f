"""Terms that make a PSF turn with depth: spiral zones (Eq. 2 of Shen 2023), their optimised form, vortex, double helix.

In a conjugate pair y polarisation is x polarisation at the mirrored point: psi_y(x, y) = psi_x(-x, -y).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import binom

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.numeric.phasor import phasor
from metafab.phase.pupil import Pupil, pupil_field
from metafab.phase.terms.angles import angle, angles_of_waves
from metafab.phase.terms.profile import PolarisedTerm


def zone_radii(zones: int, exponent: float) -> FloatArray:
    """Outer radii (l / L)^epsilon of the zones of Eq. 2 over the aperture's radius, shape (zones,), l = 1 to L."""
    return np.asarray((np.arange(1, zones + 1) / zones) ** exponent)


def zone_charges(radius: FloatArray, zones: int, exponent: float) -> NDArray[np.int64]:
    """Topological charge of Eq. 2 (L, epsilon), 1 to L, at radii of any shape; a boundary belongs to its inner zone.

    Radii are in units of the aperture's radius; beyond the aperture the charge is L.
    """
    return np.minimum(np.searchsorted(zone_radii(zones, exponent), radius, side="left") + 1, zones)


@dataclass(frozen=True, kw_only=True)
class SpiralZonesPhase(PolarisedTerm):
    """Fresnel zones with spiral phases of charge 1 to L outwards: Eq. 2 of Shen 2023; y is the point mirror of x."""

    zones: int  #: L.
    exponent: float  #: epsilon.
    radius_um: float  #: Radius of the aperture (half the side of a square one).

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        sign = 1.0 if polarisation == "x" else -1.0
        x, y = sign * x_um / self.radius_um, (sign * y_um / self.radius_um)[:, None]
        # A root and the compiled angle cost a quarter of NumPy's hypot and arctan2.
        charges = zone_charges(np.sqrt(x * x + y * y), self.zones, self.exponent)
        return np.asarray(charges * angle(x + 1j * y), dtype=np.float64)


def spiral_field(pupil: Pupil, zones: int, exponent: float) -> ComplexArray:
    """Return exp(i psi) of Eq. 2 (L, epsilon) for x polarisation at the n samples of a pupil: shape (n,)."""
    return pupil_field(SpiralZonesPhase(zones=zones, exponent=exponent, radius_um=1.0), pupil, 1.0)


@dataclass(frozen=True)
class WaveSumPhase(PolarisedTerm):
    """The phase of a sum of defocused, tilted waves; y is the point mirror of x.

    The mask that maximises the peaks of a PSF at given points and depths has this form
    (:mod:`metafab.phase.optimise.peak`). It is known at every point: nothing is sampled, and instead of zone boundaries
    it has vortices at the zeros of the sum. Inside the aperture the sum is interpolated along y
    (:mod:`metafab.phase.terms.angles`). That changes the phase by less than 1e-4 rad wherever the sum exceeds 5e-4 of
    the sum of the moduli of the weights: everywhere but in the core of a vortex.
    """

    radius_um: float  #: Radius R of the aperture (half the side of a square one).
    amplitude: ComplexArray  #: Shape (n,), complex weights.
    defocus_rad: FloatArray  #: Shape (n,), W of exp(-i W u^2).
    tilt_rad: FloatArray  #: Shape (n, 2), v of exp(i v . u), optical units.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        sign = 1.0 if polarisation == "x" else -1.0
        x, y = sign * x_um / self.radius_um, sign * y_um / self.radius_um
        if np.any(np.abs(y) > 1.0):
            return angle(self.field(x, y))
        tilt_y = self.tilt_rad[:, 1]
        slope_rad = float(np.max(np.abs(tilt_y) + 2.0 * np.abs(self.defocus_rad)))
        weighted_x = self._waves(x, self.tilt_rad[:, 0]) * self.amplitude
        return angles_of_waves(weighted_x, lambda points: self._waves(points, tilt_y), y, slope_rad)

    def field(self, x: FloatArray, y: FloatArray) -> ComplexArray:
        """Evaluate the sum of waves, shape (n_y, n_x), at x, shape (n_x,), and y, in units of the aperture's radius."""
        along_x = self._waves(x, self.tilt_rad[:, 0])
        along_y = self._waves(y, self.tilt_rad[:, 1])
        return np.asarray((along_y * self.amplitude) @ along_x.T)

    def _waves(self, position: FloatArray, tilt_rad: FloatArray) -> ComplexArray:
        return phasor(np.outer(position, tilt_rad) - np.outer(position**2, self.defocus_rad))


@dataclass(frozen=True, kw_only=True)
class VortexPhase(PolarisedTerm):
    """A spiral phase of integer charge, equal for both polarisations."""

    charge: int  #: Phase gained in one turn counter-clockwise, in units of 2 pi.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        return self.charge * np.arctan2(y_um[:, None], x_um)


@dataclass(frozen=True, kw_only=True)
class DoubleHelixPhase(PolarisedTerm):
    """The phase of a sum of Gauss-Laguerre modes on a line of the modal plane, for comparison; y mirrors x.

    Modes of radial index j and azimuthal index 2 j + 1 (j = 0, 1, ...) with equal weights: (n, m) = (1, 1), (5, 3),
    (9, 5), ... of Pavani and Piestun, Optics Express 16, 3484 (2008). All azimuthal indices are odd, so the mirror only
    adds pi. The PSF is symmetric about its centre, and the pair of polarisations carries one image twice.
    """

    radius_um: float  #: Radius of the aperture.
    waist: float  #: 1/e radius of the fundamental mode's amplitude, in units of the aperture's radius.
    modes: int  #: Number of modes.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        scale = (1.0 if polarisation == "x" else -1.0) * math.sqrt(2.0) / (self.waist * self.radius_um)
        position = scale * x_um + 1j * (scale * y_um)[:, None]
        intensity = np.abs(position) ** 2
        total = np.zeros(position.shape, dtype=np.complex128)
        for j in range(self.modes):
            order = 2 * j + 1
            # Norm sqrt(j! / (j + m)!) of a mode; the Gaussian is common to all modes and has no phase.
            norm = math.sqrt(math.factorial(j) / math.factorial(j + order))
            laguerre = np.zeros_like(intensity)
            for k in range(j, -1, -1):
                laguerre = laguerre * intensity + (-1) ** k * binom(j + order, j - k) / math.factorial(k)
            total += norm * position**order * laguerre
        return angle(total)
