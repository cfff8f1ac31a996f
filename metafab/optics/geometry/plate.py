"""The substrate as a plane-parallel plate between scene and pillars, which refracts the light of every object point.

A ray from an object at depth z and lateral offset z t to the lens point p leaves the object at an angle of tangent u
and crosses the plate of thickness h and index n by Snell's law:

    u (1 - w h) + w h u / q(u) = |t - w p|,   q(u) = sqrt(n^2 + (n^2 - 1) u^2),   w = 1 / z.

The gradient of the path over p is minus the sine of the ray along t - w p. The plate adds the integral of this gradient
from the centre to p, minus the integral in air. No large lengths are subtracted, and w = 0, an infinite depth, is
regular: the plate then adds nothing. Reflections at the faces of the plate are neglected.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from metafab.core.conventions import FloatArray

#: Gauss-Legendre nodes from the centre to a lens point. On 40 000 random rays they were off by at most 2e-9 um for
#: objects that appear farther than 1.7 aperture radii, and by 1e-6 um for those at 0.9 of them.
_NODES = 8
#: Newton steps from below. Each doubles the digits, and the start has two.
_NEWTON_STEPS = 5


@dataclass(frozen=True, kw_only=True)
class Plate:
    """Plane-parallel plate before the lens."""

    thickness_um: float  #: Thickness, at most the object depth.
    index: float  #: Real refractive index.

    def path_change_um(self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]) -> FloatArray:
        """Return the change by the plate of the path over (x, y) minus the path over the centre; broadcasts."""
        nodes, weights = _gauss_legendre()
        total = 0.0
        for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
            along_x, along_y = self.slope_change(node * x_um, node * y_um, vergence_per_um, tangent)
            total = total + weight * (along_x * x_um + along_y * y_um)
        return np.asarray(total)

    def slope_change(
        self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of :meth:`path_change_um` along x and y; broadcasts."""
        t_x, t_y = tangent[0] - vergence_per_um * x_um, tangent[1] - vergence_per_um * y_um
        square = np.asarray(t_x * t_x + t_y * t_y, dtype=np.float64)
        ratio, tangent2 = self._refracted(square, vergence_per_um)
        # Sine of the ray over the tangent of the straight ray, with and without the plate.
        change = ratio / np.sqrt(1.0 + tangent2) - 1.0 / np.sqrt(1.0 + square)
        return -change * t_x, -change * t_y

    def direction_cosines(
        self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the direction cosines along x and y, in the air, of the ray that reaches (x, y); broadcasts."""
        t_x, t_y = tangent[0] - vergence_per_um * x_um, tangent[1] - vergence_per_um * y_um
        ratio, tangent2 = self._refracted(np.asarray(t_x * t_x + t_y * t_y, dtype=np.float64), vergence_per_um)
        sine = -ratio / np.sqrt(1.0 + tangent2)
        return sine * t_x, sine * t_y

    def amplitude_ratio(self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]) -> FloatArray:
        """Return the incident amplitude with the plate over the amplitude in air, 1 at the centre; broadcasts."""
        t_x, t_y = tangent[0] - vergence_per_um * x_um, tangent[1] - vergence_per_um * y_um
        here = self._spread(np.asarray(t_x * t_x + t_y * t_y), vergence_per_um)
        centre = self._spread(np.asarray(tangent[0] ** 2 + tangent[1] ** 2), vergence_per_um)
        return np.asarray(np.sqrt(here / centre))

    def _spread(self, square: FloatArray, vergence_per_um: float) -> FloatArray:
        """Flux u du / (1 + u^2)^(3/2) through rho d rho, over rho = u without a plate."""
        ratio, tangent2 = self._refracted(square, vergence_per_um)
        share = vergence_per_um * self.thickness_um
        n2 = self.index**2
        growth = 1.0 - share + share * n2 / (n2 + (n2 - 1.0) * tangent2) ** 1.5
        return np.asarray(ratio / growth * ((1.0 + square) / (1.0 + tangent2)) ** 1.5)

    def _refracted(self, square: FloatArray, vergence_per_um: float) -> tuple[FloatArray, FloatArray]:
        """Ratio u / rho, and u^2, for rho^2 = ``square``; rho is the tangent of the straight line to the object."""
        share, n2 = vergence_per_um * self.thickness_um, self.index**2
        # The left side is concave in u and below rho at the start, so that the Newton steps only rise.
        ratio = np.full(square.shape, 1.0 / (1.0 - share + share / self.index))
        for _ in range(_NEWTON_STEPS):
            tangent2 = ratio * ratio * square
            inverse = 1.0 / np.sqrt(n2 + (n2 - 1.0) * tangent2)
            reached = ratio * (1.0 - share + share * inverse)
            ratio = ratio + (1.0 - reached) / (1.0 - share + share * n2 * inverse**3)
        return ratio, ratio * ratio * square


@cache
def _gauss_legendre() -> tuple[FloatArray, FloatArray]:
    """Nodes and weights on 0 to 1."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * (1.0 + node), 0.5 * weight


def focus_shift_um(plate: Plate) -> float:
    """Return the apparent approach of an object on the axis, h (1 - 1/n)."""
    return plate.thickness_um * (1.0 - 1.0 / plate.index)
