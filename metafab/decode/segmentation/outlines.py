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
    for i in range(first, stop):
        # Number of pixels of each layer in each column of the window, mirrored at the edges, and in the whole window.
        columns = np.zeros((count, n_x + 2 * reach), dtype=np.int32)
        inside = np.zeros(count, dtype=np.int32)
        for m in range(i - reach, i + reach + 1):
            row = mirrored(m, n_y)
            for j in range(n_x):
                if counted[row, j]:
                    columns[layer[row, j], reach + j] += 1
        for k in range(count):
            for j in range(reach):
                columns[k, reach - 1 - j] = columns[k, reach + mirrored(-1 - j, n_x)]
                columns[k, reach + n_x + j] = columns[k, reach + mirrored(n_x + j, n_x)]
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
            best_layer[i, j] = best
