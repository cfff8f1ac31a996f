"""Low-rank basis of the matched filters: a few dozen kernels, of which all filters are mixtures."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from metafab.core.conventions import FloatArray
from metafab.core.numeric.spectra import transfer_functions
from metafab.decode.matching.levels import LOWEST_FREQUENCY, high_pass
from metafab.decode.registration.downsampling import Downsampling

#: Most basis kernels of an image.
_LARGEST_BASIS = 64
#: Number of sizes whose transforms are kept, those used last.
_KEPT_SIZES = 6


@dataclass(frozen=True)
class FilterBasis:
    """Basis kernels of the matched filters, and their transforms for the sizes that were used last."""

    kernels: NDArray[np.float32]  #: Shape (2, n_basis, m_y, m_x), basis of each image's filters; origin at [0, 0].
    #: Shape (m_y, m_x // 2 + 1), mean of |H|^2 over depth and polarisation in the middle of the window.
    power: FloatArray
    step: int  #: Frame pixels from one kernel pixel to the next.
    _transforms: OrderedDict[tuple[int, int], tuple[NDArray[np.complex64], FloatArray]] = field(
        default_factory=OrderedDict, init=False, repr=False, compare=False
    )

    @property
    def count(self) -> int:
        """Number of basis kernels."""
        return int(self.kernels.shape[1])

    @property
    def nbytes(self) -> int:
        """Memory of the kernels and of the transforms that are kept."""
        kept = sum(kernels.nbytes + power.nbytes for kernels, power in self._transforms.values())
        return self.kernels.nbytes + kept

    def transforms(self, downsampling: Downsampling) -> tuple[NDArray[np.complex64], FloatArray]:
        """Transforms of the kernels, shape (2, n_basis, n_ky, n_kx), and ``power`` there, shape (n_ky, n_kx)."""
        size = downsampling.size
        if size not in self._transforms:
            if len(self._transforms) >= _KEPT_SIZES:
                self._transforms.popitem(last=False)
            self._transforms[size] = _on_grid(self.kernels, size), self._power_at(downsampling)
        self._transforms.move_to_end(size)
        return self._transforms[size]

    def _power_at(self, downsampling: Downsampling) -> FloatArray:
        """``power`` at the frequencies of a transform, by linear interpolation."""
        nodes_y, nodes_x = frequencies((self.power.shape[0], 2 * (self.power.shape[1] - 1)), self.step)
        ky, kx = downsampling.frequencies
        order = np.argsort(nodes_y)
        spline = RectBivariateSpline(nodes_y[order], nodes_x, self.power[order], kx=1, ky=1)
        return np.asarray(spline(np.clip(ky, nodes_y.min(), nodes_y.max())[:, None], kx[None, :], grid=False))


def low_rank(
    filters: NDArray[np.complex64], power: FloatArray, step: int, error: float
) -> tuple[FilterBasis, NDArray[np.float32]]:
    """Factor filters into basis kernels and weights, by singular vectors.

    Args:
        filters: shape (2, n_candidates, n_field, m_y, m_x // 2 + 1), of every ``step``-th pixel.
        power: shape (m_y, m_x // 2 + 1), mean of |H|^2.
        step: frame pixels from one pixel to the next.
        error: relative L2 error of the filters, each frequency weighted as in the likelihood.

    Returns:
        The basis, and the weights of its kernels in each filter, shape (2, n_candidates, n_field, n_basis).
    """
    n_y, n_kx = filters.shape[-2:]
    size = (n_y, 2 * (n_kx - 1))
    ky, kx = frequencies(size, step)
    k2 = ky[:, None] ** 2 + kx[None, :] ** 2
    weight = np.sqrt(power / (k2 + LOWEST_FREQUENCY**2)) * high_pass(k2)
    weight[n_y // 2] = weight[:, -1] = 0.0
    weight[:, 1:-1] *= np.sqrt(2.0)
    columns = []
    for rows in (filters * weight).astype(np.complex64).reshape(2, -1, n_y * n_kx):
        columns.append(range_basis(np.concatenate([rows.real, rows.imag], axis=1), error))
    vectors = np.zeros((2, columns[0].shape[0], max(one.shape[1] for one in columns)), dtype=np.float32)
    for one, place in zip(columns, vectors, strict=True):
        place[:, : one.shape[1]] = one
    transfer = vectors.swapaxes(1, 2) @ filters.reshape(2, -1, n_y * n_kx)
    kernels = scipy.fft.irfft2(transfer.reshape(2, -1, n_y, n_kx), size)
    return FilterBasis(kernels.astype(np.float32), power, step), vectors.reshape(*filters.shape[:3], -1)


def range_basis(table: NDArray[np.float32], error: float) -> NDArray[np.float32]:
    """Smallest orthonormal basis of a table's columns within a relative L2 error, by randomised range finding.

    Halko, Martinsson and Tropp, SIAM Review 53, 217 (2011). A table of shape (n_rows, n_columns) gives the shape
    (n_rows, n_basis), at most 64 columns.
    """
    most = min(_LARGEST_BASIS, *table.shape)
    probes = np.random.default_rng(0).standard_normal((table.shape[1], most)).astype(np.float32)
    first, _ = np.linalg.qr(table @ probes)
    first, _ = np.linalg.qr(table @ (table.T @ first))
    left, singular, _ = np.linalg.svd(first.T @ table, full_matrices=False)
    missing = 1.0 - np.cumsum(singular.astype(np.float64) ** 2) / np.sum(table.astype(np.float64) ** 2)
    enough = np.flatnonzero(missing < error**2)
    count = int(enough[0]) + 1 if enough.size else most
    return np.asarray(first @ left[:, :count], dtype=np.float32)


def frequencies(size: tuple[int, int], step: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies of a real transform of ``size`` along y and x, shapes (n_ky,) and (n_kx,), cycles a frame pixel."""
    return scipy.fft.fftfreq(size[0]) / step, scipy.fft.rfftfreq(size[1]) / step


def _on_grid(kernels: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.complex64]:
    """Transforms of kernels, padded with zeros or cropped to ``size``."""
    n_y, n_x = (min(a, b) for a, b in zip(kernels.shape[-2:], size, strict=True))
    centred = np.roll(kernels, (n_y // 2, n_x // 2), axis=(-2, -1))[..., :n_y, :n_x]
    return np.asarray(transfer_functions(centred, size), dtype=np.complex64)
