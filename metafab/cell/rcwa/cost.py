"""What a solution costs: a measured curve over the number of orders, scaled by this machine's speed.

The curve holds the processor time of one truncation with both polarisations (normal incidence, absorbing pillar, one
thread), relative to five cosines. The speed is measured once a process, in some ten milliseconds.
"""

from __future__ import annotations

import time
from functools import cache

import numpy as np

from metafab.cell.rcwa.certificate import climb
from metafab.cell.rcwa.jones import zero_order
from metafab.cell.response import CellNumerics, PillarCell

#: Cosines along the period: seconds over those of five.
_CURVE = {3: 0.43, 4: 0.59, 5: 1.0, 6: 1.7, 7: 3.6, 8: 6.7, 9: 11.9, 10: 20.1, 12: 57.0, 14: 134.0}
_SAMPLE = PillarCell((350.0, 350.0), 150.0, 210.0, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)


def seconds_of_truncation(orders: int) -> float:
    """Processor time of one truncation of ``orders`` cosines (from 3) on this machine, within a factor of two.

    For a square period and light along z; a square pillar takes half. Beyond the curve the time grows as the sixth
    power of the orders, the third of the unknowns.
    """
    most = max(_CURVE)
    within = float(np.interp(np.log(min(orders, most)), np.log(list(_CURVE)), np.log(list(_CURVE.values()))))
    return float(np.exp(within) * max(1.0, orders / most) ** 6 * _seconds_of_five())


def seconds_estimate(target_error: float) -> float:
    """Processor time of one certified pillar: the first two truncations of its climb, which serve most pillars."""
    return sum(seconds_of_truncation(orders) for orders in climb(CellNumerics(target_error))[:2])


@cache
def _seconds_of_five() -> float:
    zero_order(_SAMPLE, 5)  # Fills caches.
    spent = []
    for _ in range(3):
        start = time.thread_time()
        zero_order(_SAMPLE, 5)
        spent.append(time.thread_time() - start)
    return min(spent)
