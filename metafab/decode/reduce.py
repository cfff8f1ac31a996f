"""Every second or fourth pixel of an image, without what finer structure would be mistaken for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray

_LOBES = 3  # of the sinc, each way
_KAISER_BETA = 4.0


def reduced(image: NDArray[np.float32], every: int) -> NDArray[np.float32]:
    """Low-passed pixels [0, 0], [0, every], ... of an image; beyond its edges, the edges' values."""
    if every == 1:
        return image
    taps = _taps(every)
    for axis in (0, 1):
        reach = taps.size // 2
        count = -(-image.shape[axis] // every)
        extra = [(0, 0), (0, 0)]
        extra[axis] = (reach, reach + every)
        padded = np.moveaxis(np.pad(image, extra, mode="edge"), axis, 0)
        total = taps[0] * padded[0 : count * every : every]
        for k in range(1, taps.size):
            total += taps[k] * padded[k : k + count * every : every]
        image = np.moveaxis(total, 0, axis)
    return np.ascontiguousarray(image)


def passband(every: int, frequency: FloatArray) -> FloatArray:
    """What :func:`reduced` leaves along one axis of a frequency (cycles a pixel)."""
    taps = _taps(every).astype(np.float64)
    away = np.arange(taps.size) - taps.size // 2
    return np.asarray(np.tensordot(taps, np.cos(2.0 * np.pi * away.reshape(-1, *[1] * frequency.ndim) * frequency), 1))


def variance_left(every: int) -> float:
    """Variance of a reduced pixel per variance of white noise in the image."""
    return float(np.sum(_taps(every).astype(np.float64) ** 2) ** 2)


def _taps(every: int) -> NDArray[np.float32]:
    if every == 1:
        return np.ones(1, dtype=np.float32)
    reach = _LOBES * every
    away = np.arange(-reach, reach + 1)
    taps = np.sinc(away / every) * np.kaiser(2 * reach + 1, _KAISER_BETA)
    return np.asarray(taps / taps.sum(), dtype=np.float32)


def doubled(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Values at every second pixel brought back to ``shape``, linear in between."""
    for axis, count in enumerate(shape):
        before = np.moveaxis(values, axis, 0)
        pairs = np.empty((2 * before.shape[0], *before.shape[1:]), dtype=values.dtype)
        pairs[::2] = before
        pairs[1:-1:2] = 0.5 * (before[:-1] + before[1:])
        pairs[-1] = before[-1]
        values = np.moveaxis(pairs[:count], 0, axis)
    return values


def enlarged(values: FloatArray, every: int, shape: tuple[int, int]) -> FloatArray:
    """Values at every ``every``-th pixel (a power of two) brought back to ``shape``, linear in between."""
    while every > 1:
        every //= 2
        values = doubled(values, (-(-shape[0] // every), -(-shape[1] // every)))
    return values


def repeated(values: np.ndarray, every: int, shape: tuple[int, int]) -> np.ndarray:
    """Values at every ``every``-th pixel brought back to ``shape``, each pixel that of its nearest neighbour."""
    rows, columns = (
        np.minimum((np.arange(n) + every // 2) // every, m - 1) for n, m in zip(shape, values.shape, strict=True)
    )
    return np.asarray(values[rows[:, None], columns[None, :]])
