"""Products of the filtered twin images, each a mixture of basis images whose weights change block by block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.registration.downsampling import blocks_with


def mixed_products(
    images: NDArray[np.float32], weights: NDArray[np.float32], block: int, lit: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Products a b, a^2 and b^2 of the mixtures a of the x images and b of the y images.

    Args:
        images: shape (2, n_basis, n_y, n_x), basis images of x and of y.
        weights: shape (2, n_block_y, n_block_x, n_mixtures, n_basis).
        block: side of a block, pixels.
        lit: shape (n_y, n_x); the products of blocks without a lit pixel are 0.

    Returns:
        Shape (3, n_mixtures, n_y, n_x), contiguous.
    """
    wanted = square_blocks_with(lit, block)
    rows, columns = lit.shape
    extra = (wanted.shape[0] * block - rows, wanted.shape[1] * block - columns)
    if any(extra):
        images = np.pad(images, ((0, 0), (0, 0), (0, extra[0]), (0, extra[1])))
    shape = (3, weights.shape[3], wanted.shape[0] * block, wanted.shape[1] * block)
    products = np.zeros(shape, dtype=np.float32)
    spread(_mixed_products, wanted.shape[0], images, weights, block, wanted, products)
    return np.ascontiguousarray(products[..., :rows, :columns])


def square_blocks_with(mask: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Whether each square block holds a pixel of ``mask`` (n_y, n_x): shape (n_block_y, n_block_x)."""
    return blocks_with(mask, (block, block), (-(-mask.shape[0] // block), -(-mask.shape[1] // block)))


@compiled
def _mix(images: NDArray[np.float32], weights: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Write sums of images (n, n_px) by weights (n_mixtures, n) into ``out``; its extra rows repeat the last mixture.

    Four mixtures of two images are summed at once, so that each pixel that is read serves several products.
    """
    last_mixture, last_image = weights.shape[0] - 1, images.shape[0] - 1
    out[:] = np.float32(0.0)
    for v in range(0, out.shape[0], 4):
        v0, v1 = min(v, last_mixture), min(v + 1, last_mixture)
        v2, v3 = min(v + 2, last_mixture), min(v + 3, last_mixture)
        o0, o1, o2, o3 = out[v], out[v + 1], out[v + 2], out[v + 3]
        for k in range(0, images.shape[0], 2):
            second = min(k + 1, last_image)
            once = np.float32(second - k)  # 0 where the number of images is odd
            a, b = images[k], images[second]
            a0, a1, a2, a3 = weights[v0, k], weights[v1, k], weights[v2, k], weights[v3, k]
            b0, b1 = once * weights[v0, second], once * weights[v1, second]
            b2, b3 = once * weights[v2, second], once * weights[v3, second]
            for p in range(a.size):
                x, y = a[p], b[p]
                o0[p] += a0 * x + b0 * y
                o1[p] += a1 * x + b1 * y
                o2[p] += a2 * x + b2 * y
                o3[p] += a3 * x + b3 * y


@compiled
def _copy_blocks(lines: NDArray[np.float32], blocks: NDArray[np.float32]) -> None:
    """Copy lines of images (n, block, n_x) into blocks (n_block_x, n, block * block)."""
    block = lines.shape[1]
    for k in range(lines.shape[0]):
        for i in range(block):
            line = lines[k, i]
            for column in range(blocks.shape[0]):
                for j in range(block):
                    blocks[column, k, i * block + j] = line[column * block + j]


@compiled
def _mixed_products(
    first: int,
    stop: int,
    images: NDArray[np.float32],
    weights: NDArray[np.float32],
    block: int,
    wanted: NDArray[np.bool_],
    products: NDArray[np.float32],
) -> None:
    """As :func:`mixed_products`, for images of whole blocks."""
    n_basis, count, columns = weights.shape[4], weights.shape[3], wanted.shape[1]
    for row in range(first, stop):
        some = False
        for column in range(columns):
            some |= wanted[row, column]
        if not some:
            continue
        # The pixels of a block are contiguous, so that the mixing runs over all of them at once.
        inputs = np.empty((2, columns, n_basis, block * block), dtype=np.float32)
        mixed = np.zeros((2, columns, 4 * ((count + 3) // 4), block * block), dtype=np.float32)
        for image in range(2):
            _copy_blocks(images[image, :, row * block : (row + 1) * block], inputs[image])
            for column in range(columns):
                if wanted[row, column]:
                    _mix(inputs[image, column], weights[image, row, column], mixed[image, column])
        for v in range(count):
            for i in range(block):
                to = products[:, v, row * block + i]
                for column in range(columns):
                    for j in range(block):
                        a, b = mixed[0, column, v, i * block + j], mixed[1, column, v, i * block + j]
                        at = column * block + j
                        to[0, at], to[1, at], to[2, at] = a * b, a * a, b * b
