"""One coordinate map for several outlines along an axis: the slices of a sloped pillar, a cap of another size.

Half a period, 0 <= x <= h, is split into three intervals: inside the smallest outline, the zone in which walls stand,
and outside the largest. The zone has one slope dx/du, which the other two reach at its edges as in
:mod:`metafab.cell.rcwa.basis.coordinates`; it takes a share of the parameter range that follows from how wide it is.
Where
all outlines are the same the map is the tuned one of a single wall.

The overlap of each outline is an integral over part of the range of u, known in closed form once the place of its wall
is; that is the root of a monotone x(u).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metafab.cell.rcwa.basis.axis import AxisBasis, Formulation, IntArray, axis_basis, bases_over
from metafab.cell.rcwa.basis.coordinates import interval_integral, stretched
from metafab.core.conventions import FloatArray

#: Share of either side's parameter range that a zone takes, over the square root of its width (in half periods).
#: On sloped silicon pillars with walls 0.02, 0.08 and 0.16 apart, at 5 to 8 orders, the best share was measured within
#: a factor of two of this one.
_ZONE_SHARE, _WIDEST_ZONE = 0.85, 0.5


@dataclass(frozen=True)
class Interval:
    """Part of half a period, in units of it: dx/du = m [1 + amplitude cos(pi (u - start) / l)], x rises by ``rise``."""

    start: float
    end: float
    rise: float
    amplitude: float

    def x(self, u: float) -> float:
        """How far x has risen at ``u``."""
        passed = (u - self.start) / (self.end - self.start)
        return self.rise * (passed + self.amplitude * float(np.sin(np.pi * passed)) / np.pi)

    def u(self, x: float) -> float:
        """Where x has risen that far, 0 < x < ``rise``."""
        from scipy.optimize import brentq  # A fifth of a second, which workers that solve upright pillars do not spend.

        return float(brentq(lambda u: self.x(u) - x, self.start, self.end, xtol=1e-15, rtol=1e-15))


def outline_bases(
    period_nm: float, sizes_nm: tuple[float, ...], orders: int, formulation: Formulation
) -> tuple[AxisBasis, ...]:
    """The basis of one axis with the overlap of each outline, ``orders`` = M cosines beside the constant.

    Args:
        period_nm: period along the axis.
        sizes_nm: size of each outline along the axis, 0 to the period; equal ones share one basis.
        orders: M.
        formulation: whether x(u) gathers resolution at the walls.
    """
    distinct = tuple(sorted(set(sizes_nm)))
    shared: tuple[AxisBasis, ...]
    if len(distinct) == 1:
        shared = (axis_basis(period_nm, distinct[0], orders, formulation),)
    else:
        shared = _shared(period_nm, distinct, orders, formulation)
    return tuple(shared[distinct.index(size)] for size in sizes_nm)


@lru_cache(maxsize=256)
def _shared(
    period_nm: float, sizes_nm: tuple[float, ...], orders: int, formulation: Formulation
) -> tuple[AxisBasis, ...]:
    fills = [size / period_nm for size in sizes_nm]
    walls = [fill for fill in fills if 0.0 < fill < 1.0]
    intervals = [Interval(0.0, 1.0, 1.0, 0.0)]
    if walls and formulation == "adaptive":
        intervals = _intervals(period_nm, walls[0], walls[-1], orders)
    k = np.arange(2 * orders + 1)
    whole = _integrals(intervals, k, 1.0)
    return tuple(bases_over(period_nm, whole, [_integrals(intervals, k, fill) for fill in fills], orders))


def _intervals(period_nm: float, smallest: float, largest: float, orders: int) -> list[Interval]:
    tuned = stretched(period_nm, 0.5 * (smallest + largest) * period_nm, orders)
    spread = largest - smallest
    zone = min(_ZONE_SHARE * math.sqrt(spread), _WIDEST_ZONE)
    begin, end = tuned.wall_fraction * (1.0 - zone), 1.0 - (1.0 - tuned.wall_fraction) * (1.0 - zone)
    slope = spread / (end - begin) if zone else 0.0
    slope_in = min(1.0, max(tuned.slope_inside, slope * begin / smallest))
    slope_out = min(1.0, max(tuned.slope_outside, slope * (1.0 - end) / (1.0 - largest)))
    inside = Interval(0.0, begin, smallest, 1.0 - slope_in)
    outside = Interval(end, 1.0, 1.0 - largest, slope_out - 1.0)
    return [inside, Interval(begin, end, spread, 0.0), outside] if zone else [inside, outside]


def _integrals(intervals: list[Interval], k: IntArray, fill: float) -> FloatArray:
    """Integrals of dx/du cos(pi k u) from 0 to where x = ``fill``, u and x over half a period."""
    total, left = np.zeros(k.size), fill
    for part in intervals:
        if left >= part.rise * (1.0 - 1e-14):
            total = total + interval_integral(k, part.start, part.end, part.rise, part.amplitude)
            left -= part.rise
        elif left > 1e-14:
            upto = part.u(left)
            total = total + interval_integral(k, part.start, part.end, part.rise, part.amplitude, upto)
            left = 0.0
    return total
