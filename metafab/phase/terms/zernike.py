"""Zernike polynomials over the aperture, to give a lens an aberration or to correct one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation
from metafab.phase.terms.profile import PolarisedTerm


@dataclass(frozen=True)
class ZernikePhase(PolarisedTerm):
    """The phase amplitude R_n^|m|(u) cos(m phi), or sin(|m| phi) for negative m (Born and Wolf, section 9.2).

    Attributes:
        degree: n.
        order: m.
        amplitude_rad: phase at the rim where the cosine or sine is 1.
        radius_um: radius of the aperture.
    """

    degree: int
    order: int
    amplitude_rad: float
    radius_um: float

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        position = x_um / self.radius_um + 1j * (y_um / self.radius_um)[:, None]
        turn = position ** abs(self.order)  # u^m exp(i m phi)
        radial = np.polyval(_radial_coefficients(self.degree, abs(self.order)), np.abs(position) ** 2)
        return np.asarray(self.amplitude_rad * radial * (turn.imag if self.order < 0 else turn.real))


def _radial_coefficients(degree: int, order: int) -> FloatArray:
    """Coefficients of R_n^m / u^m as a polynomial in u^2, highest power first; R = 1 at the rim.

    Args:
        degree: n.
        order: m, 0 to n with n - m even.
    """
    half = (degree - order) // 2
    return np.array(
        [
            (-1) ** k
            * math.factorial(degree - k)
            / (math.factorial(k) * math.factorial((degree + order) // 2 - k) * math.factorial(half - k))
            for k in range(half + 1)
        ]
    )
