"""Means over windows and sums over regions of many pictures at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled_parallel, prange


def window_means(pictures: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Means over a square window about each pixel; beyond an edge, the pictures are mirrored at it.

    Args:
        pictures: shape (..., n_y, n_x).
        window: side of the window, odd.
    """
    rows, columns = pictures.shape[-2:]
    if not HAS_NUMBA or window // 2 > min(rows, columns):
        return np.asarray(uniform_filter1d(uniform_filter1d(pictures, window, axis=-1), window, axis=-2))
    flat = np.ascontiguousarray(pictures).reshape(-1, rows, columns)
    return np.asarray(_means(flat, window // 2).reshape(pictures.shape))


@compiled_parallel
def _means(pictures: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    count, n_y, n_x = pictures.shape
    out = np.empty_like(pictures)
    share = 1.0 / (2 * reach + 1) ** 2
    for p in prange(count):
        down = np.zeros(n_x, dtype=np.float64)
        along = np.empty(n_x + 2 * reach + 1, dtype=np.float64)
        for i in range(-reach, reach + 1):
            row = -i - 1 if i < 0 else (2 * n_y - 1 - i if i >= n_y else i)
            for j in range(n_x):
                down[j] += pictures[p, row, j]
        for i in range(n_y):
            # Running sums along the row, of its mirrored continuation: along[k] holds the first k values.
            along[0] = 0.0
            for k in range(n_x + 2 * reach):
                j = k - reach
                j = -j - 1 if j < 0 else (2 * n_x - 1 - j if j >= n_x else j)
                along[k + 1] = along[k] + down[j]
            for j in range(n_x):
                out[p, i, j] = np.float32((along[j + 2 * reach + 1] - along[j]) * share)
            old, new = i - reach, i + reach + 1
            old = -old - 1 if old < 0 else old
            new = 2 * n_y - 1 - new if new >= n_y else new
            if i + 1 < n_y:
                for j in range(n_x):
                    down[j] += np.float64(pictures[p, new, j]) - np.float64(pictures[p, old, j])
    return out


def halved(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every second pixel of pictures (..., n_y, n_x), a mean of what lies about it by (1, 2, 1) / 4 each way."""
    rows, columns = pictures.shape[-2:]
    flat = np.ascontiguousarray(pictures).reshape(-1, rows, columns)
    small = (_halved if HAS_NUMBA else _halved_plain)(flat)
    return np.asarray(small.reshape(*pictures.shape[:-2], *small.shape[1:]))


@compiled_parallel
def _halved(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    count, n_y, n_x = pictures.shape
    rows, columns = (n_y + 1) // 2, (n_x + 1) // 2
    out = np.empty((count, rows, columns), dtype=np.float32)
    for p in prange(count):
        for i in range(rows):
            above, here, below = (
                pictures[p, max(2 * i - 1, 0)],
                pictures[p, 2 * i],
                pictures[p, min(2 * i + 1, n_y - 1)],
            )
            for j in range(columns):
                left, at, right = max(2 * j - 1, 0), 2 * j, min(2 * j + 1, n_x - 1)
                before = above[left] + np.float32(2.0) * here[left] + below[left]
                middle = above[at] + np.float32(2.0) * here[at] + below[at]
                after = above[right] + np.float32(2.0) * here[right] + below[right]
                out[p, i, j] = (before + np.float32(2.0) * middle + after) * np.float32(0.0625)
    return out


def _halved_plain(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    for axis in (-2, -1):
        values = np.moveaxis(pictures, axis, 0)
        after = np.concatenate([values[1:], values[-1:]])
        before = np.concatenate([values[:1], values[:-1]])
        pictures = np.moveaxis(0.5 * values[::2] + 0.25 * (after[::2] + before[::2]), 0, axis)
    return np.ascontiguousarray(pictures)


def label_sums(pictures: NDArray[np.float32], label: NDArray[np.int32], count: int) -> FloatArray:
    """Sums over the pixels of each label from 1 to ``count``: shape (n, count).

    Args:
        pictures: shape (n, n_y, n_x).
        label: shape (n_y, n_x), 0 for none.
        count: the largest label.
    """
    flat, number = pictures.reshape(pictures.shape[0], -1), label.ravel()
    return (_label_sums if HAS_NUMBA else _label_sums_plain)(flat, number, count)


def _label_sums_plain(flat: NDArray[np.float32], number: NDArray[np.int32], count: int) -> FloatArray:
    sums = [np.bincount(number, weights=row, minlength=count + 1)[1:] for row in flat]
    return np.asarray(np.stack(sums), dtype=np.float64)


@compiled_parallel
def _label_sums(flat: NDArray[np.float32], number: NDArray[np.int32], count: int) -> FloatArray:
    sums = np.zeros((flat.shape[0], count + 1))
    for p in prange(flat.shape[0]):
        for i in range(number.size):
            if number[i] > 0:
                sums[p, number[i]] += np.float64(flat[p, i])
    return sums[:, 1:].copy()
