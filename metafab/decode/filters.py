"""The filters that make twins equal at a candidate depth, computed once for a calibration.

Of an unknown texture with transform F, the frame holds Y_x = F H_x(z) and Y_y = c F H_y(z). Passing each image
through the *other's* transfer function gives F H_x H_y in both where z is right, and different pictures where it is
not. Divided by sqrt(|H_x|^2 + |H_y|^2), the residual of this comparison in white noise is the likelihood itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.progress import Progress
from metafab.decode.calibration import Calibration
from metafab.decode.levels import LOWEST_FREQUENCY, Levels
from metafab.decode.reduce import passband
from metafab.decode.tiles import Tiling
from metafab.decode.volume import Volume
from metafab.phase.information import Texture, twin_information

#: How much of itself (relative L2) the pair may change from the centre of a tile to its edge.
_TILE_CHANGE = 0.05
_SMALLEST_CORE_PX = 16
#: A window larger than this is not worth one transform.
_LARGEST_CORE_PX = 256
#: Finer structure is left out where all of it knows less than this share of what is known about depth.
_NEGLIGIBLE_SHARE = 0.35
#: (step, fewest pixels of a window that is worth it): small windows are cheap, and hold outlines above all.
_STEPS = ((4, 200_000), (2, 0))


@dataclass(frozen=True)
class CrossFilters:
    """Filters of both images at each candidate depth, on tiles of every ``every``-th pixel.

    Attributes:
        every: step of the pixels that are compared.
        tiling: tiles over those.
        vergences_per_m: shape (n_candidates,), 1/depth, equally spaced.
        bank: shape (n_candidates, 2, n_tiles, n_ky, n_kx), factors of the images' transforms.
        power: shape (n_ky, n_kx), mean of |H|^2 over depth and polarisation in the middle of the window.
    """

    every: int
    tiling: Tiling
    vergences_per_m: FloatArray
    bank: NDArray[np.complex64]
    power: FloatArray

    @classmethod
    def of(cls, calibration: Calibration, vergences_per_m: FloatArray) -> CrossFilters:
        """Filters of a calibration at candidate depths."""
        grid = calibration.grid
        every = coarsest_step(calibration)
        shape = (-(-grid.shape[0] // every), -(-grid.shape[1] // every))
        core = [min(max(px, _SMALLEST_CORE_PX), _LARGEST_CORE_PX) / every for px in calibration.core_px(_TILE_CHANGE)]
        tiling = Tiling.over(shape, grid.margin // every, (core[0], core[1]))
        ky, kx = _frequencies(tiling, every)
        depths = calibration.depth_weights(vergences_per_m)
        stack = calibration.stack
        n_y, n_x = stack.shape[-2:]
        along_y = np.exp(-2j * np.pi * ky[:, None] * (np.arange(n_y) - n_y // 2)).astype(np.complex64)
        along_x = np.exp(-2j * np.pi * kx[:, None] * (np.arange(n_x) - n_x // 2)).astype(np.complex64)
        nodes = along_y @ (stack @ along_x.T)  # (2, n_depth, n_field, n_ky, n_kx)
        weights = calibration.tile_weights(tiling, every)
        bank = np.empty((vergences_per_m.size, 2, tiling.n_tiles, ky.size, kx.size), dtype=np.complex64)
        power = np.zeros((ky.size, kx.size))
        for index, share in enumerate(depths):
            transfer = np.tensordot(weights, np.tensordot(share, nodes, axes=(0, 1)), axes=(1, 1)).swapaxes(0, 1)
            size = np.abs(transfer) ** 2
            power += size[:, tiling.n_tiles // 2].mean(axis=0) / depths.shape[0]
            bank[index] = transfer[::-1] * np.sqrt(2.0 / np.maximum(size.sum(axis=0), 1e-12))
        return cls(every, tiling, vergences_per_m, bank, power)

    @property
    def nbytes(self) -> int:
        """Memory of the filters."""
        return self.bank.nbytes + self.power.nbytes

    def volume(
        self,
        images: NDArray[np.float32],
        levels: Levels,
        lit: NDArray[np.bool_],
        progress: Progress,
        last: Volume | None = None,
    ) -> Volume:
        """Agreement of the twins at each candidate depth.

        Args:
            images: shape (2, n_y, n_x), every ``every``-th pixel of the twins with their margin.
            levels: noise and texture of the frame.
            lit: shape of the tiling's window, where there is light: other tiles are left out.
            progress: called after each candidate.
            last: agreement that is kept where no tile is lit.
        """
        tiling = self.tiling
        weight = self._weight(levels)
        tiles = tiling.touched(lit)
        held = ~tiling.covered(tiles)
        spectra = np.stack([scipy.fft.rfft2(tiling.cut(image, tiles), workers=2) for image in images]) * weight
        parts = np.empty((3, self.vergences_per_m.size, *tiling.shape), dtype=np.float32)
        for index, filters in enumerate(self.bank):
            aligned = scipy.fft.irfft2(spectra * filters[:, tiles], tiling.size, workers=2, overwrite_x=True)
            first, second = tiling.join(aligned, tiles)
            np.multiply(first, second, out=parts[0, index])
            np.multiply(first, first, out=parts[1, index])
            np.multiply(second, second, out=parts[2, index])
            if last is not None:
                np.copyto(parts[:, index], last.parts[:, index], where=held)
            progress("decode", index + 1, self.vergences_per_m.size)
        ky, kx = _frequencies(tiling, self.every)
        left = passband(self.every, ky)[:, None] * passband(self.every, kx)[None, :]
        share = (weight.astype(np.float64) * left) ** 2
        share[:, 1:-1] *= 2.0  # the other half plane
        total = tiling.size[0] * tiling.size[1]
        samples = float(share.sum() ** 2 / ((weight * left) ** 2 * share).sum() / total)
        return Volume(self.vergences_per_m, parts, samples, float(share.sum() / total) / self.every**2)

    def _weight(self, levels: Levels) -> NDArray[np.float32]:
        """Square root of what each frequency adds to the likelihood; nothing slower than a window."""
        ky, kx = _frequencies(self.tiling, self.every)
        k2 = ky[:, None] ** 2 + kx[None, :] ** 2
        signal = self.power * levels.texture_spectrum(k2)
        likelihood = signal / (levels.noise_variance + 2.0 * signal)
        left = passband(self.every, ky)[:, None] * passband(self.every, kx)[None, :]
        weight = np.sqrt(likelihood) * _high_pass(k2) / np.maximum(left, 0.25)
        weight[self.tiling.size[0] // 2] = 0.0
        weight[:, -1] = 0.0
        return np.asarray(weight / max(float(weight.max()), 1e-300), dtype=np.float32)


def coarsest_step(calibration: Calibration) -> int:
    """The largest step of pixels that keeps nearly all that the twins of a natural texture know about depth."""
    stack = calibration.stack
    field = stack.shape[2] // 2
    middle = float(np.median(1.0 / calibration.kernels.psf.depth_m))
    step = 1e-3 * middle
    low, at, high = (
        np.fft.fft2(np.tensordot(calibration.depth_weights(middle + d), stack[:, :, field], axes=(0, 1)))
        for d in (-step, 0.0, step)
    )
    signal_to_noise = Texture().signal_to_noise((at.shape[1], at.shape[2]))
    ky, kx = (np.abs(np.fft.fftfreq(n)) for n in at.shape[1:])
    k2 = ky[:, None] ** 2 + kx[None, :] ** 2
    signal_to_noise = signal_to_noise * _high_pass(k2)
    known = twin_information(at, high - low, signal_to_noise)
    for every, fewest in _STEPS:
        inside = (ky[:, None] < 0.5 / every) & (kx[None, :] < 0.5 / every)
        kept = twin_information(at, high - low, signal_to_noise * inside)
        if math.prod(calibration.grid.shape) >= fewest and kept >= (1.0 - _NEGLIGIBLE_SHARE) * known:
            return every
    return 1


def _frequencies(tiling: Tiling, every: int) -> tuple[FloatArray, FloatArray]:
    """Of a tile's transform along y and x, cycles a pixel of the frame."""
    return scipy.fft.fftfreq(tiling.size[0]) / every, scipy.fft.rfftfreq(tiling.size[1]) / every


def _high_pass(frequency_squared: FloatArray) -> FloatArray:
    """Suppresses what is slower than half a window: it varies with the light, and reaches far across outlines."""
    return np.asarray(frequency_squared / (frequency_squared + (4.0 * LOWEST_FREQUENCY) ** 2))
