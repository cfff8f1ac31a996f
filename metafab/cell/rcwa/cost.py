"""Cost of a solution: a measured curve over the number of orders, scaled by this machine's speed.

The curve holds the processor time of one truncation with both polarisations (normal incidence, absorbing pillar, one
thread), relative to five cosines. The speed is measured once a process, in some ten milliseconds.
"""

from __future__ import annotations

import math
import time
from functools import cache

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.certificate import ladder
from metafab.cell.rcwa.convergence import convergence
from metafab.cell.rcwa.jones import zero_order
from metafab.cell.rcwa.slicing import slicing
from metafab.cell.rcwa.symmetry import layers_of, polarisations_swap
from metafab.cell.response import CellNumerics

#: Cosines along each axis -> processor time over that of five cosines.
_CURVE = {3: 0.43, 4: 0.59, 5: 1.0, 6: 1.7, 7: 3.6, 8: 6.7, 9: 11.9, 10: 20.1, 12: 57.0, 14: 134.0}
_SAMPLE = PillarCell((350.0, 350.0), 150.0, 210.0, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)


def seconds_of_truncation(
    orders: int, cell: PillarCell = _SAMPLE, steps: int = 1, *, five_cosines_s: float | None = None
) -> float:
    """Processor time of one truncation of ``orders`` cosines (from 3), within a factor of two.

    Each symmetry class takes the curve's time at its number of unknowns, once for every layer. Each mirror plane that
    slanting light breaks doubles the unknowns. A sloped pillar counts both cuts, into ``steps`` and half as many.
    Beyond the curve the time grows as the sixth power of the orders, the third of the unknowns. ``five_cosines_s`` is
    the time of five cosines; by default it is measured on this machine.
    """
    unit_s = _seconds_of_five() if five_cosines_s is None else five_cosines_s
    broken = sum(k != 0.0 for k in cell.in_plane)
    unknowns = ((orders + 1) ** 2 + orders**2) * 2**broken
    # The number of cosines M at which light along z has this number (M + 1)^2 + M^2 of unknowns.
    equivalent = 0.5 * (math.sqrt(2.0 * unknowns - 1.0) - 1.0)
    most = max(_CURVE)
    within = float(np.interp(np.log(min(equivalent, most)), np.log(list(_CURVE)), np.log(list(_CURVE.values()))))
    of_classes = 0.5 if broken == 2 or polarisations_swap(cell) else 1.0
    layers = sum(each.height_nm > 0.0 for each in layers_of(cell, steps))
    if cell.is_sloped:
        layers += sum(each.height_nm > 0.0 for each in layers_of(cell, steps // 2))
    seconds = math.exp(within) * max(1.0, equivalent / most) ** 6 * unit_s
    return of_classes * max(1, layers) * seconds


def seconds_estimate(target_error: float, cell: PillarCell = _SAMPLE, *, five_cosines_s: float | None = None) -> float:
    """Processor time of one certified pillar like ``cell``.

    The first two truncations of the ladder serve most pillars; four are counted where the certificate has no measured
    claims, and nearly all where it follows a power law. The steps of a sloped pillar are chosen on ``cell`` itself, at
    a low truncation. Resonant pillars of a high index take up to five times as long. ``five_cosines_s`` is as in
    :func:`seconds_of_truncation`.
    """
    numerics = CellNumerics(target_error)
    steps = slicing(cell, numerics).steps
    falls = convergence(cell)
    rungs = ladder(numerics, falls)[: 9 if falls.law else 2 if falls.is_measured else 4]
    return sum(seconds_of_truncation(orders, cell, steps, five_cosines_s=five_cosines_s) for orders in rungs)


@cache
def _seconds_of_five() -> float:
    zero_order(_SAMPLE, 5)  # fills caches
    spent = []
    for _ in range(3):
        start = time.thread_time()
        zero_order(_SAMPLE, 5)
        spent.append(time.thread_time() - start)
    return min(spent)
