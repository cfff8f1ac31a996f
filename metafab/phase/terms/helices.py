"""Terms that make a PSF turn with depth: spiral zones (Eq. 2), their optimised form, vortex, double helix.

Where a term gives the two polarisations a conjugate pair, y is evaluated as x at the mirrored point: psi_y(x, y)
= psi_x(-x, -y) by construction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import binom

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.numeric.compiled import HAS_NUMBA
from metafab.phase.pupil import phasor
from metafab.phase.terms.angle import angle
from metafab.phase.terms.panels import angles_by_panels


def zone_radii(zones: int, exponent: float) -> FloatArray:
    """Outer radii (l / L)^epsilon of the zones l = 1 to L in units of the aperture's radius: Eq. 2."""
    return np.asarray((np.arange(1, zones + 1) / zones) ** exponent)


def zone_charges(radius: FloatArray, zones: int, exponent: float) -> NDArray[np.int64]:
    """Topological charge of Eq. 2 at normalised radii of any shape: 1 to L, L also beyond the aperture.

    A boundary belongs to the zone inside it.
    """
    return np.minimum(np.searchsorted(zone_radii(zones, exponent), radius, side="left") + 1, zones)


@dataclass(frozen=True)
class SpiralZonesPhase:
    """Fresnel zones with spiral phases of charge 1 to L outwards: Eq. 2 of Shen 2023; y the point mirror of x.

    Attributes:
        zones: L.
        exponent: epsilon.
        radius_um: aperture's radius (half the side of a square one).
        polarisation: the one that it acts on; None for both.
    """

    zones: int
    exponent: float
    radius_um: float
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase l phi on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        sign = 1.0 if polarisation == "x" else -1.0
        x, y = sign * x_um / self.radius_um, (sign * y_um / self.radius_um)[:, None]
        # A root and our own angle cost a quarter of NumPy's hypot and arctan2, and differ by less than 1e-11 rad.
        charges = zone_charges(np.sqrt(x * x + y * y), self.zones, self.exponent)
        return np.asarray(charges * angle(x + 1j * y), dtype=np.float64)


@dataclass(frozen=True)
class WaveSumPhase:
    """The phase of a sum of defocused, tilted waves; y the point mirror of x.

    What maximises the peaks of a PSF at given points and depths has this form (``peak``), so the optimised mask
    is known at every point: nothing is sampled or interpolated, and there are no zone boundaries left, only the
    zeros of the sum, which are vortices. Each wave is a product of a function of x and one of y; compiled, the sum is
    interpolated along y (:mod:`metafab.phase.terms.panels`), which turns its phase by less than 1e-4 rad wherever
    the sum
    exceeds 5e-4 of the sum of the weights' moduli: everywhere but in the very core of a vortex.

    Attributes:
        radius_um: aperture's radius R (half the side of a square one).
        amplitude: shape (n,), complex weights.
        defocus_rad: shape (n,), W of exp(-i W u^2).
        tilt_rad: shape (n, 2), v of exp(i v . u), optical units.
        polarisation: the one that it acts on; None for both.
    """

    radius_um: float
    amplitude: ComplexArray
    defocus_rad: FloatArray
    tilt_rad: FloatArray
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad in [-pi, pi]."""
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        sign = 1.0 if polarisation == "x" else -1.0
        x, y = sign * x_um / self.radius_um, sign * y_um / self.radius_um
        if not HAS_NUMBA or np.any(np.abs(y) > 1.0):
            return angle(self.field(x, y))
        tilt_y = self.tilt_rad[:, 1]
        slope_rad = float(np.max(np.abs(tilt_y) + 2.0 * np.abs(self.defocus_rad)))
        weighted_x = self._waves(x, self.tilt_rad[:, 0]) * self.amplitude
        return angles_by_panels(weighted_x, lambda points: self._waves(points, tilt_y), y, slope_rad)

    def field(self, x: FloatArray, y: FloatArray) -> ComplexArray:
        """The sum of waves on the grid of normalised ``x`` (n_x,) and ``y`` (n_y,): shape (n_y, n_x)."""
        along_x = self._waves(x, self.tilt_rad[:, 0])
        along_y = self._waves(y, self.tilt_rad[:, 1])
        return np.asarray((along_y * self.amplitude) @ along_x.T)

    def _waves(self, position: FloatArray, tilt_rad: FloatArray) -> ComplexArray:
        return phasor(np.outer(position, tilt_rad) - np.outer(position**2, self.defocus_rad))


@dataclass(frozen=True)
class VortexPhase:
    """A spiral phase of integer charge, the same for both polarisations.

    Attributes:
        charge: phase gained in one turn counter-clockwise, in units of 2 pi.
        polarisation: the one that it acts on; None for both.
    """

    charge: int
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        return self.charge * np.arctan2(y_um[:, None], x_um)


@dataclass(frozen=True)
class DoubleHelixPhase:
    """The phase of a sum of Gauss-Laguerre modes on a line of the modal plane, for comparison; y mirrors x.

    Modes of radial index j and azimuthal index 2 j + 1 (j = 0, 1, ...), equal weights: (n, m) = (1, 1), (5, 3),
    (9, 5), ... of Pavani and Piestun, Optics Express 16, 3484 (2008). All azimuthal indices are odd, so the mirror
    only adds pi, and the PSF is symmetric about its centre: the pair of polarisations tells nothing new.

    Attributes:
        radius_um: aperture's radius.
        waist: 1/e radius of the fundamental mode's amplitude, in units of the aperture's radius.
        modes: how many.
        polarisation: the one that it acts on; None for both.
    """

    radius_um: float
    waist: float
    modes: int
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad in [-pi, pi]."""
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        scale = (1.0 if polarisation == "x" else -1.0) * math.sqrt(2.0) / (self.waist * self.radius_um)
        position = scale * x_um + 1j * (scale * y_um)[:, None]
        intensity = np.abs(position) ** 2
        total = np.zeros(position.shape, dtype=np.complex128)
        for j in range(self.modes):
            order = 2 * j + 1
            # Norm sqrt(j! / (j + m)!) of a mode; the Gaussian is common to all and has no phase.
            norm = math.sqrt(math.factorial(j) / math.factorial(j + order))
            laguerre = np.zeros_like(intensity)
            for k in range(j, -1, -1):
                laguerre = laguerre * intensity + (-1) ** k * binom(j + order, j - k) / math.factorial(k)
            total += norm * position**order * laguerre
        return angle(total)
