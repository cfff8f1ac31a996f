"""Mixtures of a few images whose shares change over the picture: the two aligned twins and their products."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numerics import HAS_NUMBA, compiled_parallel, prange


def agreement(
    x_passed: NDArray[np.float32],
    y_passed: NDArray[np.float32],
    shares: NDArray[np.float32],
    block: int,
    lit: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Products of the two mixtures a of the x images and b of the y images: a b, a^2, b^2.

    Args:
        x_passed: shape (n_basis, n_y, n_x).
        y_passed: the same shape.
        shares: shape (2, n_block_y, n_block_x, n_basis, n_mixtures).
        block: pixels a side of a block, all of which take the same shares.
        lit: shape (n_y, n_x); blocks without any are left 0.

    Returns:
        Shape (3, n_mixtures, n_y, n_x).
    """
    mix = _products if HAS_NUMBA else _products_plain
    return mix(x_passed, y_passed, shares, block, touched(lit, block))


def touched(mask: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Which blocks hold a pixel of ``mask``: shape (n_block_y, n_block_x)."""
    rows, columns = (-(-n // block) for n in mask.shape)
    whole = np.zeros((rows * block, columns * block), dtype=bool)
    whole[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(whole.reshape(rows, block, columns, block).any(axis=(1, 3)))


def covered(mask: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """The pixels of all blocks that hold a pixel of ``mask``: the shape of ``mask``."""
    whole = touched(mask, block).repeat(block, axis=0).repeat(block, axis=1)
    return np.asarray(whole[: mask.shape[0], : mask.shape[1]])


@compiled_parallel
def _products(
    x_passed: NDArray[np.float32],
    y_passed: NDArray[np.float32],
    shares: NDArray[np.float32],
    block: int,
    wanted: NDArray[np.bool_],
) -> NDArray[np.float32]:
    n_basis, n_y, n_x = x_passed.shape
    count = shares.shape[4]
    parts = np.zeros((3, count, n_y, n_x), dtype=np.float32)
    for row in prange(wanted.shape[0]):
        a, b = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
        for column in range(wanted.shape[1]):
            if not wanted[row, column]:
                continue
            of_x, of_y = shares[0, row, column], shares[1, row, column]
            for i in range(row * block, min((row + 1) * block, n_y)):
                for j in range(column * block, min((column + 1) * block, n_x)):
                    a[:] = np.float32(0.0)
                    b[:] = np.float32(0.0)
                    for k in range(n_basis):
                        x, y = x_passed[k, i, j], y_passed[k, i, j]
                        for v in range(count):
                            a[v] += of_x[k, v] * x
                            b[v] += of_y[k, v] * y
                    for v in range(count):
                        parts[0, v, i, j] = a[v] * b[v]
                        parts[1, v, i, j] = a[v] * a[v]
                        parts[2, v, i, j] = b[v] * b[v]
    return parts


def _products_plain(
    x_passed: NDArray[np.float32],
    y_passed: NDArray[np.float32],
    shares: NDArray[np.float32],
    block: int,
    wanted: NDArray[np.bool_],
) -> NDArray[np.float32]:
    _, n_y, n_x = x_passed.shape
    parts = np.zeros((3, shares.shape[4], n_y, n_x), dtype=np.float32)
    for row, column in np.argwhere(wanted):
        part = (..., slice(row * block, (row + 1) * block), slice(column * block, (column + 1) * block))
        a = np.tensordot(shares[0, row, column], x_passed[part], axes=(0, 0))
        b = np.tensordot(shares[1, row, column], y_passed[part], axes=(0, 0))
        parts[part] = np.stack([a * b, a * a, b * b])
    return parts
