"""Light of the layers of a scene in tiles of the downsampled images: its blur by the pair, the adjoint, its texture.

In a tile of some 120 frame pixels, the pair is that of the tile's middle and of a layer's depth there. All pairs of a
tile and a layer have transforms of one size and are computed at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.camera.rendering.windows import shifts_px_m
from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.spectra import transfer_functions
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.matching.levels import LOWEST_FREQUENCY
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.downsampling import Downsampling
from metafab.decode.registration.tiles import Tiling

#: Side of a tile's core, frame pixels.
_CORE_PX = 120.0
#: Distance on each side of a place over which the pair's change is taken, frame pixels.
_CHANGE_PX = 12.0
#: Size of the windows of downsampled kernels over that of the pair's.
_ROOM = 1.25


@dataclass(frozen=True)
class LayerLight:
    """Blur of the light of layers in tiles, for pairs of a tile and a layer; pictures are periodic."""

    of_tile: NDArray[np.intp]  #: Shape (n_pairs,), index of each pair's tile, ascending from 0.
    transfer: NDArray[np.complex64]  #: Shape (n_pairs, 2, n_ky, n_kx), transfer functions of both images.
    texture: NDArray[np.float32]  #: Shape (n_ky, n_kx), amplitude of a texture of unit variance and 1/k spectrum.

    @property
    def size(self) -> tuple[int, int]:
        """(n_y, n_x) of the pictures."""
        n_y, n_kx = self.texture.shape
        return n_y, 2 * (n_kx - 1)

    @cached_property
    def starts(self) -> NDArray[np.intp]:
        """First pair of each tile, shape (n_tiles,)."""
        return np.searchsorted(self.of_tile, np.arange(self.of_tile[-1] + 1))

    def rendered(self, light: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Both images of each tile, shape (n_tiles, 2, n_y, n_x), of the layers' light.

        ``light``: its transforms, shape (n_pairs, n_ky, n_kx).
        """
        images = np.zeros((self.of_tile[-1] + 1, *self.transfer.shape[1:]), dtype=np.complex64)
        add_blurred(light, self.transfer, self.of_tile, images)
        return self.pictures(images)

    def adjoint(self, images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Adjoint of :meth:`rendered`: shape (n_tiles, 2, n_y, n_x) to (n_pairs, n_y, n_x)."""
        spectra = np.empty(self.transfer[:, 0].shape, dtype=np.complex64)
        _correlate(self.spectra(images), self.transfer, self.of_tile, spectra)
        return self.pictures(spectra)

    @property
    def power(self) -> NDArray[np.float32]:
        """Sum of the squared transfer functions of both images, shape (n_pairs, n_ky, n_kx)."""
        return np.asarray((self.transfer.real**2 + self.transfer.imag**2).sum(axis=1))

    def spectra(self, pictures: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Transforms of pictures (..., n_y, n_x): shape (..., n_ky, n_kx)."""
        return np.asarray(scipy.fft.rfft2(pictures))

    def pictures(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Pictures of transforms (..., n_ky, n_kx), which are overwritten: shape (..., n_y, n_x)."""
        return np.asarray(scipy.fft.irfft2(spectra, self.size, overwrite_x=True))


@dataclass(frozen=True)
class LayerOptics:
    """The calibrated pair on the downsampled pixels, from which the blur of any layer is made."""

    calibration: Calibration  #: The pair on all pixels.
    downsampling: Downsampling  #: The pixels that are compared.
    kernels: NDArray[np.float32]  #: Shape (2, n_depth, n_field, m, m), origin at [m // 2, m // 2].
    tiling: Tiling  #: Tiles of the downsampled window.
    of_tiles: NDArray[np.float32]  #: Shape (n_tiles, n_depth, 2, m_y, m_x), the kernels at the middles of tiles.
    texture: NDArray[np.float32]  #: As of :class:`LayerLight`.

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
        kernels = np.empty((*stack.shape[:3], size, size), dtype=np.float32)
        for place in np.ndindex(stack.shape[:2]):  # one depth at a time, for its memory
            low = along_y @ (stack[place] @ along_x.T)
            low[..., size // 2, :] = 0.0
            low[..., -1] = 0.0
            kernels[place] = scipy.fft.irfft2(low, (size, size), overwrite_x=True)
        core = _CORE_PX / step
        tiling = Tiling.over(downsampling.shape, downsampling.margin, (core, core))
        # A tile of a small window may be smaller than the kernels.
        rows, columns = (slice((size - min(size, n)) // 2, (size + min(size, n)) // 2) for n in tiling.size)
        of_tiles = np.tensordot(calibration.tile_weights(tiling, step), kernels[..., rows, columns], axes=(1, 2))
        return cls(
            calibration,
            downsampling,
            kernels,
            tiling,
            np.ascontiguousarray(np.moveaxis(of_tiles, 1, 2)),
            texture_amplitude(tiling.size, step),
        )

    @property
    def nbytes(self) -> int:
        """Memory of the kernels."""
        return self.kernels.nbytes + self.of_tiles.nbytes + self.texture.nbytes

    def pair_about(self, middle: tuple[int, int], side: int) -> NDArray[np.complex64]:
        """Transforms of the pair at the calibrated depths about a downsampled pixel (row, column) of the window.

        Shape (n_depth, 2, side, side // 2 + 1); ``side`` is no smaller than that of the kernels.
        """
        row, column = self.downsampling.step * np.array(middle, dtype=np.float64)[:, None, None]
        return self._pairs(self.calibration.place_weights(row, column)[0], side)[:, 0]

    def pair_and_changes(self, middle: tuple[int, int], side: int) -> NDArray[np.complex64]:
        """That pair, and its changes from one downsampled pixel to the next along y and x.

        Shape (n_depth, 3, 2, side, side // 2 + 1).
        """
        step, apart = self.downsampling.step, _CHANGE_PX * np.array([[0, -1, 1, 0, 0], [0, 0, 0, -1, 1]])
        row, column = step * np.array(middle)[:, None] + apart
        at, above, below, left, right = self.calibration.place_weights(row[None], column[None])[0]
        share = np.float32(step / (2.0 * _CHANGE_PX))
        return self._pairs(np.stack([at, share * (below - above), share * (right - left)]), side)

    def _pairs(self, weights: NDArray[np.float32], side: int) -> NDArray[np.complex64]:
        """Transforms of mixtures of the field points' pairs, weights (n, n_field).

        Shape (n_depth, n, 2, side, side // 2 + 1).
        """
        kernels = np.tensordot(weights, self.kernels, axes=(1, 2)).transpose(2, 0, 1, 3, 4)
        return transfer_functions(kernels, (side, side)).astype(np.complex64)

    @cached_property
    def shifts_px_m(self) -> FloatArray:
        """Shift of an outline as seen from each point of the aperture, for 1/m between the vergences of two layers.

        Shape (n, 2): (columns, rows), downsampled pixels; (0, 0) where the calibration does not know the aperture.
        """
        grid = self.calibration.grid
        shifts = shifts_px_m(self.calibration.kernels.psf.aperture_um, grid.tangent_x, grid.tangent_y)
        return shifts / self.downsampling.step

    def light(
        self, tile: NDArray[np.intp], of_tile: NDArray[np.intp], vergence_per_m: FloatArray, gains: NDArray[np.float32]
    ) -> LayerLight:
        """The blur of layers in tiles, for pairs of a tile and a layer.

        Args:
            tile: shape (n_pairs,), number of each pair's tile in the tiling.
            of_tile: shape (n_pairs,), index of this tile among those that are used, ascending from 0.
            vergence_per_m: shape (n_pairs,), 1/depth of each pair's layer at the middle of the tile.
            gains: shape (n_pairs, 2), factors on both images.
        """
        share, shape = self.calibration.depth_weights(vergence_per_m), self.of_tiles.shape[2:]
        pairs = [one @ self.of_tiles[at].reshape(one.size, -1) for one, at in zip(share, tile.tolist(), strict=True)]
        kernels = np.stack(pairs).reshape(-1, *shape) * gains[:, :, None, None]
        transfer = transfer_functions(kernels, self.tiling.size).astype(np.complex64)
        return LayerLight(of_tile, transfer, self.texture)

    def aperture(self, vergence_per_m: float, size: tuple[int, int] | None = None) -> NDArray[np.complex64]:
        """Transfer function of the share of the aperture that a nearer layer covers, shape (n_ky, n_kx).

        ``vergence_per_m`` is that of the nearer layer, less that of the layer behind it; ``size``, (n_y, n_x) with an
        even n_y, is that of a tile by default.
        """
        rows, columns = size or self.tiling.size
        along_x, along_y = (
            _waves(vergence_per_m * shift, n) for shift, n in zip(self.shifts_px_m.T, (columns, rows), strict=True)
        )
        along_y = np.concatenate([along_y[:, :-1], along_y[:, :0:-1].conj()], axis=1)
        return np.asarray(along_y.T @ along_x / np.float32(len(along_x)))


def _waves(shift_px: FloatArray, size: int) -> NDArray[np.complex64]:
    """exp(2 pi i k shift) at the frequencies k from 0 to 1/2 of ``size`` pixels: shape (n, size // 2 + 1).

    Products of waves, in double precision: a tenth of the time of as many exponentials.
    """
    count = size // 2 + 1
    waves = np.empty((shift_px.size, count), dtype=np.complex128)
    waves[:, 0], first = 1.0, np.exp(2j * np.pi / size * shift_px)
    done = 1
    while done < count:
        more = min(done, count - done)
        np.multiply(waves[:, :more], (waves[:, done - 1] * first)[:, None], out=waves[:, done : done + more])
        done += more
    return waves.astype(np.complex64)


def at_depth(optics: LayerOptics, pair: NDArray[np.complex64], vergence_per_m: float) -> NDArray[np.complex64]:
    """The pair of :meth:`LayerOptics.pair_about`, shape (n_depth, ...), at one depth: shape (...)."""
    weights = optics.calibration.depth_weights(np.array([vergence_per_m]))[0]
    return np.asarray(np.tensordot(weights.astype(np.float32), pair, axes=(0, 0)))


def texture_amplitude(size: tuple[int, int], step: int) -> NDArray[np.float32]:
    """Amplitude of a texture of unit variance and 1/k spectrum on (n_y, n_x) pixels ``step`` frame pixels apart.

    Shape (n_y, n_x // 2 + 1).
    """
    ky, kx = frequencies(size, step)
    power = 1.0 / (ky[:, None] ** 2 + kx[None, :] ** 2 + LOWEST_FREQUENCY**2)
    both_halves = 2.0 * power.sum() - power[:, 0].sum() - power[:, -1].sum()
    return np.asarray(np.sqrt(power * (size[0] * size[1] / both_halves)), dtype=np.float32)


@compiled
def add_blurred(
    spectra: NDArray[np.complex64],
    transfer: NDArray[np.complex64],
    of_tile: NDArray[np.intp],
    images: NDArray[np.complex64],
) -> None:
    """Add spectra (n_pairs, n_ky, n_kx) times transfer functions to both images of their tiles."""
    for p in range(spectra.shape[0]):
        for image in range(2):
            for i in range(spectra.shape[1]):
                light, by, to = spectra[p, i], transfer[p, image, i], images[of_tile[p], image, i]
                for j in range(light.size):
                    a, b, c = light[j], by[j], to[j]
                    to[j] = complex(
                        c.real + (a.real * b.real - a.imag * b.imag), c.imag + (a.real * b.imag + a.imag * b.real)
                    )


@compiled
def _correlate(
    images: NDArray[np.complex64],
    transfer: NDArray[np.complex64],
    of_tile: NDArray[np.intp],
    spectra: NDArray[np.complex64],
) -> None:
    """Sum, for each pair, both images of its tile times the conjugate transfer functions."""
    for p in range(spectra.shape[0]):
        for i in range(spectra.shape[1]):
            x, y, to = images[of_tile[p], 0, i], images[of_tile[p], 1, i], spectra[p, i]
            by_x, by_y = transfer[p, 0, i], transfer[p, 1, i]
            for j in range(to.size):
                a, b, h, g = x[j], y[j], by_x[j], by_y[j]
                to[j] = complex(
                    a.real * h.real + a.imag * h.imag + (b.real * g.real + b.imag * g.imag),
                    a.imag * h.real - a.real * h.imag + (b.imag * g.real - b.real * g.imag),
                )
