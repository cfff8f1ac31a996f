"""Mixtures of a few images whose shares change over the picture: the two aligned twins and their products."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numerics import HAS_NUMBA, compiled, compiled_parallel, prange


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


@compiled
def _mix(images: NDArray[np.float32], shares: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Sum of images (n, n_px) by their shares (n,), four at once; n is a multiple of four."""
    out[:] = np.float32(0.0)
    for k in range(0, shares.size, 4):
        a, b, c, d = images[k], images[k + 1], images[k + 2], images[k + 3]
        of_a, of_b, of_c, of_d = shares[k], shares[k + 1], shares[k + 2], shares[k + 3]
        for p in range(out.size):
            out[p] += (of_a * a[p] + of_b * b[p]) + (of_c * c[p] + of_d * d[p])


@compiled_parallel
def _products(
    x_passed: NDArray[np.float32],
    y_passed: NDArray[np.float32],
    shares: NDArray[np.float32],
    block: int,
    wanted: NDArray[np.bool_],
) -> NDArray[np.float32]:
    n_basis, n_y, n_x = x_passed.shape
    count, px, padded = shares.shape[4], block * block, 4 * ((n_basis + 3) // 4)
    parts = np.zeros((3, count, n_y, n_x), dtype=np.float32)
    for row in prange(wanted.shape[0]):
        # A block's pixels lie side by side, and images are padded to fours: both let the mixing be vectorised.
        inputs = np.zeros((2, padded, px), dtype=np.float32)
        share = np.zeros((2, count, padded), dtype=np.float32)
        mixed = np.empty((2, px), dtype=np.float32)
        top, rows = row * block, min(block, n_y - row * block)
        for column in range(wanted.shape[1]):
            if not wanted[row, column]:
                continue
            left, columns = column * block, min(block, n_x - column * block)
            for k in range(n_basis):
                for i in range(rows):
                    for j in range(columns):
                        inputs[0, k, i * block + j] = x_passed[k, top + i, left + j]
                        inputs[1, k, i * block + j] = y_passed[k, top + i, left + j]
                for v in range(count):
                    share[0, v, k] = shares[0, row, column, k, v]
                    share[1, v, k] = shares[1, row, column, k, v]
            for v in range(count):
                for image in range(2):
                    _mix(inputs[image], share[image, v], mixed[image])
                for i in range(rows):
                    for j in range(columns):
                        x, y = mixed[0, i * block + j], mixed[1, i * block + j]
                        parts[0, v, top + i, left + j] = x * y
                        parts[1, v, top + i, left + j] = x * x
                        parts[2, v, top + i, left + j] = y * y
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
