"""Blur of surfaces whose depth changes from pixel to pixel, by PSFs that vary over depth and field.

The kernels of all calibrated depths and field points are expanded in one basis, b_k. Between the nodes their
coefficients are tensor-product cubic splines of vergence and direction, so that each pixel has coefficients c_k of its
own, and the image is sum_k b_k * (c_k f): one transform a basis kernel, however many depths the surface has.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blur import BASIS_TOLERANCE, DARK, VEIL_TOLERANCE, leading_count
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
    veil_count: int  #: Number of leading basis kernels that suffice for coverages.

    @classmethod
    def of(cls, kernels: PairKernels, polarisation: int) -> DepthBlur:
        """The blur; its basis leaves out a share of :data:`BASIS_TOLERANCE` of the energy of kernels of equal norm."""
        nodes = kernels.nodes[polarisation]
        table = nodes.reshape(-1, nodes.shape[-2] * nodes.shape[-1])
        norm = np.linalg.norm(table, axis=1, keepdims=True)
        scaled = table / np.maximum(norm, np.float32(np.finfo(np.float32).tiny))
        basis = _leading_vectors(scaled)
        veil_count = leading_count(((scaled @ basis.T) ** 2).sum(axis=0, dtype=np.float64), VEIL_TOLERANCE)
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
            veil_count,
        )

    def __call__(
        self, light: FloatArray, vergence_per_m: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray
    ) -> FloatArray:
        """Blur the light (electrons a pixel) of surfaces on one grid, zero outside, and add it up.

        Args:
            light: shape (n_surfaces, n_y, n_x).
            vergence_per_m: shape (n_surfaces, n_y, n_x), 1/depth of each pixel; any value where there is no light.
            tangent_x: shape (n_y, n_x), x/z of each pixel's direction; likewise ``tangent_y``.

        Returns:
            The full convolution, shape (n_y + k_y - 1, n_x + k_x - 1); pixel [0, 0] of the surfaces is at
            ``[k_y // 2, k_x // 2]``.
        """
        return self._blurred(light, vergence_per_m, tangent_x, tangent_y, len(self.basis))

    def mean_light(
        self, light: FloatArray, vergence_per_m: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray
    ) -> FloatArray:
        """Blur light by few basis kernels, for the factor of a correction; shapes are those of a call."""
        return self._blurred(light, vergence_per_m, tangent_x, tangent_y, self.veil_count)

    def coverage(
        self, share: FloatArray, vergence_per_m: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray
    ) -> FloatArray:
        """Blur visible shares of pixels by few basis kernels of sum 1; shapes are those of a call.

        Where one depth fills the view, the blurred share is 1.
        """
        where = np.nonzero(share)
        sums = self.basis[: self.veil_count].sum(axis=(-2, -1), dtype=np.float64)
        table = np.asarray((self.coefficients[..., : self.veil_count] @ sums)[..., None], dtype=np.float32)
        firsts, weights = self._splines(vergence_per_m[where], tangent_y[where[1:]], tangent_x[where[1:]])
        throughput, ones = np.empty((where[0].size, 1), dtype=np.float32), np.ones(where[0].size, dtype=np.float32)
        spread(_coefficients, ones.size, table, *firsts, *weights, ones, throughput)
        covered = np.zeros(share.shape)
        covered[where] = share[where] / np.maximum(throughput[:, 0], DARK)
        return self._blurred(covered, vergence_per_m, tangent_x, tangent_y, self.veil_count)

    def _splines(self, *places: FloatArray) -> tuple[tuple[NDArray[np.int32], ...], tuple[NDArray[np.float32], ...]]:
        """First nodes and weights along each axis at vergence, y/z and x/z of pixels, shape (n_pixels,) each."""
        splines = [axis.at(np.asarray(place)) for axis, place in zip(self.axes, places, strict=True)]
        firsts, weights = zip(*splines, strict=True)
        return firsts, weights

    def _blurred(
        self,
        light: FloatArray,
        vergence_per_m: FloatArray,
        tangent_x: FloatArray,
        tangent_y: FloatArray,
        count: int,
    ) -> FloatArray:
        """The blur by the leading ``count`` basis kernels; see :meth:`__call__`."""
        where = np.nonzero(light)
        full = tuple(n + k - 1 for n, k in zip(light.shape[1:], self.basis.shape[-2:], strict=True))
        if not where[0].size:
            return np.zeros(full)
        firsts, weights = self._splines(vergence_per_m[where], tangent_y[where[1:]], tangent_x[where[1:]])
        flux = light[where].astype(np.float32)
        fast = tuple(scipy.fft.next_fast_len(n, real=True) for n in full)
        total = np.zeros((fast[0], fast[1] // 2 + 1), dtype=np.complex64)
        ends = np.searchsorted(where[0], np.arange(len(light) + 1))
        of_surfaces = [slice(start, stop) for start, stop in itertools.pairwise(ends.tolist())]
        for first in range(0, count, _AT_ONCE):
            some = slice(first, min(first + _AT_ONCE, count))
            table = np.ascontiguousarray(self.coefficients[..., some])
            values = np.empty((flux.size, table.shape[-1]), dtype=np.float32)
            spread(_coefficients, flux.size, table, *firsts, *weights, flux, values)
            for kernel, column in zip(self.basis[some], values.T, strict=True):
                image = np.zeros(light.shape[1:], dtype=np.float32)
                for part in of_surfaces:
                    image[where[1][part], where[2][part]] += column[part]
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
