"""Refinement of the outlines of layers by threshold dynamics.

Where the depth changes, the PSFs blur both depths into each other over their own width: outlines of pixels that are
assigned one by one are ragged. Each round adds to the score of each layer at a pixel its share of the window about the
pixel, and assigns the pixel to the layer of the largest sum. Rounds shorten outlines until the scores hold them
(Merriman, Bence and Osher, J. Comput. Phys. 112, 334, 1994; for several layers with weights Esedoglu and Otto, Comm.
Pure Appl. Math. 68, 808, 2015).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.matching.pooling import mirrored

#: Outlines hardly move any more after this many rounds.
ROUNDS = 4


def refined_outlines(
    layer: NDArray[np.intp], scores: NDArray[np.float32], counted: NDArray[np.bool_], window: int, rounds: int = ROUNDS
) -> NDArray[np.intp]:
    """Assign pixels to layers with outlines as short as the scores allow.

    Args:
        layer: shape (n_y, n_x), initial layer of each pixel, from 0.
        scores: shape (n_layers, n_y, n_x), score of each layer at each pixel; -inf where it is not allowed. A pixel
            changes its layer if the scores there differ by less than the layers' shares of the window around it.
        counted: shape (n_y, n_x), pixels that count in the shares.
        window: side of the window, odd.
        rounds: most rounds; 0 leaves the outlines as they are.

    Returns:
        Layer of each pixel, shape (n_y, n_x).
    """
    if scores.shape[0] == 1:
        return layer
    for _ in range(rounds):
        before, layer = layer, np.empty_like(layer)
        spread(_threshold_round, layer.shape[0], before, scores, counted, window // 2, layer)
        if not ((before != layer) & counted).any():
            break
    return layer


@compiled
def _threshold_round(
    first: int,
    stop: int,
    layer: NDArray[np.intp],
    scores: NDArray[np.float32],
    counted: NDArray[np.bool_],
    reach: int,
    best_layer: NDArray[np.intp],
) -> None:
    """Write the layer of the largest sum of score and share of the window about each pixel; mirrored at edges."""
    count, n_y, n_x = scores.shape
    share = np.float32(1.0 / (2 * reach + 1) ** 2)
    source = np.empty(n_x + 2 * reach, dtype=np.int64)
    for k in range(source.size):
        source[k] = mirrored(k - reach, n_x)
    # Number of pixels of each layer in each column of the window, and their sums up to a column, mirrored at the edges.
    columns, until = np.zeros((count, n_x), dtype=np.int32), np.zeros(source.size + 1, dtype=np.int32)
    largest, best = np.empty(n_x, dtype=np.float32), np.empty(n_x, dtype=np.int32)
    for m in range(first - reach, first + reach):
        _count_row(layer, counted, mirrored(m, n_y), 1, columns)
    for i in range(first, stop):
        _count_row(layer, counted, mirrored(i + reach, n_y), 1, columns)
        largest[:], best[:] = np.float32(-np.inf), 0
        # Layer by layer: the loop over a row's pixels is vectorised.
        for k in range(count):
            line, of_layer, beyond, total = columns[k], scores[k, i], until[2 * reach + 1 :], np.int32(0)
            for j in range(source.size):
                total += line[source[j]]
                until[j + 1] = total
            for j in range(n_x):
                score = share * np.float32(beyond[j] - until[j]) + of_layer[j]
                is_larger = score > largest[j]
                best[j] = np.int32(k) if is_larger else best[j]
                largest[j] = score if is_larger else largest[j]
        best_layer[i] = best
        _count_row(layer, counted, mirrored(i - reach, n_y), -1, columns)


@compiled
def _count_row(
    layer: NDArray[np.intp], counted: NDArray[np.bool_], row: int, times: int, columns: NDArray[np.int32]
) -> None:
    """Add each counted pixel of a row to the number of its layer's pixels in its column, shape (n_layers, n_x)."""
    for j in range(layer.shape[1]):
        if counted[row, j]:
            columns[layer[row, j], j] += times
