"""Passes of conjugate gradients over the transforms of many pictures, each a single loop over memory.

The unknowns are the transforms of whitened pictures, whose prior is of unit variance. Transforms are passed as real
numbers, shape (n, n_ky, 2 n_kx): real and imaginary parts side by side, and real filters with each value twice
(:func:`twice`). In a product of complex numbers and a real filter, NumPy would make complex numbers of the filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled


def parts(spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
    """View of transforms (..., n_kx) as their real and imaginary parts: shape (..., 2 n_kx)."""
    return spectra.view(np.float32)


def twice(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Real filter (..., n_kx) with each value twice: shape (..., 2 n_kx)."""
    return np.repeat(values, 2, axis=-1)


def inner_products(sums: NDArray[np.float32], starts: NDArray[np.intp], pixels: int) -> NDArray[np.float32]:
    """Inner products of pictures from products of their transforms, summed over the pictures of each problem.

    Args:
        sums: shape (n, 2 n_kx), sums of the products over ky.
        starts: shape (n_problems,), first picture of each problem.
        pixels: number of a picture's pixels.

    Returns:
        Shape (n_problems,).
    """
    whole = 2.0 * sums.sum(axis=1) - sums[:, :2].sum(axis=1) - sums[:, -2:].sum(axis=1)  # both half planes
    return np.asarray(np.add.reduceat(whole, starts) / np.float32(pixels), dtype=np.float32)


@compiled
def precondition(
    spectra: NDArray[np.float32],
    texture: NDArray[np.float32],
    white: NDArray[np.float32],
    inverse: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> None:
    """Replace the gradient for the pictures by the preconditioned descent, inverse (texture spectra - white).

    Args:
        spectra: shape (n, n_ky, 2 n_kx), transforms of the gradient; overwritten.
        texture: shape (n_ky, 2 n_kx), amplitude of the pictures, by which the unknowns are whitened.
        white: as ``spectra``, the unknowns.
        inverse: as ``spectra``, the preconditioner.
        sums: shape (n, 2 n_kx), becomes the products of the descent before and after, summed over ky.
    """
    for p in range(spectra.shape[0]):
        total = sums[p]
        total[:] = np.float32(0.0)
        for i in range(spectra.shape[1]):
            one, by, less, factor = spectra[p, i], texture[i], white[p, i], inverse[p, i]
            for j in range(one.size):
                descent = one[j] * by[j] - less[j]
                one[j] = factor[j] * descent
                total[j] += descent * one[j]


@compiled
def turn(
    scaled: NDArray[np.float32],
    ratio: NDArray[np.float32],
    direction: NDArray[np.float32],
    texture: NDArray[np.float32],
    textured: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> None:
    """Next direction, scaled + ratio direction, and the pictures along it, texture direction.

    Args:
        scaled: shape (n, n_ky, 2 n_kx), preconditioned descent.
        ratio: shape (n,).
        direction: as ``scaled``, overwritten.
        texture: shape (n_ky, 2 n_kx), amplitude of the pictures.
        textured: as ``scaled``, becomes the pictures' transforms.
        sums: shape (n, 2 n_kx), becomes the squares of the direction, summed over ky.
    """
    for p in range(scaled.shape[0]):
        total, share = sums[p], ratio[p]
        total[:] = np.float32(0.0)
        for i in range(scaled.shape[1]):
            by, to, light, add = texture[i], direction[p, i], textured[p, i], scaled[p, i]
            for j in range(to.size):
                to[j] = add[j] + share * to[j]
                light[j] = by[j] * to[j]
                total[j] += to[j] * to[j]


@compiled
def advance(to: NDArray[np.float32], length: NDArray[np.float32], change: NDArray[np.float32]) -> None:
    """Add the changes, shape (n, n_i, n_j), times a length each, shape (n,), to ``to``, shape (n, n_i, n_j)."""
    for p in range(to.shape[0]):
        for i in range(to.shape[1]):
            one, by = to[p, i], change[p, i]
            for j in range(one.size):
                one[j] += length[p] * by[j]
