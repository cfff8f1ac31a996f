"""Exact Euclidean distance transform, in time proportional to the pixels.

Columns first, then rows by the lower envelope of parabolas (Felzenszwalb and Huttenlocher, Theory of Computing 8, 415,
2012). Rows and columns are spread over the kept threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread

#: Distance in rows that stands for a column without any pixel: no image is as high, and its square is exact.
_FAR = np.int32(10_000_000)

Nearest = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]


def distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance in pixels to the nearest pixel of ``mask``, shape (n_y, n_x): the same shape; inf if it is empty."""
    return nearest(mask)[0]


def nearest(mask: NDArray[np.bool_]) -> Nearest:
    """Distance, row and column of the nearest pixel of a mask, shape (n_y, n_x) each; of equally near ones, any.

    For an empty mask they are inf and the pixel itself.
    """
    if not mask.any():
        row, column = np.meshgrid(*(np.arange(n, dtype=np.int32) for n in mask.shape), indexing="ij")
        return np.full(mask.shape, np.inf, dtype=np.float32), row, column
    rows, row, column = np.empty((3, *mask.shape), dtype=np.int32)
    distances = np.empty(mask.shape, dtype=np.float32)
    spread(_nearest_rows, mask.shape[1], mask, rows)
    spread(_lower_envelopes, mask.shape[0], rows, distances, row, column)
    return distances, row, column


def box_about(mask: NDArray[np.bool_], reach: int = 0) -> tuple[slice, slice]:
    """Slices of the smallest box about the pixels of a mask, shape (n_y, n_x), and of all within ``reach`` of it.

    The box is empty if the mask is.
    """
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    return (
        slice(max(0, int(rows[0]) - reach), int(rows[-1]) + reach + 1),
        slice(max(0, int(columns[0]) - reach), int(columns[-1]) + reach + 1),
    )


@compiled
def _nearest_rows(first: int, stop: int, mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> None:
    """The nearest row of ``mask`` in each pixel's column; far outside of the image if there is none."""
    n_y, n_x = mask.shape[0], stop - first
    last = np.full(n_x, -_FAR, dtype=np.int32)
    for i in range(n_y):
        here, out = mask[i, first:stop], rows[i, first:stop]
        for j in range(n_x):
            last[j] = np.int32(i) if here[j] else last[j]
            out[j] = last[j]
    last[:] = _FAR
    for i in range(n_y - 1, -1, -1):
        here, out = mask[i, first:stop], rows[i, first:stop]
        for j in range(n_x):
            last[j] = np.int32(i) if here[j] else last[j]
            out[j] = last[j] if last[j] - i < i - out[j] else out[j]


@compiled
def _lower_envelopes(
    first: int,
    stop: int,
    rows: NDArray[np.int32],
    distances: NDArray[np.float32],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
) -> None:
    """The nearest pixel over all columns, from the nearest row of each column."""
    n_x = rows.shape[1]
    # Columns whose parabolas (x - j)^2 + d_j^2 are the lowest somewhere, and the first x at which each is.
    lowest, start = np.empty(n_x, dtype=np.int32), np.empty(n_x + 1, dtype=np.float64)
    height = np.empty(n_x, dtype=np.float64)
    for i in range(first, stop):
        last = -1
        for j in range(n_x):
            if np.abs(rows[i, j]) == _FAR:
                continue
            down = np.float64(rows[i, j] - i)
            height[j] = down * down + np.float64(j) * np.float64(j)
            crossing = -np.inf
            while last >= 0:
                k = lowest[last]
                crossing = (height[j] - height[k]) / np.float64(2 * (j - k))
                if crossing > start[last]:
                    break
                last -= 1
            last += 1
            lowest[last], start[last] = j, crossing
        start[last + 1] = np.inf
        at = 0
        for j in range(n_x):
            while start[at + 1] < j:
                at += 1
            k = lowest[at]
            row[i, j], column[i, j] = rows[i, k], k
            down, along = np.float64(rows[i, k] - i), np.float64(k - j)
            distances[i, j] = np.sqrt(down * down + along * along)
