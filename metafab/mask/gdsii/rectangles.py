"""Boundaries and boxes of GDSII with rings of five points -> rectangles, many at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.mask.shapes.hierarchy import IntArray


def rectangles_of(elements: NDArray[np.uint8], first: int) -> tuple[IntArray, NDArray[np.bool_]]:
    """Elements with rings of five points -> rectangles.

    Args:
        elements: shape (n, stride), the bytes of one element a row.
        first: where in a row the ten coordinates begin, big-endian words.

    Returns:
        Shape (n, 4), x, y, width, height of the bounding box; and shape (n,), whether the ring is an
        axis-parallel rectangle, in whatever sense and from whatever corner it runs.
    """
    count, stride = elements.shape
    if HAS_NUMBA and first % 4 == 0 and stride % 4 == 0:
        rectangles = np.empty((count, 4), dtype=np.int64)
        is_rectangle = np.empty(count, dtype=np.bool_)
        _rectangles_compiled(elements.view(np.uint32), first // 4, rectangles, is_rectangle)
        return rectangles, is_rectangle
    return rectangles_vectorised(elements, first)


def rectangles_vectorised(elements: NDArray[np.uint8], first: int) -> tuple[IntArray, NDArray[np.bool_]]:
    """As :func:`rectangles_of`, in NumPy alone."""
    words = np.ascontiguousarray(elements[:, first : first + 40]).view(">i4")
    x, y = np.moveaxis(words.reshape(-1, 5, 2).astype(np.int64), 2, 0)
    step_x, step_y = np.diff(x, axis=1), np.diff(y, axis=1)
    closed = (x[:, 0] == x[:, 4]) & (y[:, 0] == y[:, 4])
    x_first = np.all(step_y[:, ::2] == 0, axis=1) & np.all(step_x[:, 1::2] == 0, axis=1)
    y_first = np.all(step_x[:, ::2] == 0, axis=1) & np.all(step_y[:, 1::2] == 0, axis=1)
    low = np.stack([x.min(axis=1), y.min(axis=1)], axis=1)
    extent = np.stack([x.max(axis=1), y.max(axis=1)], axis=1) - low
    return np.concatenate([low, extent], axis=1), closed & (x_first | y_first) & np.all(extent > 0, axis=1)


@compiled
def _rectangles_compiled(
    words: NDArray[np.uint32], first: int, rectangles: IntArray, is_rectangle: NDArray[np.bool_]
) -> None:
    p = np.empty(10, dtype=np.int64)
    for i in range(len(words)):
        for k in range(10):
            word = np.int64(words[i, first + k])
            word = (word >> 24) | ((word >> 8) & 0xFF00) | ((word << 8) & 0xFF0000) | ((word << 24) & 0xFF000000)
            p[k] = word - 0x100000000 if word >= 0x80000000 else word
        x_0, x_1, y_0, y_1 = p[0], p[0], p[1], p[1]
        for k in range(2, 10, 2):
            x_0, x_1 = min(x_0, p[k]), max(x_1, p[k])
            y_0, y_1 = min(y_0, p[k + 1]), max(y_1, p[k + 1])
        rectangles[i, 0], rectangles[i, 1], rectangles[i, 2], rectangles[i, 3] = x_0, y_0, x_1 - x_0, y_1 - y_0
        x_first = p[1] == p[3] and p[2] == p[4] and p[5] == p[7] and p[6] == p[0]
        y_first = p[0] == p[2] and p[3] == p[5] and p[4] == p[6] and p[7] == p[1]
        closed = p[0] == p[8] and p[1] == p[9]
        is_rectangle[i] = closed and (x_first or y_first) and x_1 > x_0 and y_1 > y_0
