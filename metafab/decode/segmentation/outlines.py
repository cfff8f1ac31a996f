"""Outlines of layers: as short as the twins let them be.

Beside another depth the pair mixes both over its own width, and pixels that are shared out one by one have ragged
outlines. Here the share of each layer in a window about a pixel is added to what speaks for the layer there, the
largest sum takes the pixel, and so on: threshold dynamics, which shorten outlines until what speaks against it holds
them (Merriman, Bence and Osher, J. Comput. Phys. 112, 334, 1994; for several layers with weights Esedoglu and Otto,
Comm. Pure Appl. Math. 68, 808, 2015).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import HAS_NUMBA, compiled_parallel, prange
from metafab.decode.matching.peaks import mirrored
from metafab.decode.matching.pooling import window_means

#: Outlines hardly move any more after so many rounds.
_ROUNDS = 4


def settled(
    layer: NDArray[np.intp], scores: NDArray[np.float32], counted: NDArray[np.bool_], window: int
) -> NDArray[np.intp]:
    """The layer of each pixel, with outlines as short as the scores let them be.

    Args:
        layer: shape (n_y, n_x), from 0, to begin with.
        scores: shape (n_layers, n_y, n_x), what speaks for each layer at each pixel; -inf where it may not be. An
            outline moves over a pixel whose scores differ by less than the layers' shares of the window about it.
        counted: shape (n_y, n_x), pixels that have a layer: others have no share.
        window: side of the window, odd.
    """
    if scores.shape[0] == 1:
        return layer
    shared_out = _shared_out if HAS_NUMBA and window // 2 <= min(layer.shape) else _shared_out_plain
    for _ in range(_ROUNDS):
        before, layer = layer, shared_out(layer, scores, counted, window // 2)
        if not ((before != layer) & counted).any():
            break
    return layer


def _shared_out_plain(
    layer: NDArray[np.intp], scores: NDArray[np.float32], counted: NDArray[np.bool_], reach: int
) -> NDArray[np.intp]:
    """The layer of the largest sum of score and share of the window about each pixel, mirrored at the edges."""
    numbers = np.arange(scores.shape[0])[:, None, None]
    shares = window_means(((layer == numbers) & counted).astype(np.float32), 2 * reach + 1)
    return np.asarray((shares + scores).argmax(axis=0))


@compiled_parallel
def _shared_out(
    layer: NDArray[np.intp], scores: NDArray[np.float32], counted: NDArray[np.bool_], reach: int
) -> NDArray[np.intp]:
    count, n_y, n_x = scores.shape
    found = np.empty((n_y, n_x), dtype=np.intp)
    share = np.float32(1.0 / (2 * reach + 1) ** 2)
    for i in prange(n_y):
        # Pixels of each layer in the window's columns, those beyond the edges included; and in the window.
        columns = np.zeros((count, n_x + 2 * reach), dtype=np.int32)
        inside = np.zeros(count, dtype=np.int32)
        for m in range(i - reach, i + reach + 1):
            row = mirrored(m, n_y)
            for j in range(n_x):
                if counted[row, j]:
                    columns[layer[row, j], reach + j] += 1
        for k in range(count):
            for j in range(reach):
                columns[k, reach - 1 - j] = columns[k, reach + j]
                columns[k, reach + n_x + j] = columns[k, reach + n_x - 1 - j]
            for j in range(2 * reach):
                inside[k] += columns[k, j]
        for j in range(n_x):
            best, largest = 0, np.float32(-np.inf)
            for k in range(count):
                inside[k] += columns[k, j + 2 * reach]
                total = share * np.float32(inside[k]) + scores[k, i, j]
                if total > largest:
                    best, largest = k, total
                inside[k] -= columns[k, j]
            found[i, j] = best
    return found
