"""Means over windows and sums over labels, of many pictures at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled, compiled_parallel, prange


@compiled
def mirrored(index: int, count: int) -> int:
    """The pixel of a line of ``count`` pixels, mirrored at both ends, that stands at ``index``."""
    index %= 2 * count
    return index if index < count else 2 * count - 1 - index


def window_means(pictures: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Means over a square window about each pixel; beyond an edge, the pictures are mirrored.

    Args:
        pictures: shape (..., n_y, n_x).
        window: side of the window, odd.

    Returns:
        Shape (..., n_y, n_x).
    """
    flat = np.ascontiguousarray(pictures).reshape(-1, *pictures.shape[-2:])
    return np.asarray(_window_means(flat, window // 2).reshape(pictures.shape))


@compiled_parallel
def _window_means(pictures: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    count, n_y, n_x = pictures.shape
    out = np.empty_like(pictures)
    share = 1.0 / (2 * reach + 1) ** 2
    source = np.empty(n_x + 2 * reach, dtype=np.int64)
    for k in range(source.size):
        source[k] = mirrored(k - reach, n_x)
    for p in prange(count):
        column_sum = np.zeros(n_x, dtype=np.float64)
        running = np.empty(source.size + 1, dtype=np.float64)
        for i in range(-reach, reach + 1):
            row = mirrored(i, n_y)
            for j in range(n_x):
                column_sum[j] += pictures[p, row, j]
        for i in range(n_y):
            # Running sums along the mirrored row: running[k] holds the first k values.
            running[0] = 0.0
            for k in range(source.size):
                running[k + 1] = running[k] + column_sum[source[k]]
            for j in range(n_x):
                out[p, i, j] = np.float32((running[j + 2 * reach + 1] - running[j]) * share)
            old, new = mirrored(i - reach, n_y), mirrored(i + reach + 1, n_y)
            for j in range(n_x):
                column_sum[j] += np.float64(pictures[p, new, j]) - np.float64(pictures[p, old, j])
    return out


def halved(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every second pixel of pictures (..., n_y, n_x), smoothed by (1, 2, 1) / 4 along both axes.

    Args:
        pictures: shape (..., n_y, n_x).

    Returns:
        Shape (..., ceil(n_y / 2), ceil(n_x / 2)).
    """
    small = _halved(np.ascontiguousarray(pictures).reshape(-1, *pictures.shape[-2:]))
    return np.asarray(small.reshape(*pictures.shape[:-2], *small.shape[1:]))


@compiled_parallel
def _halved(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    count, n_y, n_x = pictures.shape
    rows, columns = (n_y + 1) // 2, (n_x + 1) // 2
    out = np.empty((count, rows, columns), dtype=np.float32)
    for p in prange(count):
        for i in range(rows):
            above, row, below = max(2 * i - 1, 0), 2 * i, min(2 * i + 1, n_y - 1)
            upper, here, lower = pictures[p, above], pictures[p, row], pictures[p, below]
            for j in range(columns):
                left, at, right = max(2 * j - 1, 0), 2 * j, min(2 * j + 1, n_x - 1)
                before = upper[left] + np.float32(2.0) * here[left] + lower[left]
                middle = upper[at] + np.float32(2.0) * here[at] + lower[at]
                after = upper[right] + np.float32(2.0) * here[right] + lower[right]
                out[p, i, j] = (before + np.float32(2.0) * middle + after) * np.float32(0.0625)
    return out


def label_sums(pictures: NDArray[np.float32], label: NDArray[np.int32], count: int) -> FloatArray:
    """Sums over the pixels of each label.

    Args:
        pictures: shape (n, n_y, n_x).
        label: shape (n_y, n_x), numbers from 1; 0 for none.
        count: the largest number.

    Returns:
        Shape (n, count).
    """
    return _label_sums(pictures.reshape(pictures.shape[0], -1), label.ravel(), count)


@compiled_parallel
def _label_sums(flat: NDArray[np.float32], number: NDArray[np.int32], count: int) -> FloatArray:
    pictures = flat.shape[0]
    sums = np.zeros((pictures, count + 1))
    # Four pictures at once: one sum alone waits for its last addition.
    for block in prange((pictures + 3) // 4):
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
    return sums[:, 1:].copy()
