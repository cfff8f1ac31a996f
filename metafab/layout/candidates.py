"""Which sizes a site may fall back on where its neighbours leave no room for the best one.

For a pair of target phases the best size of all is listed first, then the best of those that are narrower or
shorter, and so on down to sizes that fit beside the largest pillar.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import default_workers
from metafab.layout.pillars import SizeIndexArray
from metafab.library import SizeTable

# Lists are kept for CELLS x CELLS pairs of phases, steps of 0.025 rad, and made of the best sizes within LIMITS
# x LIMITS limits of width and length.
_CELLS = 256
_LIMITS = 9
_LONGEST = 16
_CELLS_AT_ONCE = 256


def candidates(table: SizeTable, period_dbu: tuple[int, int], min_gap_dbu: float) -> SizeIndexArray:
    """The distinct best sizes within all pairs of limits "width up to a, length up to b".

    Args:
        table: all sizes; its look-up is not used.
        period_dbu: (x, y) pitch.
        min_gap_dbu: smallest gap.

    Returns:
        Shape (256, 256, 16), indexed [phi_y, phi_x]: sizes in order of falling overlap; 0 ends a list.
    """
    u = np.concatenate([table.t.real, table.t.imag], axis=1)[1:]
    rung_x, rung_y = (_rung(table.size_dbu[1:, axis], period_dbu[axis], min_gap_dbu) for axis in (0, 1))
    box = rung_x * _LIMITS + rung_y
    # Sizes box by box, so that each box is a slice.
    order = np.argsort(box, kind="stable")
    ends = np.searchsorted(box[order], np.arange(_LIMITS**2 + 1))
    phase = 2.0 * np.pi * np.arange(_CELLS) / _CELLS
    phase_y, phase_x = (axis.ravel() for axis in np.meshgrid(phase, phase, indexing="ij"))
    wanted = np.stack([np.cos(phase_x), np.cos(phase_y), np.sin(phase_x), np.sin(phase_y)], axis=1)

    def of_cells(first: int) -> SizeIndexArray:
        """The lists of some of the cells."""
        overlap = wanted[first : first + _CELLS_AT_ONCE] @ u[order].T
        best = np.full((len(overlap), _LIMITS**2), -np.inf)
        size = np.zeros(best.shape, dtype=np.uint16)
        for k in range(_LIMITS**2):
            if ends[k] < ends[k + 1]:
                found = ends[k] + overlap[:, ends[k] : ends[k + 1]].argmax(axis=1)
                size[:, k] = order[found] + 1
                best[:, k] = overlap[np.arange(len(overlap)), found]
        return _lists(best, size)

    with ThreadPoolExecutor(default_workers()) as threads:
        lists = list(threads.map(of_cells, range(0, _CELLS**2, _CELLS_AT_ONCE)))
    return np.concatenate(lists).reshape(_CELLS, _CELLS, _LONGEST)


def _rung(size_dbu: NDArray[np.int32], period_dbu: int, min_gap_dbu: float) -> NDArray[np.int64]:
    """The first limit that holds each size: limits rise evenly from the room beside the largest size to that size."""
    largest = float(size_dbu.max())
    return np.searchsorted(np.linspace(2.0 * (period_dbu - min_gap_dbu) - largest, largest, _LIMITS) + 1e-6, size_dbu)


def _lists(best: FloatArray, size: SizeIndexArray) -> SizeIndexArray:
    """From the best size between neighbouring limits, shape (n, limits^2), to the best up to each, in order."""
    n = len(best)
    best, size = best.reshape(n, _LIMITS, _LIMITS), size.reshape(n, _LIMITS, _LIMITS)
    for axis in (1, 2):
        for k in range(1, _LIMITS):
            here, before = ((slice(None),) * axis + (index,) for index in (k, k - 1))
            smaller = best[here] < best[before]
            best[here] = np.where(smaller, best[before], best[here])
            size[here] = np.where(smaller, size[before], size[here])
    best, size = best.reshape(n, -1), size.reshape(n, -1)
    size = np.take_along_axis(size, np.lexsort((size, -best), axis=1), axis=1)
    size[:, 1:][size[:, 1:] == size[:, :-1]] = 0
    filled_first = np.argsort(size == 0, axis=1, kind="stable")[:, :_LONGEST]
    return np.ascontiguousarray(np.take_along_axis(size, filled_first, axis=1))
