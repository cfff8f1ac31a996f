"""Semi-global matching: costs of the levels of all pixels, plus prices of changes from pixel to pixel.

Costs are summed along eight directions, with a price for each change of level that does not rise for jumps beyond two
levels (Hirschmueller, IEEE Trans. Pattern Anal. Mach. Intell. 30, 328, 2008).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled, inlined
from metafab.core.parallel.executor import spread


def summed_costs(cost: NDArray[np.float32], change: float, jump: float | NDArray[np.float32]) -> NDArray[np.float32]:
    """Least cost of each pixel's levels along paths to it from all sides: shape (n_y, n_x, n_levels).

    The cheapest level of each pixel is that of the surface.

    Args:
        cost: shape (n_y, n_x, n_levels), cost of each level.
        change: price of a change by one level from a pixel to the next, in the unit of the costs.
        jump: largest price of a change: one for all, or from each pixel to the next one along y and along x, shape
            (2, n_y, n_x). A diagonal step has the lesser one of its two parts.
    """
    totals = np.zeros((2, *cost.shape), dtype=np.float32)
    jumps = np.ascontiguousarray(np.broadcast_to(jump, (2, *cost.shape[:2])), dtype=np.float32)
    spread(_sweeps, 2, np.ascontiguousarray(cost, dtype=np.float32), np.float32(change), jumps, totals)
    return np.asarray(totals.sum(axis=0))


@inlined
def _add_path(
    cost: NDArray[np.float32],
    before: NDArray[np.float32],
    change: np.float32,
    jump: np.float32,
    path: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Continue a path by a pixel, of ``cost`` (n_levels,), and add it to ``total``; zeros ``before`` begin one."""
    count = cost.size
    least = before.min()
    for k in range(count):
        best = min(before[k], least + jump)
        if k > 0:
            best = min(best, before[k - 1] + change)
        if k > 1:
            best = min(best, before[k - 2] + np.float32(2.0) * change)
        if k < count - 1:
            best = min(best, before[k + 1] + change)
        if k < count - 2:
            best = min(best, before[k + 2] + np.float32(2.0) * change)
        path[k] = cost[k] + best - least
        total[k] += path[k]


@compiled
def _sweeps(
    first: int,
    stop: int,
    cost: NDArray[np.float32],
    change: np.float32,
    jumps: NDArray[np.float32],
    totals: NDArray[np.float32],
) -> None:
    """Sum costs (n_y, n_x, n_levels) along four directions in each sweep, from the first and from the last pixel."""
    n_y, n_x, count = cost.shape
    for sweep in range(first, stop):
        # Paths from the left, and of the last row from the upper left, above and the upper right; a margin begins them.
        last = np.zeros((3, n_x + 2, count), dtype=np.float32)
        for row in range(n_y):
            i = row if sweep == 0 else n_y - 1 - row
            down = jumps[0, max(i - 1, 0) if sweep == 0 else i]
            here = np.zeros((3, n_x + 2, count), dtype=np.float32)
            beside = np.zeros((2, count), dtype=np.float32)
            for column in range(n_x):
                j = column if sweep == 0 else n_x - 1 - column
                left, right = jumps[1, i, max(j - 1, 0)], jumps[1, i, j]
                behind, ahead = (left, right) if sweep == 0 else (right, left)
                one, total = cost[i, j], totals[sweep, i, j]
                _add_path(one, beside[column % 2], change, behind, beside[1 - column % 2], total)
                for way in range(3):
                    jump = min(down[j], behind) if way == 0 else down[j] if way == 1 else min(down[j], ahead)
                    _add_path(one, last[way, column + way], change, jump, here[way, column + 1], total)
            last = here
