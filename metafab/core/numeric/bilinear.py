"""Bilinear interpolation of samples on a centred grid."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray

Number = TypeVar("Number", np.float64, np.complex128)


def bilinear_on_grid(samples: NDArray[Number], x: FloatArray, y: FloatArray) -> NDArray[Number]:
    """Interpolate samples at the points of a rectangular grid, shape (n_y, n_x); outside, the border's values are held.

    Samples, shape (m_y, m_x), at least 2 x 2, real or complex, are centred on the origin, lowest y first. Positions x,
    shape (n_x,), and y, shape (n_y,), are in units of their pitch.
    """
    row, share_y = _neighbours(y, samples.shape[0])
    column, share_x = _neighbours(x, samples.shape[1])
    rows = samples[row] * (1.0 - share_y)[:, None] + samples[row + 1] * share_y[:, None]
    return np.asarray(rows[:, column] * (1.0 - share_x) + rows[:, column + 1] * share_x)


def _neighbours(position: FloatArray, count: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Lower neighbour and share of the upper one, for positions from the centre of ``count`` samples."""
    index = np.clip(position + 0.5 * (count - 1), 0.0, count - 1.0)
    lower = np.minimum(index.astype(np.int64), count - 2)
    return lower, index - lower
