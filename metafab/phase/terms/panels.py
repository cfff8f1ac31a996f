"""The angle of a sum of separable waves on a grid of sites, several times faster than the sum itself.

Along y the waves are smooth, so the sum is taken at the Chebyshev points of panels only, and interpolated between
them. Panels are fixed on the pupil and not to the grid: a site's phase does not depend on the tile that asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.phase.terms.angle import angle_of

#: The interpolated sum differs from the sum by less than this part of the sum of the moduli of the waves' weights.
#: For n points it is 4 M rho^(1 - n) / (rho - 1) (Trefethen, Approximation Theory and Approximation Practice, theorem
#: 8.2), where M is the largest modulus on the ellipse of any rho > 1: 4.9e-8 for rho = 28, 8 points, and waves that
#: turn by at most half a radian per half panel and half panels of at most 1/64.
INTERPOLATION_ERROR = 5e-8

_POINTS = 8  # as many as _angles_of_rows writes out
_FEWEST_PANELS = 32  # on half the axis, [0, 1]


def angles_by_panels(
    weighted_x: ComplexArray, along_y: Callable[[FloatArray], ComplexArray], y: FloatArray, slope_rad: float
) -> FloatArray:
    """Angle of sum_k weighted_x[:, k] along_y(y)[:, k]: shape (n_y, n_x), rad in [-pi, pi].

    Args:
        weighted_x: shape (n_x, n), the waves along x times their weights.
        along_y: the waves, shape (m, n), at positions of shape (m,).
        y: shape (n_y,), in any order, within [-1, 1].
        slope_rad: how fast the phase of any wave turns along y at most, rad per unit of y.
    """
    panels = 2 ** math.ceil(math.log2(max(slope_rad, _FEWEST_PANELS)))
    panel = np.clip(np.floor(y * panels), -panels, panels - 1)
    found, which = np.unique(panel, return_inverse=True)
    points = np.cos((np.arange(_POINTS) + 0.5) * (np.pi / _POINTS))
    sums = along_y(((found[:, None] + 0.5 + 0.5 * points) / panels).ravel()) @ weighted_x.T
    basis = _lagrange(2.0 * (y * panels - panel) - 1.0, points)
    out = np.empty((y.size, len(weighted_x)))
    _angles_of_rows(which * _POINTS, basis, np.ascontiguousarray(sums.real), np.ascontiguousarray(sums.imag), out)
    return out


def _lagrange(position: FloatArray, points: FloatArray) -> FloatArray:
    """Polynomials that are 1 at one of the Chebyshev points and 0 at the others, shape (n_position, n_points)."""
    order = points.size - 1
    series = 2.0 / points.size * np.polynomial.chebyshev.chebvander(points, order)
    series[:, 0] *= 0.5
    return np.asarray(np.polynomial.chebyshev.chebvander(position, order) @ series.T)


@compiled
def _angles_of_rows(
    first: NDArray[np.int64], basis: FloatArray, real: FloatArray, imag: FloatArray, out: FloatArray
) -> None:
    """Interpolate each row from the sums at its panel's points, from the ``first`` on, and take its angles.

    Written out, the sums of eight products stay in registers and the loops over x are vectorised.
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
            out[row, i] = angle_of(along[i], across[i])
