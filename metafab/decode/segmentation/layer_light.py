"""Light of one layer of a scene on the downsampled pixels: its blur by the pair, the adjoint, and its texture.

The pair changes over the field, and over the depths of a tilted layer. Its kernels at the calibrated points are
expanded in a few basis kernels of least squares error over the layer's pixels (Karhunen-Loeve), so that a blur costs
one transform for each of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from metafab.camera.rendering.windows import shifts_px_m
from metafab.core.conventions import FloatArray
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.matching.levels import LOWEST_FREQUENCY
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.downsampling import Downsampling

#: Share of the pair that the basis kernels of a layer may leave out (rms), and most of them.
_LEFT_OUT, _MOST_BASIS = 0.08, 8
#: Size of the windows of downsampled kernels over that of the pair's.
_ROOM = 1.25
#: Side of the blocks at whose centres the pair is computed, frame pixels.
_BLOCK_PX = 24
#: Relative change of vergence over a layer from which its kernels change over it.
_TILT = 2e-3

Part = tuple[slice, slice]


@dataclass(frozen=True)
class LayerLight:
    """Blur of the light of one layer, on a part of the downsampled images with margin."""

    at: Part  #: The part: rows and columns.
    size: tuple[int, int]  #: (n_y, n_x) of the transforms: the part and the reach of blur.
    weights: NDArray[np.float32]  #: Shape (n_basis, n_y, n_x), share of each basis kernel at each pixel.
    transfer: NDArray[np.complex64]  #: Shape (n_basis, 2, n_ky, n_kx), transforms of the basis kernels of both images.
    texture: NDArray[np.float32]  #: Shape (n_ky, n_kx), amplitude of a texture of unit variance and 1/k spectrum.

    @property
    def shape(self) -> tuple[int, int]:
        """(n_y, n_x) of the part."""
        return self.weights.shape[-2], self.weights.shape[-1]

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return self.weights.nbytes + self.transfer.nbytes + self.texture.nbytes

    def blurred(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Both images of light of shape (n_y, n_x): shape (2, n_y, n_x)."""
        spread = self._transform(self.weights * light)
        return self._picture((spread[:, None] * self.transfer).sum(axis=0))

    def adjoint(self, images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Adjoint of :meth:`blurred`: shape (2, n_y, n_x) to (n_y, n_x)."""
        gathered = (self._transform(images)[None] * self.transfer.conj()).sum(axis=1)
        return np.asarray((self.weights * self._picture(gathered)).sum(axis=0))

    def filtered(self, picture: NDArray[np.float32], response: NDArray[np.float32]) -> NDArray[np.float32]:
        """A picture (n_y, n_x) filtered by a real response of shape (n_ky, n_kx): the same shape."""
        return self._picture(response * self._transform(picture))

    def power(self, gains: FloatArray) -> FloatArray:
        """Squared transfer function of the mean kernel, images weighted by the squares of ``gains``, shape (2,).

        Returns:
            Shape (n_ky, n_kx).
        """
        mean = np.tensordot(self.weights.mean(axis=(1, 2)), self.transfer, axes=(0, 0))
        return np.asarray(np.tensordot(gains**2, mean.real**2 + mean.imag**2, axes=(0, 0)))

    def _transform(self, pictures: NDArray[np.float32]) -> NDArray[np.complex64]:
        return np.asarray(scipy.fft.rfft2(pictures, self.size))

    def _picture(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        rows, columns = self.shape
        return np.asarray(scipy.fft.irfft2(spectra, self.size)[..., :rows, :columns])


@dataclass(frozen=True)
class LayerOptics:
    """The calibrated pair on the downsampled pixels, from which the blur of any layer is made."""

    calibration: Calibration  #: The pair on all pixels.
    downsampling: Downsampling  #: The pixels that are compared.
    kernels: NDArray[np.float32]  #: Shape (2, n_depth, n_field, m, m), origin at [m // 2, m // 2].
    field_weights: NDArray[np.float32]  #: Shape (n_block_y, n_block_x, n_field), at the blocks' centres.

    @classmethod
    def of(cls, calibration: Calibration, downsampling: Downsampling) -> LayerOptics:
        """Downsample the kernels of a calibration by their low frequencies."""
        stack, step = calibration.stack, downsampling.step
        size = 2 * math.ceil(_ROOM * max(stack.shape[-2:]) / (2 * step))
        ky, kx = frequencies((size, size), step)
        # The origin of the downsampled kernels is moved to the middle of their window.
        along_y, along_x = (
            np.exp(-2j * np.pi * k[:, None] * (np.arange(n) - n // 2 + step * (size // 2))).astype(np.complex64)
            for k, n in ((ky, stack.shape[-2]), (kx, stack.shape[-1]))
        )
        low = along_y @ (stack @ along_x.T)
        low[..., size // 2, :] = 0.0
        low[..., -1] = 0.0
        block = _BLOCK_PX // step
        return cls(
            calibration,
            downsampling,
            scipy.fft.irfft2(low, (size, size)).astype(np.float32),
            calibration.block_weights(downsampling.shape, step, block),
        )

    @property
    def nbytes(self) -> int:
        """Memory of the kernels."""
        return self.kernels.nbytes + self.field_weights.nbytes

    @property
    def reach(self) -> int:
        """Distance up to which a layer's light is blurred, downsampled pixels."""
        rows, columns = self.calibration.stack.shape[-2:]
        return int(max(rows, columns)) // (2 * self.downsampling.step)

    def shifts_px_m(self) -> FloatArray:
        """Shift of an outline as seen from each point of the aperture, for 1/m between the vergences of two layers.

        Returns:
            Shape (n, 2): (columns, rows), downsampled pixels; (0, 0) where the calibration does not know the aperture.
        """
        grid = self.calibration.grid
        shifts = shifts_px_m(self.calibration.kernels.psf.aperture_um, grid.tangent_x, grid.tangent_y)
        return shifts / self.downsampling.step

    def layer(self, vergence_per_m: FloatArray, support: NDArray[np.bool_]) -> LayerLight:
        """The blur of a layer.

        Args:
            vergence_per_m: shape (n_y, n_x) of the window without margin, 1/depth of the layer's plane.
            support: shape of the images with margin, pixels that may hold light of the layer; at least one.
        """
        at, margin = self._part(support), self.downsampling.margin
        rows, columns = (at[0].stop - at[0].start, at[1].stop - at[1].start)
        block = _BLOCK_PX // self.downsampling.step
        place = [
            np.clip((np.arange(one.start, one.stop) - margin - 0.5 * (block - 1)) / block, 0.0, n - 1.0)
            for one, n in zip(at, self.field_weights.shape, strict=False)
        ]
        first, last = ([int(one[end]) for one in place] for end in (0, -1))
        blocks = tuple(slice(a, min(b + 2, n)) for a, b, n in zip(first, last, self.field_weights.shape, strict=False))
        shares, kernels = self._points(vergence_per_m, blocks, block)
        used = np.sqrt((shares**2).mean(axis=0)) + 1e-6
        scaled = used[:, None] * kernels.reshape(len(used), -1)
        power, vectors = np.linalg.eigh((scaled @ scaled.T).astype(np.float64))
        left_out = np.cumsum(np.maximum(power, 0.0))
        count = min(_MOST_BASIS, int((left_out > _LEFT_OUT**2 * left_out[-1]).sum()))
        basis = vectors[:, ::-1][:, :count]
        at_blocks = np.tensordot(shares, basis / used[:, None], axes=(1, 0)).reshape(
            *(one.stop - one.start for one in blocks), count
        )
        grid = np.meshgrid(*(one - one_first for one, one_first in zip(place, first, strict=True)), indexing="ij")
        weights = np.stack([map_coordinates(at_blocks[..., k], grid, order=1, mode="nearest") for k in range(count)])
        shape = kernels.shape[-2:]
        size = (max(_even(rows + self.reach), shape[0]), max(_even(columns + self.reach), shape[1]))
        padded = np.zeros((count, 2, *size), dtype=np.float32)
        padded[..., : shape[0], : shape[1]] = (basis.T @ scaled).reshape(count, 2, *shape)
        rolled = np.roll(padded, (-(shape[0] // 2), -(shape[1] // 2)), axis=(-2, -1))
        return LayerLight(
            at,
            size,
            np.ascontiguousarray(weights, dtype=np.float32),
            scipy.fft.rfft2(rolled).astype(np.complex64),
            _texture_amplitude(size, self.downsampling.step),
        )

    def _part(self, support: NDArray[np.bool_]) -> Part:
        """The part of the images that light of ``support`` reaches."""
        lines = np.flatnonzero(support.any(axis=1)), np.flatnonzero(support.any(axis=0))
        rows, columns = (
            slice(max(0, int(line[0]) - self.reach), min(n, int(line[-1]) + self.reach + 1))
            for line, n in zip(lines, support.shape, strict=True)
        )
        return rows, columns

    def _points(
        self, vergence_per_m: FloatArray, blocks: tuple[slice, ...], block: int
    ) -> tuple[FloatArray, NDArray[np.float32]]:
        """Shares of calibrated points in the kernels of blocks, shape (n_blocks, n_points), and those points' kernels.

        Returns:
            The shares, and kernels of shape (n_points, 2, m, m).
        """
        places = [
            np.minimum(((np.arange(one.start, one.stop) + 0.5) * block).astype(int), n - 1)
            for one, n in zip(blocks, vergence_per_m.shape, strict=True)
        ]
        vergence = vergence_per_m[np.ix_(*places)].ravel()
        tilted = vergence.max() > (1.0 + _TILT) * vergence.min()
        of_depth = self.calibration.depth_weights(vergence if tilted else np.array([vergence.mean()]))
        of_field = self.field_weights[blocks].reshape(vergence.size, -1)
        kernels = np.moveaxis(self.kernels, 0, 2)
        if tilted:
            shares = (of_depth[:, :, None] * of_field[:, None, :]).reshape(vergence.size, -1)
            return np.asarray(shares, dtype=np.float64), kernels.reshape(-1, *kernels.shape[2:])
        middle = np.tensordot(of_depth[0].astype(np.float32), kernels, axes=(0, 0))
        return np.asarray(of_field, dtype=np.float64), np.asarray(middle)


def _even(count: int) -> int:
    """A fast, even length of a transform of at least ``count``."""
    return int(2 * scipy.fft.next_fast_len(-(-count // 2), real=True))


def _texture_amplitude(size: tuple[int, int], step: int) -> NDArray[np.float32]:
    ky, kx = frequencies(size, step)
    power = 1.0 / (ky[:, None] ** 2 + kx[None, :] ** 2 + LOWEST_FREQUENCY**2)
    both_halves = 2.0 * power.sum() - power[:, 0].sum() - power[:, -1].sum()
    return np.asarray(np.sqrt(power * (size[0] * size[1] / both_halves)), dtype=np.float32)
