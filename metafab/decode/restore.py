"""All-in-focus images: each segment's blur undone by a Wiener filter for its depth, where it is."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numerics import HAS_NUMBA, compiled_parallel, prange
from metafab.decode.calibration import Calibration
from metafab.decode.levels import Levels
from metafab.decode.pooling import window_means
from metafab.decode.tiles import Tiling

#: How much of itself (relative L2) the pair may change from the centre of a tile to its edge.
_TILE_CHANGE = 0.2
_CORES_PX = (32.0, 256.0)
#: Transfer functions are kept for this many depths, the last used.
_KEPT_DEPTHS = 12
#: About as wide as a filter, whose noise is that of the light under it.
_NOISE_WINDOW_PX = 9
#: Their depths are a grid of this many steps over the calibrated range: less than a degree of the pair's turn.
_DEPTH_STEPS = 96


@dataclass(frozen=True)
class LitTiles:
    """The transformed tiles of a frame.

    Attributes:
        place: shape (n_tiles,), where each tile of the tiling is among the spectra, if it is.
        spectra: shape (2, n, n_ky, n_kx).
    """

    place: NDArray[np.intp]
    spectra: NDArray[np.complex64]


@dataclass(frozen=True)
class Sharp:
    """All-in-focus images.

    Attributes:
        images: shape (2, n_y, n_x), electrons.
        noise_gain: the same shape, variance of a pixel per variance of the frame's pixels about it.
    """

    images: NDArray[np.float32]
    noise_gain: NDArray[np.float32]

    def variance(self, read_noise_e: float) -> NDArray[np.float32]:
        """Of each pixel by photon and read noise: shape (2, n_y, n_x), electrons squared."""
        about = window_means(self.images, _NOISE_WINDOW_PX)
        return np.asarray(self.noise_gain * (about + np.float32(read_noise_e**2)))


@dataclass(frozen=True)
class Restorer:
    """Wiener filters of one calibration, tile by tile, and the transfer functions last used.

    Attributes:
        calibration: kernels on the grid.
        tiling: tiles of the window.
    """

    calibration: Calibration
    tiling: Tiling
    _kept: OrderedDict[int, NDArray[np.complex64]] = field(default_factory=OrderedDict, repr=False)

    @classmethod
    def of(cls, calibration: Calibration) -> Restorer:
        """Tiles where the pair varies over the field, one tile where it does not."""
        smallest, largest = _CORES_PX
        core = [
            np.inf if px > 16 * largest else min(max(px, smallest), largest) for px in calibration.core_px(_TILE_CHANGE)
        ]
        grid = calibration.grid
        return cls(calibration, Tiling.over(grid.shape, grid.margin, (core[0], core[1])))

    @property
    def nbytes(self) -> int:
        """Memory of the transfer functions that are kept."""
        return sum(transfer.nbytes for transfer in self._kept.values())

    def transformed(self, images: NDArray[np.float32], lit: NDArray[np.bool_]) -> LitTiles:
        """The tiles of both images that hold anything lit, as spectra.

        Args:
            images: shape (2, n_y + 2 margin, n_x + 2 margin), electrons a pixel.
            lit: shape (n_y, n_x).
        """
        tiles = self.tiling.touched(lit)
        place = np.zeros(self.tiling.n_tiles, dtype=np.intp)
        place[tiles] = np.arange(tiles.size)
        return LitTiles(place, np.stack([scipy.fft.rfft2(self.tiling.cut(image, tiles)) for image in images]))

    def __call__(self, seen: LitTiles, levels: Levels, label: NDArray[np.int32], vergences_per_m: FloatArray) -> Sharp:
        """Both images, sharp where ``label`` says at which depth they are; 0 where it is 0, never negative.

        The filter H* / (|H|^2 + noise / texture) is the best linear one for a texture with the spectrum of
        :meth:`Levels.texture_spectrum` in white noise; it keeps the mean.

        Args:
            seen: tiles that hold all of ``label``.
            levels: noise and texture of the frame.
            label: shape (n_y, n_x), number of each pixel's depth from 1.
            vergences_per_m: 1/depth of each number.

        Returns:
            The images, and what their filters make of the frame's noise.
        """
        tiling = self.tiling
        ky, kx = scipy.fft.fftfreq(tiling.size[0])[:, None], scipy.fft.rfftfreq(tiling.size[1])[None, :]
        noise_to_signal = levels.noise_variance / np.maximum(levels.texture_spectrum(ky * ky + kx * kx), 1e-300)
        noise_to_signal[0, 0] = 0.0
        ratio = noise_to_signal.astype(np.float32)
        sharp, noise_gain = np.zeros((2, 2, *tiling.shape), dtype=np.float32)
        for number, vergence in enumerate(vergences_per_m, start=1):
            mask = label == number
            tiles = tiling.touched(mask)
            if not tiles.size:
                continue
            filtered, gain = _wiener(self._transfer(float(vergence)), seen.spectra, ratio, tiles, seen.place[tiles])
            _paste(tiling, tiles, (tiling.cores(filtered), gain), mask, (sharp, noise_gain))
        return Sharp(sharp, noise_gain)

    def _transfer(self, vergence_per_m: float) -> NDArray[np.complex64]:
        """Transfer functions at the nearest depth of the grid: shape (2, n_tiles, n_ky, n_kx)."""
        inverse = 1.0 / self.calibration.kernels.psf.depth_m
        low, high = float(inverse.min()), float(inverse.max())
        step = round((vergence_per_m - low) / (high - low) * _DEPTH_STEPS)
        if step in self._kept:
            self._kept.move_to_end(step)
            return self._kept[step]
        nodes = np.tensordot(
            self.calibration.depth_weights(low + step * (high - low) / _DEPTH_STEPS),
            self.calibration.stack,
            axes=(0, 1),
        )
        n_y, n_x = nodes.shape[-2:]
        weights = self.calibration.tile_weights(self.tiling, 1)
        kernels = (weights @ nodes.reshape(2, nodes.shape[1], n_y * n_x)).reshape(2, -1, n_y, n_x)
        place = np.zeros((2, weights.shape[0], *self.tiling.size), dtype=np.float32)
        place[..., :n_y, :n_x] = kernels
        place = np.roll(place, (-(n_y // 2), -(n_x // 2)), axis=(-2, -1))
        self._kept[step] = np.asarray(scipy.fft.rfft2(place, workers=2), dtype=np.complex64)
        if len(self._kept) > _KEPT_DEPTHS:
            self._kept.popitem(last=False)
        return self._kept[step]


def _paste(
    tiling: Tiling,
    tiles: NDArray[np.intp],
    given: tuple[NDArray[np.float32], NDArray[np.float32]],
    mask: NDArray[np.bool_],
    out: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Put some tiles' cores (2, n, *core), nothing of them below 0, and a value of each (2, n) where ``mask`` holds."""
    (cores, value), (picture, values) = given, out
    if HAS_NUMBA:
        _paste_loop(cores, value, tiles, tiling.counts[1], mask, picture, values)
        return
    np.copyto(picture, np.maximum(tiling.join(cores, tiles), 0.0), where=mask)
    even = np.broadcast_to(value[..., None, None], cores.shape)
    np.copyto(values, tiling.join(even, tiles), where=mask)


