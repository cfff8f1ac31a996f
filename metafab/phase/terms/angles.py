"""Angles of many complex numbers, and of sums of separable waves on a grid, in compiled loops.

The general arctangent would take nine tenths of the time of a tile. Here it is a polynomial of degree 12 in the squared
ratio of the smaller to the larger part, by interpolation in Chebyshev points: error below 1e-11 rad.

A sum of waves is smooth along y. It is evaluated at the Chebyshev points of panels and interpolated between them, which
is several times faster than the sum at each site. Panels are fixed on the pupil, so the phase of a site does not depend
on its tile.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.chebyshev import power_coefficients
from metafab.core.numeric.compiled import compiled

#: Largest error of the interpolated sum, as a share of the sum of the moduli of the weights. For n points it is
#: 4 M rho^(1 - n) / (rho - 1) (Trefethen, Approximation Theory and Approximation Practice, theorem 8.2), where M is the
#: largest modulus on the ellipse of any rho > 1: 4.9e-8 for rho = 28, 8 points, waves that turn by at most half a
#: radian per half panel, and half panels of at most 1/64.
INTERPOLATION_ERROR = 5e-8

#: Degree of the polynomial for arctan(a) / a in a^2: the angle errs by 6e-12 rad at most.
_DEGREE = 12
_POINTS = 8  # as many as _interpolated_angles writes out
_FEWEST_PANELS = 32  # on half the axis, [0, 1]


def angle(values: ComplexArray) -> FloatArray:
    """Return the angle of each value, rad in [-pi, pi] and 0 for 0, for any shape."""
    out = np.empty(values.shape)
    _angles(np.ascontiguousarray(values).ravel(), out.ravel())
    return out


def angles_of_waves(
    weighted_x: ComplexArray, along_y: Callable[[FloatArray], ComplexArray], y: FloatArray, slope_rad: float
) -> FloatArray:
    """Return the angle of sum_k weighted_x[:, k] along_y(y)[:, k] on a grid: shape (n_y, n_x), rad in [-pi, pi].

    Args:
        weighted_x: shape (n_x, n), the waves along x times their weights.
        along_y: the waves, shape (m, n), at positions of shape (m,).
        y: shape (n_y,), in any order, within [-1, 1].
        slope_rad: largest slope of the phase of any wave along y, rad per unit of y.
    """
    panels = 2 ** math.ceil(math.log2(max(slope_rad, _FEWEST_PANELS)))
    places, first, basis = _interpolation(np.asarray(y, dtype=np.float64).tobytes(), panels)
    sums = along_y(places) @ weighted_x.T
    out = np.empty((y.size, len(weighted_x)))
    real, imag = np.ascontiguousarray(sums.real), np.ascontiguousarray(sums.imag)
    _interpolated_angles(first, basis, real, imag, out)
    return out


@lru_cache(maxsize=8)
def _interpolation(y: bytes, panels: int) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Points of the panels that hold positions y, the first point of each position, and its weights of the points.

    Tiles in a row of the lens have the same y, which costs more here than the sums of a tile.
    """
    position = np.frombuffer(y) * panels
    panel = np.clip(np.floor(position), -panels, panels - 1)
    used, which = np.unique(panel, return_inverse=True)
    points = np.cos((np.arange(_POINTS) + 0.5) * (np.pi / _POINTS))
    places = ((used[:, None] + 0.5 + 0.5 * points) / panels).ravel()
    return places, which * _POINTS, _lagrange(2.0 * (position - panel) - 1.0, points)


def _lagrange(position: FloatArray, points: FloatArray) -> FloatArray:
    """Polynomials that are 1 at one of the Chebyshev points and 0 at the others, shape (n_position, n_points)."""
    order = points.size - 1
    series = 2.0 / points.size * np.polynomial.chebyshev.chebvander(points, order)
    series[:, 0] *= 0.5
    return np.asarray(np.polynomial.chebyshev.chebvander(position, order) @ series.T)


#: Coefficients of arctan(a) / a as a polynomial in q = a^2, lowest power first.
_COEFFICIENTS = power_coefficients(lambda q: np.arctan(np.sqrt(q)) / np.sqrt(q), _DEGREE, (0.0, 1.0))


@compiled
def _angle_of(real: float, imag: float) -> float:
    """Angle of one complex number, rad in [-pi, pi]."""
    c = _COEFFICIENTS
    across, along = abs(real), abs(imag)
    # The smallest normal number prevents 0 / 0 and vanishes in the rounding of any other denominator.
    ratio = min(across, along) / (max(across, along) + 2.3e-308)
    q = ratio * ratio
    tail = c[12] * q + c[11]
    tail = ((tail * q + c[10]) * q + c[9]) * q + c[8]
    tail = (((tail * q + c[7]) * q + c[6]) * q + c[5]) * q + c[4]
    tail = (((tail * q + c[3]) * q + c[2]) * q + c[1]) * q + c[0]
    turn = tail * ratio
    if along > across:
        turn = 0.5 * np.pi - turn
    if real < 0.0:
        turn = np.pi - turn
    return turn if imag >= 0.0 else -turn


@compiled
def _angles(values: ComplexArray, out: FloatArray) -> None:
    for i in range(out.size):
        out[i] = _angle_of(values[i].real, values[i].imag)


@compiled
def _interpolated_angles(
    first: NDArray[np.int64], basis: FloatArray, real: FloatArray, imag: FloatArray, out: FloatArray
) -> None:
    """Interpolate each row from the eight sums of its panel, which start at ``first``, and take its angles.

    The sums of eight products are written out: they stay in registers, and the loops over x are vectorised.
    """
    n_x = out.shape[1]
    along, across = np.empty(n_x), np.empty(n_x)
    for row in range(len(out)):
        b = basis[row]
        for part, into in ((real, along), (imag, across)):
            p = part[first[row] : first[row] + 8]
            for i in range(n_x):
                left = b[0] * p[0, i] + b[1] * p[1, i] + b[2] * p[2, i] + b[3] * p[3, i]
                into[i] = left + (b[4] * p[4, i] + b[5] * p[5, i] + b[6] * p[6, i] + b[7] * p[7, i])
        for i in range(n_x):
            out[row, i] = _angle_of(along[i], across[i])
