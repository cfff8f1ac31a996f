"""The coordinate map x(u) that gathers resolution at a pillar's walls, and its integrals in closed form.

Half a period, 0 <= x <= h, is split at the wall x = a into two intervals. In each, with its own fraction s of
the parameter range and its own wall slope eta (in units of the interval's mean slope m),

    dx/du = m [1 + (1 - eta) cos(pi (u - u0) / l)],      inside: u0 = 0, slope eta m at the far end,
    dx/du = m [1 - (1 - eta) cos(pi (u - u0) / l)],      outside: u0 = wall, slope eta m at the near end,

so that a slope below one packs basis functions against the wall from either side. The map goes back to Granet,
J. Opt. Soc. Am. A 16, 2510 (1999), and Vallius and Honkanen, Opt. Express 10, 24 (2002); the choice of a free
slope on either side, and of the wall's place, is tuned here to the number of orders.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class AxisMap:
    """The map of one axis of the unit cell.

    Attributes:
        period_nm: period along the axis.
        size_nm: pillar size along the axis, 0 to the period.
        wall_fraction: u at the wall over half the period; 0 < wall_fraction < 1 where the wall exists.
        slope_inside: dx/du at the wall on the pillar's side, over the mean slope inside; 0 < slope <= 1.
        slope_outside: the same on the other side.
    """

    period_nm: float
    size_nm: float
    wall_fraction: float
    slope_inside: float
    slope_outside: float

    def cosine_integrals(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Integrals of dx/du cos(2 pi k u / period) over the pillar and over the whole period.

        Args:
            count: number of harmonics, k = 0 .. count - 1.

        Returns:
            Two arrays of shape (count,), each divided by the period: filling fraction and 1 at k = 0.
        """
        fill, wall = self.size_nm / self.period_nm, self.wall_fraction
        k = np.arange(count)
        inside = np.zeros(count) if wall <= 0.0 else _interval(k, 0.0, wall, fill, 1.0 - self.slope_inside)
        if wall >= 1.0:
            return inside, inside
        return inside, inside + _interval(k, wall, 1.0, 1.0 - fill, self.slope_outside - 1.0)


def _interval(k: np.ndarray, start: float, end: float, rise: float, amplitude: float) -> FloatArray:
    """Integral of m [1 + amplitude cos(pi (u - start) / l)] cos(pi k u), l = end - start, m = rise / l."""
    length = end - start

    def mean(harmonic: FloatArray, phase: FloatArray) -> FloatArray:
        # Mean over the interval of cos(pi harmonic s + phase), s from its start: a shifted sinc, smooth at 0.
        half = 0.5 * harmonic * length
        return np.asarray(np.sinc(half) * np.cos(math.pi * half + phase))

    phase = math.pi * k * start
    plain = mean(k, phase)
    crossed = 0.5 * (mean(k + 1.0 / length, phase) + mean(k - 1.0 / length, phase))
    return np.asarray(rise * (plain + amplitude * crossed), dtype=np.float64)


def unstretched(period_nm: float, size_nm: float) -> AxisMap:
    """The identity map: plain Fourier harmonics."""
    return AxisMap(period_nm, size_nm, size_nm / period_nm, 1.0, 1.0)


def stretched(period_nm: float, size_nm: float, orders: int) -> AxisMap:
    """The map tuned for ``orders`` cosines beside the constant; see the module's docstring.

    Walls at zero or at the period do not exist: those axes are left unstretched.
    """
    fill = size_nm / period_nm
    if fill <= 0.0 or fill >= 1.0:
        return unstretched(period_nm, size_nm)
    base, tilt, inside, outside = _TUNED[min(max(orders, min(_TUNED)), max(_TUNED))]
    return AxisMap(period_nm, size_nm, base + tilt * (fill - 0.5) / 0.214, inside, outside)


#: orders: (wall fraction at half filling, its change per 0.214 of filling, slope inside, slope outside)
_TUNED = {4: (0.640, 0.041, 0.323, 0.511), 5: (0.583, 0.077, 0.249, 0.355), 6: (0.556, 0.104, 0.144, 0.246)}
