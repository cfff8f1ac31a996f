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

from metafab.decode.pooling import window_means

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
    numbers = np.arange(scores.shape[0])[:, None, None]
    for _ in range(_ROUNDS):
        shares = window_means(((layer == numbers) & counted).astype(np.float32), window)
        shares += scores
        before, layer = layer, shares.argmax(axis=0)
        if np.array_equal(before[counted], layer[counted]):
            break
    return layer
