"""Discrete Fourier transforms of kernels and filters."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray


def transfer_functions(
    kernels: NDArray[np.floating[Any]], size: tuple[int, int]
) -> NDArray[np.complexfloating[Any, Any]]:
    """Return the real transforms of kernels, padded with zeros to a grid and with their middle at its origin.

    Kernels have the shape (..., n_y, n_x) and their origin at [n_y // 2, n_x // 2]; the grid (rows, columns) is no
    smaller.

    Returns:
        Shape (..., rows, columns // 2 + 1), of the precision of ``kernels``.
    """
    n_y, n_x = kernels.shape[-2:]
    up, left = n_y // 2, n_x // 2
    padded = np.zeros((*kernels.shape[:-2], *size), dtype=kernels.dtype)
    padded[..., : n_y - up, : n_x - left] = kernels[..., up:, left:]
    padded[..., : n_y - up, size[1] - left :] = kernels[..., up:, :left]
    padded[..., size[0] - up :, : n_x - left] = kernels[..., :up, left:]
    padded[..., size[0] - up :, size[1] - left :] = kernels[..., :up, :left]
    return np.asarray(scipy.fft.rfft2(padded))


def convolved(one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the whole convolution over the last two axes, of side n + m - 1; leading axes are broadcast.

    As ``scipy.signal.fftconvolve``, whose import takes half a second.
    """
    sides = [n + m - 1 for n, m in zip(one.shape[-2:], other.shape[-2:], strict=True)]
    padded = [scipy.fft.next_fast_len(side, real=True) for side in sides]
    product = scipy.fft.rfft2(one, padded) * scipy.fft.rfft2(other, padded)
    return np.asarray(scipy.fft.irfft2(product, padded)[..., : sides[0], : sides[1]])


def independent_samples(weight: NDArray[np.floating[Any]], size: tuple[int, int]) -> tuple[float, float]:
    """Return the independent samples per pixel of filtered white noise, and the variance that the filter leaves.

    The variance is relative to that of the white noise.

    Args:
        weight: shape (rows, columns // 2 + 1), amplitude of the filter on the half plane of a real transform.
        size: (rows, columns) of the pictures, an even number of columns.
    """
    power: FloatArray = weight.astype(np.float64) ** 2
    share = power.copy()
    share[:, 1:-1] *= 2.0  # the other half plane
    total = size[0] * size[1]
    return float(share.sum() ** 2 / (power * share).sum() / total), float(share.sum() / total)
