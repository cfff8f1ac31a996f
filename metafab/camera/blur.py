"""Eq. 1 with a PSF that changes over the field: every object point spreads by its own direction's kernel.

The kernels of one depth are expanded in a few basis kernels (singular vectors over the field points): image =
sum_k b_k * (c_k f), with the coefficient maps c_k on the object's side. A layer costs one FFT a basis kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray

#: Share of the kernels' energy over the field that the basis may leave out.
BASIS_TOLERANCE = 1e-7


@dataclass(frozen=True)
class FieldBlur:
    """The blur of one depth and polarisation.

    Attributes:
        basis: shape (n_basis, n_y, n_x), basis kernels.
        coefficients: shape (n_field_y, n_field_x, n_basis), each field point's kernel in the basis.
        throughput: shape (n_field_y, n_field_x), sum of each field point's kernel.
        kernels: the calibration behind, for its field weights.
    """

    basis: FloatArray
    coefficients: FloatArray
    throughput: FloatArray
    kernels: PairKernels

    @classmethod
    def at_depth(cls, kernels: PairKernels, depth_m: float) -> tuple[FieldBlur, FieldBlur]:
        """The blurs of x and y polarisation."""
        x, y = (cls._of(kernels, nodes) for nodes in kernels.at_depth(depth_m))
        return x, y

    @classmethod
    def _of(cls, kernels: PairKernels, nodes: FloatArray) -> FieldBlur:
        n_field_y, n_field_x, n_y, n_x = nodes.shape
        table = nodes.reshape(n_field_y * n_field_x, n_y * n_x).astype(np.float64)
        left, singular, right = np.linalg.svd(table, full_matrices=False)
        energy = np.cumsum(singular**2)
        count = 1 + int(np.searchsorted(energy, (1.0 - BASIS_TOLERANCE) * energy[-1]))
        coefficients = (left[:, :count] * singular[:count]).reshape(n_field_y, n_field_x, count)
        return cls(right[:count].reshape(count, n_y, n_x), coefficients, nodes.sum(axis=(-2, -1)), kernels)

    def __call__(
        self, images: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray, *, normalised: bool = False
    ) -> FloatArray:
        """Blur a stack of images.

        Args:
            images: shape (n_images, n_y, n_x); zero outside.
            tangent_x: shape (n_y, n_x), direction of each pixel.
            tangent_y: shape (n_y, n_x).
            normalised: divide by the throughput, so that a sum over the plane is kept (for coverage).

        Returns:
            Shape (n_images, n_y + kernel - 1, n_x + kernel - 1): the full convolution; its pixel
            ``[kernel_n_y // 2, kernel_n_x // 2]`` is the images' pixel [0, 0].
        """
        weights = self.kernels.field_weights(tangent_x, tangent_y)
        maps = np.einsum("yxij,ijk->kyx", weights, self.coefficients, optimize=True)
        if normalised:
            maps = maps / np.einsum("yxij,ij->yx", weights, self.throughput)
        full = tuple(n + k - 1 for n, k in zip(images.shape[-2:], self.basis.shape[-2:], strict=True))
        fast = tuple(scipy.fft.next_fast_len(n, real=True) for n in full)
        total = np.zeros((images.shape[0], fast[0], fast[1] // 2 + 1), dtype=np.complex128)
        for kernel, coefficient in zip(self.basis, maps, strict=True):
            total += scipy.fft.rfft2(images * coefficient, fast) * scipy.fft.rfft2(kernel, fast)
        return np.asarray(scipy.fft.irfft2(total, fast)[:, : full[0], : full[1]])
