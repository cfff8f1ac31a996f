"""Zernike polynomials over the aperture, for aberrations that a lens is to have or to correct."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation


def radial_coefficients(degree: int, order: int) -> FloatArray:
    """Coefficients of R_n^m as a polynomial in u^2 times u^m, highest power first; R = 1 at the rim.

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


@dataclass(frozen=True)
class ZernikePhase:
    """amplitude R_n^|m|(u) cos(m phi), or sin(|m| phi) for negative m (Born and Wolf, section 9.2).

    Attributes:
        degree: n.
        order: m.
        amplitude_rad: value at the rim where the cosine or sine is 1.
        radius_um: aperture's radius.
        polarisation: the one that it acts on; None for both.
    """

    degree: int
    order: int
    amplitude_rad: float
    radius_um: float
    polarisation: Polarisation | None = None

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad, not wrapped."""
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        position = x_um / self.radius_um + 1j * (y_um / self.radius_um)[:, None]
        turn = position ** abs(self.order)  # u^m exp(i m phi)
        radial = np.polyval(radial_coefficients(self.degree, abs(self.order)), np.abs(position) ** 2)
        return np.asarray(self.amplitude_rad * radial * (turn.imag if self.order < 0 else turn.real))
