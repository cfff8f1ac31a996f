"""The candidate at which the twins agree best in a window about each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import HAS_NUMBA, compiled, compiled_parallel, prange
from metafab.decode.matching.cost_volume import correlation
from metafab.decode.matching.pooling import window_means

#: Below this, a mean square is darkness.
_DARK = 1e-15


def peaks(parts: NDArray[np.float32], window: int) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Candidates of largest correlation over a square window; beyond an edge, the products are mirrored at it.

    Args:
        parts: shape (3, n, n_y, n_x), products a b, a^2 and b^2 of the aligned twins at n >= 3 candidates.
        window: side of the window, odd.

    Returns:
        The best candidate's number, shape (n_y, n_x); the correlation below, at and above it (of the nearest candidate
        that has both neighbours), shape (3, n_y, n_x); the largest mean of a b, shape (n_y, n_x).
    """
    reach = window // 2
    if not HAS_NUMBA or reach > min(parts.shape[-2:]):
        return _peaks_plain(parts, window)
    return _peaks(np.ascontiguousarray(parts), reach)


def _peaks_plain(
    parts: NDArray[np.float32], window: int
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    means = window_means(parts, window)
    agreement = correlation(means)
    best = agreement.argmax(axis=0)
    inner = np.clip(best, 1, parts.shape[1] - 2)
    around = np.stack([np.take_along_axis(agreement, (inner + d)[None], axis=0)[0] for d in (-1, 0, 1)])
    return best, around, means[0].max(axis=0)


@compiled
def mirrored(index: int, count: int) -> int:
    """The place in a line of pixels, mirrored at both ends, of one that may lie beyond them."""
    return -index - 1 if index < 0 else (2 * count - 1 - index if index >= count else index)


@compiled
def _window_row(
    pictures: NDArray[np.float32], row: int, reach: int, down: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """Means of a picture (n_y, n_x) over the windows about one row's pixels; ``down`` is n_x + 2 reach long."""
    n_y, n_x = pictures.shape
    middle = down[reach : reach + n_x]
    middle[:] = np.float32(0.0)
    for i in range(row - reach, row + reach + 1):
        line = pictures[mirrored(i, n_y)]
        for j in range(n_x):
            middle[j] += line[j]
    for j in range(reach):
        down[reach - 1 - j] = middle[j]
        down[reach + n_x + j] = middle[n_x - 1 - j]
    total = 0.0
    for j in range(2 * reach):
        total += down[j]
    share = 1.0 / (2 * reach + 1) ** 2
    for j in range(n_x):
        total += down[j + 2 * reach]
        out[j] = np.float32(total * share)
        total -= down[j]


@compiled_parallel
def _peaks(parts: NDArray[np.float32], reach: int) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    _, count, n_y, n_x = parts.shape
    best = np.zeros((n_y, n_x), dtype=np.intp)
    around = np.empty((3, n_y, n_x), dtype=np.float32)
    common = np.empty((n_y, n_x), dtype=np.float32)
    for i in prange(n_y):
        down = np.empty(n_x + 2 * reach, dtype=np.float32)
        means = np.empty((3, n_x), dtype=np.float32)
        rho = np.empty((count, n_x), dtype=np.float32)
        for v in range(count):
            for p in range(3):
                _window_row(parts[p, v], i, reach, down, means[p])
            for j in range(n_x):
                norm = np.sqrt(max(means[1, j], np.float32(0.0))) * np.sqrt(max(means[2, j], np.float32(0.0)))
                rho[v, j] = means[0, j] / max(norm, np.float32(_DARK))
                common[i, j] = max(means[0, j], common[i, j]) if v > 0 else means[0, j]
                if rho[v, j] > rho[best[i, j], j]:
                    best[i, j] = v
        for j in range(n_x):
            inner = min(max(best[i, j], 1), count - 2)
            for d in range(3):
                around[d, i, j] = rho[inner - 1 + d, j]
    return best, around, common
