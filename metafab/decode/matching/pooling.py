"""Means and maxima over windows and sums over labels, of many pictures at once."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread

Value = TypeVar("Value", np.bool_, np.int32, np.float32)

#: Number of pictures that are summed at once: additions to a single sum wait for one another.
_PICTURES_AT_ONCE = 4


@compiled
def mirrored(index: int, count: int) -> int:
    """The pixel of a line of ``count`` pixels, mirrored at both ends, that stands at ``index``."""
    index %= 2 * count
    return index if index < count else 2 * count - 1 - index


def window_means(pictures: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Means over a square window of odd side about each pixel; beyond an edge, the pictures are mirrored.

    Pictures and means have the shape (..., n_y, n_x).
    """
    flat = np.ascontiguousarray(pictures).reshape(-1, *pictures.shape[-2:])
    out = np.empty_like(flat)
    spread(_window_means, flat.shape[0], flat, window // 2, out)
    return out.reshape(pictures.shape)


@compiled
def _window_means(first: int, stop: int, pictures: NDArray[np.float32], reach: int, out: NDArray[np.float32]) -> None:
    _, n_y, n_x = pictures.shape
    share = 1.0 / (2 * reach + 1) ** 2
    source = np.empty(n_x + 2 * reach, dtype=np.int64)
    for k in range(source.size):
        source[k] = mirrored(k - reach, n_x)
    # Running sums along mirrored rows: running[row, k] holds the first k values. Four rows at once: additions to a
    # single sum wait for one another.
    column_sums, running = np.empty((4, n_x), dtype=np.float64), np.zeros((4, source.size + 1), dtype=np.float64)
    for p in range(first, stop):
        column_sum = np.zeros(n_x, dtype=np.float64)
        for i in range(-reach, reach + 1):
            line = pictures[p, mirrored(i, n_y)]
            for j in range(n_x):
                column_sum[j] += line[j]
        for top in range(0, n_y, 4):
            rows = min(4, n_y - top)
            for row in range(rows):
                column_sums[row] = column_sum
                old = pictures[p, mirrored(top + row - reach, n_y)]
                new = pictures[p, mirrored(top + row + reach + 1, n_y)]
                for j in range(n_x):
                    column_sum[j] += np.float64(new[j]) - np.float64(old[j])
            a = b = c = d = 0.0
            for k in range(source.size):
                j = source[k]
                a += column_sums[0, j]
                b += column_sums[1, j]
                c += column_sums[2, j]
                d += column_sums[3, j]
                running[0, k + 1], running[1, k + 1], running[2, k + 1], running[3, k + 1] = a, b, c, d
            for row in range(rows):
                low, high, to = running[row], running[row, 2 * reach + 1 :], out[p, top + row]
                for j in range(n_x):
                    to[j] = np.float32((high[j] - low[j]) * share)


def window_maxima(picture: NDArray[Value], window: int) -> NDArray[Value]:
    """Largest values in the window of odd side about each pixel, shape (n_y, n_x), inside the picture.

    Maxima of two overlapping windows are those of a wider one, so that the time grows with the logarithm of the side.
    """
    for axis, count in enumerate(picture.shape):
        reach = min(window // 2, count - 1)
        extra = [(reach, reach) if other == axis else (0, 0) for other in range(2)]
        largest, side = np.pad(picture, extra, mode="edge"), 1
        while side < 2 * reach + 1:
            step = min(side, 2 * reach + 1 - side)
            lines = largest if axis == 0 else largest.T
            both = np.maximum(lines[:-step], lines[step:])
            largest, side = both if axis == 0 else both.T, side + step
        picture = largest
    return picture


def opened_by_square(mask: NDArray[np.bool_], window: int) -> NDArray[np.bool_]:
    """Pixels of a mask, shape (n_y, n_x), in the squares of odd side ``window`` that lie in it: the same shape."""
    reach = window // 2
    inner = slice(reach, -reach or None)
    outside = np.pad(~mask, reach, constant_values=True)
    return window_maxima(~window_maxima(outside, window)[inner, inner], window)


def smoothed(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Pictures smoothed by (1, 2, 1) / 4 along both axes, shape (..., n_y, n_x); beyond an edge, its pixels repeat."""
    weights = np.array([0.25, 0.5, 0.25])
    return np.asarray(convolve1d(convolve1d(pictures, weights, axis=-1, mode="nearest"), weights, -2, mode="nearest"))


def halved(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every second pixel of pictures, smoothed by (1, 2, 1) / 4 along both axes.

    The shape (..., n_y, n_x) becomes (..., ceil(n_y / 2), ceil(n_x / 2)).
    """
    flat = np.ascontiguousarray(pictures).reshape(-1, *pictures.shape[-2:])
    small = np.empty((flat.shape[0], *((n + 1) // 2 for n in flat.shape[1:])), dtype=np.float32)
    spread(_halved, flat.shape[0], flat, small)
    return small.reshape(*pictures.shape[:-2], *small.shape[1:])


@compiled
def _halved(first: int, stop: int, pictures: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    _, n_y, n_x = pictures.shape
    _, rows, columns = out.shape
    for p in range(first, stop):
        for i in range(rows):
            above, row, below = max(2 * i - 1, 0), 2 * i, min(2 * i + 1, n_y - 1)
            upper, here, lower = pictures[p, above], pictures[p, row], pictures[p, below]
            for j in range(columns):
                left, at, right = max(2 * j - 1, 0), 2 * j, min(2 * j + 1, n_x - 1)
                before = upper[left] + np.float32(2.0) * here[left] + lower[left]
                middle = upper[at] + np.float32(2.0) * here[at] + lower[at]
                after = upper[right] + np.float32(2.0) * here[right] + lower[right]
                out[p, i, j] = (before + np.float32(2.0) * middle + after) * np.float32(0.0625)


def label_sums(pictures: NDArray[np.float32], label: NDArray[np.int32], count: int) -> FloatArray:
    """Sums of pictures, shape (n, n_y, n_x), over the pixels of each label from 1: shape (n, count).

    ``label`` has the shape (n_y, n_x), 0 for none; ``count`` is the largest number.
    """
    sums = np.zeros((pictures.shape[0], count + 1))
    flat = pictures.reshape(pictures.shape[0], -1)
    spread(_label_sums, -(-pictures.shape[0] // _PICTURES_AT_ONCE), flat, label.ravel(), sums)
    return sums[:, 1:].copy()


@compiled
def _label_sums(first: int, stop: int, flat: NDArray[np.float32], number: NDArray[np.int32], sums: FloatArray) -> None:
    pictures, count = flat.shape[0], sums.shape[1] - 1
    for block in range(first, stop):
        p = min(4 * block, max(pictures - 4, 0))
        q, r, s = min(p + 1, pictures - 1), min(p + 2, pictures - 1), min(p + 3, pictures - 1)
        at = np.zeros((count + 1, 4))
        for i in range(number.size):
            k = number[i]
            if k > 0:
                at[k, 0] += np.float64(flat[p, i])
                at[k, 1] += np.float64(flat[q, i])
                at[k, 2] += np.float64(flat[r, i])
                at[k, 3] += np.float64(flat[s, i])
        for k in range(1, count + 1):
            sums[p, k], sums[q, k], sums[r, k], sums[s, k] = at[k, 0], at[k, 1], at[k, 2], at[k, 3]
