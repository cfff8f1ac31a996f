"""Points of an aperture that carry equal shares of its power: the sub-apertures of geometrical occlusion."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray

#: Points of an aperture: they locate an edge in it to about a hundredth of the diameter.
COUNT = 128
#: Steps of the three-dimensional Kronecker sequence of the golden ratio's generalisation (root of g^4 = g + 1).
_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


def sub_apertures_um(x_um: FloatArray, y_um: FloatArray, power: FloatArray, count: int = COUNT) -> FloatArray:
    """Return (x, y) of points whose density is that of the transmitted power, shape (count, 2).

    They are those of a low-discrepancy sequence over the grid's rectangle and the power: a point is kept where its
    third coordinate lies below the relative power.

    Args:
        x_um: shape (n_x,), centres of the grid's cells, equidistant.
        y_um: shape (n_y,), likewise.
        power: shape (n_y, n_x), power through each cell, not negative, some of it positive.
        count: number of points.
    """
    peak = power.max()
    tries = int(np.ceil(1.2 * count * peak / power.mean())) + 64
    along_x, along_y, height = ((0.5 + _STEPS * np.arange(tries)[:, None]) % 1.0).T
    columns, rows = (along_x * x_um.size).astype(int), (along_y * y_um.size).astype(int)
    kept = np.flatnonzero(height < power[rows, columns] / peak)[:count]
    sides = (_step(x_um), _step(y_um))
    x = x_um[0] + sides[0] * (along_x[kept] * x_um.size - 0.5)
    y = y_um[0] + sides[1] * (along_y[kept] * y_um.size - 0.5)
    return np.stack([x, y], axis=1)


def _step(centres_um: FloatArray) -> float:
    return float(centres_um[1] - centres_um[0]) if centres_um.size > 1 else 0.0
