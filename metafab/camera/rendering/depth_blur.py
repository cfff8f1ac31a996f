"""Blur of a surface whose depth changes from pixel to pixel, by PSFs that vary over depth and field.

The kernels of all calibrated depths and field points are expanded in one basis, b_k. Between the nodes their
coefficients are tensor-product cubic splines of vergence and direction, so that each pixel has coefficients c_k of its
own, and the image is sum_k b_k * (c_k f): one transform a basis kernel, however many depths the surface has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blur import BASIS_TOLERANCE
from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.interpolation import LocalSplines
from metafab.core.parallel.executor import spread

#: Columns of the first random sketch of the kernels: the pair of the paper's lens needs 89.
_SKETCH = 128
#: Basis kernels whose maps are made at a time: 64 bytes for each pixel.
_AT_ONCE = 16


@dataclass(frozen=True)
class DepthBlur:
    """The blur of one polarisation at all calibrated depths and field points."""

    basis: NDArray[np.float32]  #: Shape (n_basis, k_y, k_x), basis kernels.
    coefficients: NDArray[np.float32]  #: Shape (n_depth, n_field_y, n_field_x, n_basis), of the B-splines.
    axes: tuple[LocalSplines, LocalSplines, LocalSplines]  #: Of vergence, y/z and x/z.

    @classmethod
    def of(cls, kernels: PairKernels, polarisation: int) -> DepthBlur:
        """The blur; its basis leaves out a share of :data:`BASIS_TOLERANCE` of the energy of kernels of equal norm."""
        nodes = kernels.nodes[polarisation]
        table = nodes.reshape(-1, nodes.shape[-2] * nodes.shape[-1])
        norm = np.linalg.norm(table, axis=1, keepdims=True)
        basis = _leading_vectors(table / np.maximum(norm, np.float32(np.finfo(np.float32).tiny)))
        values = (table @ basis.T).reshape(*nodes.shape[:3], -1).astype(np.float64)
        places = 1.0 / kernels.psf.depth_m, kernels.tangent_y, kernels.tangent_x
        axes = []
        for axis, at in enumerate(places):
            splines, values = LocalSplines.fitted(at, values, axis)
            axes.append(splines)
        return cls(
            basis.reshape(-1, *nodes.shape[-2:]),
            np.ascontiguousarray(values, dtype=np.float32),
            (axes[0], axes[1], axes[2]),
        )

    def __call__(
        self, light: FloatArray, vergence_per_m: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray
    ) -> FloatArray:
        """Blur the light (electrons a pixel) of a surface, zero outside.

        Args:
            light: shape (n_y, n_x).
            vergence_per_m: shape (n_y, n_x), 1/depth of each pixel; any value where there is no light.
            tangent_x: shape (n_y, n_x), x/z of each pixel's direction; likewise ``tangent_y``.

        Returns:
            The full convolution, shape (n_y + k_y - 1, n_x + k_x - 1); pixel [0, 0] of the surface is at ``[k_y // 2,
            k_x // 2]``.
        """
        rows, columns = np.nonzero(light)
        full = tuple(n + k - 1 for n, k in zip(light.shape, self.basis.shape[-2:], strict=True))
        if not rows.size:
            return np.zeros(full)
        places = vergence_per_m[rows, columns], tangent_y[rows, columns], tangent_x[rows, columns]
        splines = [axis.at(np.asarray(place)) for axis, place in zip(self.axes, places, strict=True)]
        firsts, weights = zip(*splines, strict=True)
        flux = light[rows, columns].astype(np.float32)
        fast = tuple(scipy.fft.next_fast_len(n, real=True) for n in full)
        total = np.zeros((fast[0], fast[1] // 2 + 1), dtype=np.complex64)
        for first in range(0, len(self.basis), _AT_ONCE):
            table = np.ascontiguousarray(self.coefficients[..., first : first + _AT_ONCE])
            values = np.empty((flux.size, table.shape[-1]), dtype=np.float32)
            spread(_coefficients, flux.size, table, *firsts, *weights, flux, values)
            for kernel, column in zip(self.basis[first : first + _AT_ONCE], values.T, strict=True):
                image = np.zeros(light.shape, dtype=np.float32)
                image[rows, columns] = column
                # The kernel has few rows: those of zeros are not transformed along x.
                transfer = scipy.fft.fft(scipy.fft.rfft(kernel, fast[1]), fast[0], axis=0)
                total += scipy.fft.rfft2(image, fast) * transfer
        return np.asarray(scipy.fft.irfft2(total, fast)[: full[0], : full[1]], dtype=np.float64)


def _leading_vectors(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fewest orthonormal rows that hold all but :data:`BASIS_TOLERANCE` of the energy of ``table``, shape (n, m).

    The range is found by a random sketch with one power iteration (Halko, Martinsson and Tropp, SIAM Review 53, 217,
    2011), widened until it holds enough.
    """
    # In double precision: the tolerance is of the order of single precision's rounding.
    energy, width = float(np.einsum("ij,ij->", table, table, dtype=np.float64)), _SKETCH
    while True:
        width = min(width, *table.shape)
        sketch = np.random.default_rng(0).standard_normal((len(table), width), dtype=np.float32)
        rows = np.linalg.qr(table.T @ sketch)[0].T
        rows = np.linalg.qr(table.T @ (table @ rows.T))[0].T
        seen = (table @ rows.T).astype(np.float64)
        power, vectors = np.linalg.eigh(seen.T @ seen)
        lost = energy - np.cumsum(power[::-1])
        enough = np.flatnonzero(lost <= BASIS_TOLERANCE * energy)
        if enough.size or width == min(table.shape):
            count = int(enough[0]) + 1 if enough.size else width
            return np.asarray(vectors[:, ::-1][:, :count].T @ rows, dtype=np.float32)
        width *= 2


@compiled
def _coefficients(
    first: int,
    stop: int,
    table: NDArray[np.float32],
    at_z: NDArray[np.int32],
    at_y: NDArray[np.int32],
    at_x: NDArray[np.int32],
    along_z: NDArray[np.float32],
    along_y: NDArray[np.float32],
    along_x: NDArray[np.float32],
    flux: NDArray[np.float32],
    values: NDArray[np.float32],
) -> None:
    """Write the flux of each pixel times the splines of ``table``, (n_z, n_y, n_x, n), at its place: (n_pixels, n)."""
    count = table.shape[3]
    for pixel in range(first, stop):
        out = values[pixel]
        out[:] = 0.0
        for i in range(along_z.shape[1]):
            for j in range(along_y.shape[1]):
                weight_y = flux[pixel] * along_z[pixel, i] * along_y[pixel, j]
                for k in range(along_x.shape[1]):
                    weight = weight_y * along_x[pixel, k]
                    row = table[at_z[pixel] + i, at_y[pixel] + j, at_x[pixel] + k]
                    for n in range(count):
                        out[n] += weight * row[n]
