"""Zernike and radial polynomials over the aperture: the surfaces and aberrations of lens-design programs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metafab.core.conventions import FloatArray, Polarisation
from metafab.phase.terms.profile import PolarisedTerm


@dataclass(frozen=True, kw_only=True)
class ZernikePhase(PolarisedTerm):
    """The phase amplitude R_n^|m|(u) cos(m phi), or sin(|m| phi) for negative m (Born and Wolf, section 9.2)."""

    degree: int  #: n.
    order: int  #: m.
    amplitude_rad: float  #: Phase at the rim where the cosine or sine is 1.
    radius_um: float  #: Radius of the aperture.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        position = x_um / self.radius_um + 1j * (y_um / self.radius_um)[:, None]
        turn = position ** abs(self.order)  # u^m exp(i m phi)
        radial = np.polyval(_radial_coefficients(self.degree, abs(self.order)), np.abs(position) ** 2)
        return np.asarray(self.amplitude_rad * radial * (turn.imag if self.order < 0 else turn.real))


@dataclass(frozen=True, kw_only=True)
class RadialPhase(PolarisedTerm):
    """The even polynomial sum over i of c_i (r / radius)^(2 i), i from 1."""

    coefficients_rad: tuple[float, ...]  #: c_i.
    radius_um: float  #: Radius that r is divided by.

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        square = (x_um / self.radius_um) ** 2 + ((y_um / self.radius_um) ** 2)[:, None]
        return np.asarray(np.polyval([*self.coefficients_rad[::-1], 0.0], square))


def zernike_number(number: int, convention: Literal["noll", "fringe"]) -> tuple[int, int, float]:
    """Return degree, order and norm of a polynomial by its number; it is the norm times a :class:`ZernikePhase`.

    Args:
        number: from 1.
        convention: "noll": Noll, J. Opt. Soc. Am. 66, 207 (1976), rms 1 over the unit circle. "fringe": 1 at the rim.
    """
    if convention == "fringe":
        # Rings of equal n + |m|: ring k begins at (k / 2)^2 + 1.
        both = 2 * (math.isqrt(number - 1) if number > 1 else 0)
        place = number - (both // 2) ** 2 - 1
        degree = both // 2 + place // 2
        return degree, (both - degree) * (-1 if place % 2 else 1), 1.0
    degree, place = 0, number - 1
    while place > degree:
        degree += 1
        place -= degree
    order = degree % 2 + 2 * ((place + (degree + 1) % 2) // 2)
    norm = math.sqrt((degree + 1.0) * (2.0 if order else 1.0))
    return degree, order if number % 2 == 0 else -order, norm


def _radial_coefficients(degree: int, order: int) -> FloatArray:
    """Coefficients of R_n^m / u^m as a polynomial in u^2, highest power first; R = 1 at the rim, degree n, order m."""
    half = (degree - order) // 2
    return np.array(
        [
            (-1) ** k
            * math.factorial(degree - k)
            / (math.factorial(k) * math.factorial((degree + order) // 2 - k) * math.factorial(half - k))
            for k in range(half + 1)
        ]
    )
