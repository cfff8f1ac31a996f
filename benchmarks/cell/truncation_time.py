"""Processor time of one truncation of RCWA, by a measured curve: what a drawn cell's answer or reference may take."""

from __future__ import annotations

import math

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.symmetry import layers_of, polarisations_swap

#: Cosines along each axis -> processor time over that of five cosines (both polarisations, normal incidence, absorbing
#: pillar, one thread).
_CURVE = {3: 0.43, 4: 0.59, 5: 1.0, 6: 1.7, 7: 3.6, 8: 6.7, 9: 11.9, 10: 20.1, 12: 57.0, 14: 134.0}


def seconds_of_truncation(orders: int, cell: PillarCell, steps: int, *, five_cosines_s: float) -> float:
    """Processor time of one truncation of ``orders`` cosines (from 3), within a factor of two.

    Each symmetry class takes the curve's time at its number of unknowns, once for every layer. Each mirror plane that
    slanting light breaks doubles the unknowns. A sloped pillar counts both cuts, into ``steps`` and half as many.
    Beyond the curve the time grows as the sixth power of the orders, the third of the unknowns.
    """
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
    seconds = math.exp(within) * max(1.0, equivalent / most) ** 6 * five_cosines_s
    return of_classes * max(1, layers) * seconds
