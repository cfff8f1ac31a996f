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
from typing import Any

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
        wall_per_fill: d wall_fraction / d (size / period), as the pillar grows and the map follows.
    """

    period_nm: float
    size_nm: float
    wall_fraction: float
    slope_inside: float
    slope_outside: float
    wall_per_fill: float

    def cosine_integrals(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Integrals of dx/du cos(2 pi k u / period) over the pillar and over the whole period.

        Args:
            count: number of harmonics, k = 0 .. count - 1.

        Returns:
            Two arrays of shape (count,), each divided by the period: filling fraction and 1 at k = 0.
        """
        return self._integrals(count, self.size_nm / self.period_nm, self.wall_fraction)

    def cosine_integral_tangents(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Derivatives of :meth:`cosine_integrals` with respect to the pillar's size, per nm.

        By a complex step: the closed forms are analytic in the fill and the wall, so nothing cancels.
        """
        step = 1e-30
        fill = self.size_nm / self.period_nm + 1j * step
        wall = self.wall_fraction + 1j * step * self.wall_per_fill
        pillar, whole = self._integrals(count, fill, wall)
        return pillar.imag / (step * self.period_nm), whole.imag / (step * self.period_nm)

    def _integrals(self, count: int, fill: complex, wall: complex) -> tuple[Any, Any]:
        k = np.arange(count)
        inside = np.zeros(count) if wall == 0.0 else interval_integral(k, 0.0, wall, fill, 1.0 - self.slope_inside)
        if wall == 1.0:
            return inside, inside
        return inside, inside + interval_integral(k, wall, 1.0, 1.0 - fill, self.slope_outside - 1.0)


def interval_integral(
    k: Any, start: complex, end: complex, rise: complex, amplitude: float, upto: float | None = None
) -> Any:
    """Integral of m [1 + amplitude cos(pi (u - start) / l)] cos(pi k u), l = end - start, m = rise / l.

    From ``start`` to ``end``, or to ``upto`` on the way there.
    """
    length = end - start
    passed = length if upto is None else upto - start
    phase = math.pi * k * start

    # Mean over the interval of cos(pi k s + phase), s from its start: a shifted sinc, smooth at 0. The cosine in the
    # slope shifts k up and down.
    half = 0.5 * passed * np.stack([k, k + 1.0 / length, k - 1.0 / length])
    plain, up, down = np.sinc(half) * np.cos(math.pi * half + phase)
    return (rise if upto is None else rise * (passed / length)) * (plain + 0.5 * amplitude * (up + down))


def unstretched(period_nm: float, size_nm: float) -> AxisMap:
    """The identity map: plain Fourier harmonics."""
    return AxisMap(period_nm, size_nm, size_nm / period_nm, 1.0, 1.0, 1.0)


def stretched(period_nm: float, size_nm: float, orders: int) -> AxisMap:
    """The map tuned for ``orders`` cosines beside the constant; see the module's docstring.

    Walls at zero or at the period do not exist: those axes are left unstretched.
    """
    fill = size_nm / period_nm
    if fill <= 0.0 or fill >= 1.0:
        return unstretched(period_nm, size_nm)
    base, tilt, inside, outside = _TUNED[max(tuned for tuned in _TUNED if tuned <= max(orders, 2))]
    per_fill = tilt / 0.214
    return AxisMap(period_nm, size_nm, base + per_fill * (fill - 0.5), inside, outside, per_fill)


#: orders: (wall fraction at half filling, its change per 0.214 of filling, slope inside, slope outside). Slopes fall
#: towards zero as the basis grows; up to 9 orders they were tuned for the least of the largest errors over silicon
#: pillars on sapphire, and serve other materials as well (tests/physics/test_rcwa_certificate.py).
_TUNED = {
    2: (0.623, 0.002, 0.662, 0.576),
    3: (0.6235, 0.0022, 0.6615, 0.5758),
    4: (0.6169, 0.1046, 0.5964, 0.4002),
    5: (0.5863, 0.0952, 0.2265, 0.3546),
    6: (0.5791, 0.0849, 0.1131, 0.2245),
    7: (0.5695, 0.0681, 0.0730, 0.0900),
    8: (0.5237, 0.0596, 0.0086, 0.0332),
    9: (0.5258, 0.0800, 0.0159, 0.0410),
    10: (0.50, 0.10, 0.02, 0.02),
    14: (0.50, 0.10, 0.0, 0.0),
}
