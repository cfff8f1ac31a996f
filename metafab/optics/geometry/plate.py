"""A plane-parallel plate between scene and pillars: the substrate, which refracts the light of every object point.

A ray from an object at depth z and offset z t (seen from the pillars) to the lens point p leaves the object at an angle
of tangent u and crosses the plate of thickness h and index n by Snell's law:

    u (1 - w h) + w h u / q(u) = |t - w p|,   q(u) = sqrt(n^2 + (n^2 - 1) u^2),   w = 1 / z.

The path's gradient over p is minus the ray's sine along t - w p. Its integral from the centre to p, less that in air,
is what the plate adds to the path: no large lengths are subtracted, and w = 0, an infinite depth, is nothing special
(the plate then adds nothing). Reflection at the plate's faces is not in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from metafab.core.conventions import FloatArray

#: Of the integral from the centre to a lens point: exact to 1e-12 for objects beyond the aperture's radius.
_NODES = 8
#: Newton's steps from below; each doubles the digits, of which two are there at first.
_NEWTON_STEPS = 5


@dataclass(frozen=True)
class Plate:
    """The plate: its thickness and index.

    Attributes:
        thickness_um: up to the object's depth.
        index: refractive index, real.
    """

    thickness_um: float
    index: float

    def path_change_um(self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]) -> FloatArray:
        """What the plate adds to the path over the lens point (x, y) minus that over the centre; broadcasts."""
        nodes, weights = _gauss_legendre()
        total = 0.0
        for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
            along_x, along_y = self.slope_change(node * x_um, node * y_um, vergence_per_um, tangent)
            total = total + weight * (along_x * x_um + along_y * y_um)
        return np.asarray(total)

    def slope_change(
        self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of :meth:`path_change_um` along x and y."""
        t_x, t_y = tangent[0] - vergence_per_um * x_um, tangent[1] - vergence_per_um * y_um
        square = np.asarray(t_x * t_x + t_y * t_y, dtype=np.float64)
        ratio, tangent2 = self._refracted(square, vergence_per_um)
        # Sines of the ray over the tangent of the straight one, with and without the plate.
        change = ratio / np.sqrt(1.0 + tangent2) - 1.0 / np.sqrt(1.0 + square)
        return -change * t_x, -change * t_y

    def amplitude_ratio(self, x_um: Any, y_um: Any, vergence_per_um: float, tangent: tuple[float, float]) -> FloatArray:
        """Incident amplitude with the plate over that without, 1 at the centre: rays are spread otherwise."""
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
        """Ratio u / rho, and u^2, for rho^2 = ``square``, rho being the tangent of the straight line to the object."""
        share, n2 = vergence_per_um * self.thickness_um, self.index**2
        # A concave function of u that is below rho at the start: the steps only rise.
        ratio = np.full(square.shape, 1.0 / (1.0 - share + share / self.index))
        for _ in range(_NEWTON_STEPS):
            tangent2 = ratio * ratio * square
            inverse = 1.0 / np.sqrt(n2 + (n2 - 1.0) * tangent2)
            reached = ratio * (1.0 - share + share * inverse)
            ratio = ratio + (1.0 - reached) / (1.0 - share + share * n2 * inverse**3)
        return ratio, ratio * ratio * square


@cache
def _gauss_legendre() -> tuple[FloatArray, FloatArray]:
    """On 0 to 1."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * (1.0 + node), 0.5 * weight


def focus_shift_um(plate: Plate) -> float:
    """How much nearer an object seems on the axis: h (1 - 1/n)."""
    return plate.thickness_um * (1.0 - 1.0 / plate.index)


def lateral_shift_um(plate: Plate, angle_deg: float) -> float:
    """How far the plate displaces a ray along its face: h (tan a - tan b), sin a = n sin b."""
    angle = math.radians(angle_deg)
    inside = math.asin(math.sin(angle) / plate.index)
    return plate.thickness_um * (math.tan(angle) - math.tan(inside))
