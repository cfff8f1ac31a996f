"""Mixtures of a few images whose shares change over the picture: the two aligned twins and their products."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import HAS_NUMBA, compiled, compiled_parallel, prange


def agreement(
    passed: NDArray[np.float32], shares: NDArray[np.float32], block: int, lit: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Products of the two mixtures a of the x images and b of the y images: a b, a^2, b^2.

    Args:
        passed: shape (2, n_basis, n_y, n_x), the images of x and of y.
        shares: shape (2, n_block_y, n_block_x, n_mixtures, n_basis).
        block: pixels a side of a block, all of which take the same shares.
        lit: shape (n_y, n_x); blocks without any are left 0.

    Returns:
        Shape (3, n_mixtures, n_y, n_x).
    """
    wanted = touched(lit, block)
    rows, columns = lit.shape
    extra = (wanted.shape[0] * block - rows, wanted.shape[1] * block - columns)
    if any(extra):
        passed = np.pad(passed, ((0, 0), (0, 0), (0, extra[0]), (0, extra[1])))
    return (_products if HAS_NUMBA else _products_plain)(passed, shares, block, wanted)[..., :rows, :columns]


def touched(mask: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Which blocks hold a pixel of ``mask``: shape (n_block_y, n_block_x)."""
    rows, columns = (-(-n // block) for n in mask.shape)
    whole = np.zeros((rows * block, columns * block), dtype=bool)
    whole[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(whole.reshape(rows, block, columns, block).any(axis=(1, 3)))


@compiled
def _mix(images: NDArray[np.float32], shares: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Sums of images (n, n_px) by shares (n_mixtures, n); rows of ``out`` beyond the mixtures repeat the last.

    Four sums of two images at once: each value that is read serves several products.
    """
    most, last_image = shares.shape[0] - 1, images.shape[0] - 1
    out[:] = np.float32(0.0)
    for v in range(0, out.shape[0], 4):
        v0, v1, v2, v3 = min(v, most), min(v + 1, most), min(v + 2, most), min(v + 3, most)
        o0, o1, o2, o3 = out[v], out[v + 1], out[v + 2], out[v + 3]
        for k in range(0, images.shape[0], 2):
            last = min(k + 1, last_image)
            once = np.float32(last - k)
            a, b = images[k], images[last]
            a0, a1, a2, a3 = shares[v0, k], shares[v1, k], shares[v2, k], shares[v3, k]
            b0, b1 = once * shares[v0, last], once * shares[v1, last]
            b2, b3 = once * shares[v2, last], once * shares[v3, last]
            for p in range(a.size):
                x, y = a[p], b[p]
                o0[p] += a0 * x + b0 * y
                o1[p] += a1 * x + b1 * y
                o2[p] += a2 * x + b2 * y
                o3[p] += a3 * x + b3 * y


@compiled
def _lay_out(lines: NDArray[np.float32], blocks: NDArray[np.float32]) -> None:
    """Lines of images (n, block, n_x) as blocks (n_block_x, n, block * block)."""
    block = lines.shape[1]
    for k in range(lines.shape[0]):
        for i in range(block):
            line = lines[k, i]
            for column in range(blocks.shape[0]):
                for j in range(block):
                    blocks[column, k, i * block + j] = line[column * block + j]


@compiled_parallel
def _products(
    passed: NDArray[np.float32], shares: NDArray[np.float32], block: int, wanted: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """As :func:`agreement`, for images of whole blocks."""
    n_basis, count, columns = shares.shape[4], shares.shape[3], wanted.shape[1]
    parts = np.zeros((3, count, wanted.shape[0] * block, columns * block), dtype=np.float32)
    for row in prange(wanted.shape[0]):
        if not wanted[row].any():
            continue
        # A block's pixels lie side by side, so that the mixing runs over all of them at once; pictures are read and
        # written by whole lines.
        inputs = np.empty((2, columns, n_basis, block * block), dtype=np.float32)
        mixed = np.zeros((2, columns, 4 * ((count + 3) // 4), block * block), dtype=np.float32)
        for image in range(2):
            _lay_out(passed[image, :, row * block : (row + 1) * block], inputs[image])
            for column in range(columns):
                if wanted[row, column]:
                    _mix(inputs[image, column], shares[image, row, column], mixed[image, column])
        for v in range(count):
            for i in range(block):
                to = parts[:, v, row * block + i]
                for column in range(columns):
                    for j in range(block):
                        a, b = mixed[0, column, v, i * block + j], mixed[1, column, v, i * block + j]
                        at = column * block + j
                        to[0, at], to[1, at], to[2, at] = a * b, a * a, b * b
    return parts


def _products_plain(
    passed: NDArray[np.float32], shares: NDArray[np.float32], block: int, wanted: NDArray[np.bool_]
) -> NDArray[np.float32]:
    _, _, n_y, n_x = passed.shape
    parts = np.zeros((3, shares.shape[3], n_y, n_x), dtype=np.float32)
    for row, column in np.argwhere(wanted):
        part = (..., slice(row * block, (row + 1) * block), slice(column * block, (column + 1) * block))
        a, b = (np.tensordot(shares[p, row, column], passed[p][part], axes=(1, 0)) for p in (0, 1))
        parts[part] = np.stack([a * b, a * a, b * b])
    return parts