@compiled_parallel
def _paste_loop(
    cores: NDArray[np.float32],
    value: NDArray[np.float32],
    tiles: NDArray[np.intp],
    columns: int,
    mask: NDArray[np.bool_],
    picture: NDArray[np.float32],
    values: NDArray[np.float32],
) -> None:
    n_y, n_x = mask.shape
    for t in prange(tiles.size):
        top, left = (tiles[t] // columns) * cores.shape[2], (tiles[t] % columns) * cores.shape[3]
        for image in range(2):
            for i in range(min(cores.shape[2], n_y - top)):
                for j in range(min(cores.shape[3], n_x - left)):
                    if mask[top + i, left + j]:
                        picture[image, top + i, left + j] = max(cores[image, t, i, j], np.float32(0.0))
                        values[image, top + i, left + j] = value[image, t]


def _wiener(
    transfer: NDArray[np.complex64],
    spectra: NDArray[np.complex64],
    ratio: NDArray[np.float32],
    tiles: NDArray[np.intp],
    place: NDArray[np.intp],
) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    """Spectra times H* / (|H|^2 + ratio), and what that makes of white noise.

    Args:
        transfer: H of all tiles, shape (2, n_tiles, n_ky, n_kx).
        spectra: of some tiles' images, shape (2, n, n_ky, n_kx).
        ratio: noise over texture, shape (n_ky, n_kx).
        tiles: the tiles that are wanted.
        place: where each of them is among the spectra.

    Returns:
        Shapes (2, tiles.size, n_ky, n_kx) and (2, tiles.size): mean squares of the filters.
    """
    return (_wiener_loop if HAS_NUMBA else _wiener_plain)(transfer, spectra, ratio, tiles, place)


def _wiener_plain(
    transfer: NDArray[np.complex64],
    spectra: NDArray[np.complex64],
    ratio: NDArray[np.float32],
    tiles: NDArray[np.intp],
    place: NDArray[np.intp],
) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    chosen = transfer[:, tiles]
    wiener = np.conj(chosen) / (chosen.real**2 + chosen.imag**2 + ratio)
    squares = np.abs(wiener) ** 2
    n_y, n_kx = ratio.shape
    # The other half plane; transforms have an even number of columns.
    total = 2.0 * squares.sum(axis=(-2, -1)) - squares[..., (0, -1)].sum(axis=(-2, -1))
    return np.asarray(wiener * spectra[:, place]), np.asarray(total / (n_y * 2 * (n_kx - 1)), dtype=np.float32)


@compiled_parallel
def _wiener_loop(
    transfer: NDArray[np.complex64],
    spectra: NDArray[np.complex64],
    ratio: NDArray[np.float32],
    tiles: NDArray[np.intp],
    place: NDArray[np.intp],
) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    _, _, n_y, n_x = transfer.shape
    out = np.empty((2, tiles.size, n_y, n_x), dtype=np.complex64)
    gain = np.zeros((2, tiles.size), dtype=np.float32)
    for t in prange(tiles.size):
        for image in range(2):
            total = 0.0
            for i in range(n_y):
                line = np.float32(0.0)
                for j in range(n_x):
                    h, s = transfer[image, tiles[t], i, j], spectra[image, place[t], i, j]
                    square = h.real * h.real + h.imag * h.imag
                    power = square + ratio[i, j]
                    real = (h.real * s.real + h.imag * s.imag) / power
                    out[image, t, i, j] = complex(real, (h.real * s.imag - h.imag * s.real) / power)
                    share = square / (power * power)
                    line += share if j == 0 or j == n_x - 1 else share + share
                total += float(line)
            gain[image, t] = total / (n_y * 2 * (n_x - 1))
    return out, gain
