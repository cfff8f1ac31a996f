"""Outlines on the frame's pixels, from segments on downsampled ones.

A downsampled pixel is in one segment, so that its pixels would follow outlines in steps of its side. An outline is
placed between them: of the segments about a pixel, the one whose downsampled pixels weigh most under a Gaussian has it.
What is thinner than three downsampled pixels, as a bar, keeps its own. Outlines that are known more finely
(:mod:`metafab.decode.images.frame_outlines`) stand where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.matching.pooling import window_maxima
from metafab.decode.registration.downsampling import repeated

#: Standard deviation of the Gaussian, and its reach, downsampled pixels. From 1.1 to 1.6 natural scenes are 3 to 4 %
#: less off, an edge 2 to 20 % (three frames each).
DEVIATION, REACH = 1.3, 2


def on_pixels(
    label: NDArray[np.int32], step: int, shape: tuple[int, int], beyond_px: NDArray[np.float32] | None = None
) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """A function that brings values of downsampled pixels, shape (m_y, m_x), to the frame's pixels, shape ``shape``.

    Each takes the value of the nearest downsampled pixel of its segment.

    Args:
        label: shape (m_y, m_x), numbers of the segments, from 0 for none.
        step: frame pixels from one downsampled pixel to the next.
        shape: (n_y, n_x) of the frame's window.
        beyond_px: shape (m_y, m_x), as of :class:`metafab.decode.segmentation.segments.Regions`.
    """
    lowest, highest = -window_maxima(-label, 3), window_maxima(label, 3)
    if step == 1 or (lowest == highest).all():
        return partial(repeated, step=step, shape=shape)
    thick = window_maxima(lowest == highest, 3)
    side = 2 * REACH + 1
    mixed = np.ascontiguousarray(thick & (window_maxima(label, side) != -window_maxima(-label, side)))
    weights = [_weights(n, step, m) for n, m in zip(shape, label.shape, strict=True)]
    source = np.empty(shape, dtype=np.intp)
    # Beyond a straight outline, the segment's weight is the integral of the Gaussian.
    beyond = np.zeros(label.shape) if beyond_px is None else beyond_px.astype(np.float64)
    share = ndtr(beyond / (DEVIATION * step))
    odds = np.ascontiguousarray(share / (1.0 - share))
    spread(_write_sources, label.shape[0], np.ascontiguousarray(label), mixed, odds, step, *weights, source)
    return lambda values: values.ravel().take(source)


def _weights(count: int, step: int, blocks: int) -> FloatArray:
    """Gaussian weights of the downsampled pixels about each pixel of a line, shape (count, 2 reach + 1)."""
    place = np.arange(count)
    nearest = np.minimum((place + step // 2) // step, blocks - 1)
    away = nearest[:, None] + np.arange(-REACH, REACH + 1) - (place / step)[:, None]
    return np.asarray(np.exp(-0.5 * (away / DEVIATION) ** 2))


@compiled
def _write_sources(
    first: int,
    stop: int,
    label: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    odds: FloatArray,
    step: int,
    along_y: FloatArray,
    along_x: FloatArray,
    source: NDArray[np.intp],
) -> None:
    """Write, for each pixel, the flat index of the nearest downsampled pixel of the segment that weighs most."""
    n_y, n_x = label.shape
    side, widest = along_y.shape[1], 2 * step
    numbers = np.empty(side * side, dtype=np.int32)
    # Of the pixels nearest to a downsampled one, row by row: weights along both axes, sums of each segment's weights.
    of_y, of_x, sums = np.zeros((side, widest**2)), np.zeros((side, widest**2)), np.empty((side * side, widest**2))
    for row in range(first, stop):
        top, bottom = _pixels_of(row, n_y, step, source.shape[0])
        for column in range(n_x):
            left, right = _pixels_of(column, n_x, step, source.shape[1])
            source[top:bottom, left:right] = row * n_x + column
            if not mixed[row, column]:
                continue
            count, place = (bottom - top) * (right - left), 0
            for y in range(top, bottom):
                for x in range(left, right):
                    of_y[:, place], of_x[:, place] = along_y[y], along_x[x]
                    place += 1
            segments = _add_weights(label, row, column, of_y[:, :count], of_x[:, :count], numbers, sums[:, :count])
            for place in range(count):
                best = 0
                sums[0, place] *= odds[row, column]
                for k in range(1, segments):
                    # Its own segment wins ties.
                    if sums[k, place] > sums[best, place] * (1.0 + 1e-9):
                        best = k
                if best > 0:
                    y, x = top + place // (right - left), left + place % (right - left)
                    source[y, x] = _nearest(label, row, column, along_y[y], along_x[x], numbers[best])


@compiled
def _pixels_of(index: int, blocks: int, step: int, count: int) -> tuple[int, int]:
    """First and end of the pixels, of a line of ``count``, nearest to a downsampled one of ``blocks``."""
    first = max(index * step - step // 2, 0)
    return first, count if index == blocks - 1 else min((index + 1) * step - step // 2, count)


@compiled
def _add_weights(
    label: NDArray[np.int32],
    row: int,
    column: int,
    of_y: FloatArray,
    of_x: FloatArray,
    numbers: NDArray[np.int32],
    sums: FloatArray,
) -> int:
    """Count the segments about a downsampled pixel, and write their numbers, its own first, and weights.

    Weights along both axes have the shape (2 reach + 1, n_pixels), their sums (n_segments, n_pixels).
    """
    n_y, n_x = label.shape
    side, count = of_y.shape[0], 1
    numbers[0], sums[0] = label[row, column], 0.0
    for j in range(side):
        for i in range(side):
            number = label[min(max(row + j - side // 2, 0), n_y - 1), min(max(column + i - side // 2, 0), n_x - 1)]
            k = 0
            while k < count and numbers[k] != number:
                k += 1
            if k == count:
                numbers[k], sums[k] = number, 0.0
                count += 1
            total, down, across = sums[k], of_y[j], of_x[i]
            for place in range(total.size):
                total[place] += down[place] * across[place]
    return count


@compiled
def _nearest(
    label: NDArray[np.int32], row: int, column: int, along_y: FloatArray, along_x: FloatArray, number: int
) -> int:
    """Flat index of the pixel of a segment that weighs most about a downsampled pixel."""
    n_y, n_x = label.shape
    reach, largest, at = along_y.size // 2, -1.0, 0
    for j in range(max(0, reach - row), min(along_y.size, n_y + reach - row)):
        for i in range(max(0, reach - column), min(along_x.size, n_x + reach - column)):
            weight, place = along_y[j] * along_x[i], (row + j - reach) * n_x + column + i - reach
            if weight > largest and label[row + j - reach, column + i - reach] == number:
                largest, at = weight, place
    return at
