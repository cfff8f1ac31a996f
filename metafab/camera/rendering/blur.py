"""Eq. 1 with PSFs that vary over the field: each object point is convolved with the kernel of its direction.

The kernels of one depth are expanded in a few basis kernels b_k, singular vectors over the field points. The image is
sum_k b_k * (c_k f), with maps c_k of coefficients over the object f. A layer costs one FFT per basis kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray

#: Share of the kernels' energy over the field that the basis may leave out.
BASIS_TOLERANCE = 1e-6
#: Share that the basis of veils may leave out. A veil is the part of each pixel's view that a layer covers; it serves
#: only to correct the light at outlines.
VEIL_TOLERANCE = 1e-3
#: Directions whose field weights are computed at a time: they stay in the cache.
_BLOCK_PX = 4096
#: Smallest throughput that is divided by: darker kernels, of a ghost that is absent, hide nothing and show nothing.
DARK = 1e-30


@dataclass(frozen=True)
class FieldBlur:
    """The blur of one depth and polarisation."""

    basis: FloatArray  #: Shape (n_basis, n_y, n_x), basis kernels.
    coefficients: FloatArray  #: Shape (n_field_y, n_field_x, n_basis), coefficients of each field point's kernel.
    throughput: FloatArray  #: Shape (n_field_y, n_field_x), sum of each field point's kernel.
    veil_count: int  #: Number of leading basis kernels that suffice for veils.
    kernels: PairKernels  #: The calibration, for its field weights.

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
        count, veil_count = (leading_count(singular**2, share) for share in (BASIS_TOLERANCE, VEIL_TOLERANCE))
        coefficients = (left[:, :count] * singular[:count]).reshape(n_field_y, n_field_x, count)
        basis = right[:count].reshape(count, n_y, n_x).copy()  # A view would keep all of ``right``.
        return cls(basis, coefficients, nodes.sum(axis=(-2, -1)), veil_count, kernels)

    def __call__(self, light: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray) -> FloatArray:
        """Blur the light (electrons a pixel) of a layer, zero outside, by the kernels of its pixels' directions.

        Light and directions have the shape (n_y, n_x), the full convolution (n_y + k_y - 1, n_x + k_x - 1); the layer's
        pixel [0, 0] is at ``[k_y // 2, k_x // 2]``.
        """
        maps, _ = self._maps(tangent_x, tangent_y, len(self.basis))
        return np.asarray(self._spread(light[None], maps)[0])

    def veil(
        self,
        light: Sequence[FloatArray],
        coverage: Sequence[FloatArray],
        tangent_x: FloatArray,
        tangent_y: FloatArray,
    ) -> FloatArray:
        """Blur the light of layers and coverages at their depth with few basis kernels; shapes are those of a call.

        Coverages are blurred by kernels of sum 1, so that a layer that fills the view covers all of it.

        Returns:
            The light of the layers and, after it, the coverages, along the first axis.
        """
        maps, throughput = self._maps(tangent_x, tangent_y, self.veil_count)
        return self._spread(np.stack([*light, *(each / np.maximum(throughput, DARK) for each in coverage)]), maps)

    def _maps(self, tangent_x: FloatArray, tangent_y: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Coefficients of the leading basis kernels, (count, n_y, n_x), and throughput, (n_y, n_x), at directions."""
        table = np.concatenate([self.coefficients[..., :count], self.throughput[..., None]], axis=-1)
        maps = np.empty((count + 1, *tangent_x.shape))
        rows = max(1, _BLOCK_PX // tangent_x.shape[1])
        for first in range(0, len(tangent_x), rows):
            part = slice(first, first + rows)
            weights = self.kernels.field_weights(tangent_x[part], tangent_y[part])
            maps[:, part] = np.moveaxis(np.tensordot(weights, table, axes=2), -1, 0)
        return maps[:-1], maps[-1]

    def _spread(self, images: FloatArray, maps: FloatArray) -> FloatArray:
        """Convolutions of images (n, n_y, n_x) with the basis kernels, weighted over the field by their maps."""
        full = tuple(n + k - 1 for n, k in zip(images.shape[1:], self.basis.shape[-2:], strict=True))
        fast = tuple(scipy.fft.next_fast_len(n, real=True) for n in full)
        total = np.zeros((len(images), fast[0], fast[1] // 2 + 1), dtype=np.complex128)
        for kernel, coefficient in zip(self.basis, maps, strict=False):
            # The kernel has few rows: those of zeros are not transformed along x.
            transfer = scipy.fft.fft(scipy.fft.rfft(kernel, fast[1]), fast[0], axis=0)
            total += scipy.fft.rfft2(images * coefficient, fast) * transfer
        return np.asarray(scipy.fft.irfft2(total, fast)[:, : full[0], : full[1]])


def leading_count(energy: FloatArray, tolerance: float) -> int:
    """Number of leading basis kernels that leave out at most a share ``tolerance`` of the energy, shape (n_basis,)."""
    total = np.cumsum(energy)
    return 1 + int(np.searchsorted(total, (1.0 - tolerance) * total[-1]))
