"""Depth from the conjugate pair: undo the pair's phases at a candidate depth and see whether the twins agree.

Of an unknown texture with transform F, the frame holds F H_x(z) and c F H_y(z). Taking out the phases of H_x and
H_y leaves the same |H| F in both where z is right and rotates the twins against each other where it is not; in
white noise and |H_x| = |H_y| the residual of this comparison is the likelihood itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from metafab.core.conventions import FloatArray
from metafab.decode.calibration import Calibration, Tiling, Transfer, low_band
from metafab.decode.levels import LOWEST_FREQUENCY, Levels

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Agreement:
    """How well the twins agree at one depth: sums of products of the aligned images over a window or a segment.

    Attributes:
        cross: sum of a b; likewise ``first`` of a^2 and ``second`` of b^2; any shape.
    """

    cross: FloatArray
    first: FloatArray
    second: FloatArray

    @property
    def correlation(self) -> FloatArray:
        """Normalised cross-correlation: blind to the polarisation contrast, 1 for equal twins without noise."""
        # Roots before the product: sums of squares of a bright frame are near the end of single precision.
        norm = np.sqrt(np.maximum(self.first, 0.0)) * np.sqrt(np.maximum(self.second, 0.0))
        return np.asarray(self.cross / np.maximum(norm, 1e-15))


@dataclass(frozen=True)
class Aligner:
    """The twins' transforms, ready to be aligned at any depth.

    Only frequencies below a quarter cycle a pixel are used, at every second pixel: at 3000 electrons a pixel the
    others hold 0.3 % of the correlation and 3 % of what it knows about depth, for three quarters of the work.

    Attributes:
        calibration: transfer functions.
        tiling: tiles of every second pixel.
        spectra: shape (2, n_tiles, n_ky, n_kx), weighted transforms of the tiles.
        bandwidth: independent samples a pixel of the frame in the aligned images, 0 to 1.
        noise_gain: variance of an aligned image per variance of white noise in the frame.
    """

    calibration: Calibration
    tiling: Tiling
    spectra: Transfer
    bandwidth: float
    noise_gain: float

    @classmethod
    def of(cls, spectra: Transfer, calibration: Calibration, levels: Levels, whitening: float) -> Aligner:
        """Filters for the twins' ``spectra``.

        Args:
            spectra: of the tiles of both images.
            calibration: on the same grid.
            levels: noise and texture of the frame.
            whitening: 0 weighs frequencies by shot noise alone, which is best inside an object; 1 gives all of
                them the same power, which keeps strong edges from outshouting their surroundings.
        """
        depth_m = calibration.kernels.psf.depth_m
        middle = np.array([len(calibration.tiling.starts) // 2])
        some = (depth_m[0], float(np.median(depth_m)), depth_m[-1])
        # One weight for all depths, so that it cannot favour one of them.
        power = np.mean([np.abs(calibration.low_band_transfer(1.0 / z, middle)) ** 2 for z in some], axis=(0, 1, 2))
        tiling = calibration.tiling.halved()
        weight = _weight(power, tiling.size, levels, whitening)
        share = weight.astype(np.float64) ** 2
        share[:, 1:-1] *= 2.0  # the other half plane
        total = 4.0 * tiling.size[0] * tiling.size[1]
        bandwidth = float(share.sum() ** 2 / (weight.astype(np.float64) ** 2 * share).sum() / total)
        weighted = low_band(spectra) * (0.25 * weight)
        return cls(calibration, tiling, weighted, bandwidth, float(share.sum() / total))

    def aligned(self, vergence_per_m: float, tiles: NDArray[np.intp] | None = None) -> Image:
        """Both images' tiles with the pair's phases taken out: equal up to noise and contrast at the right depth.

        Returns:
            Shape (2, n_tiles, *tiling.size), of the tiles asked for (all by default).
        """
        spectra = self.spectra if tiles is None else self.spectra[:, tiles]
        transfer = self.calibration.low_band_transfer(vergence_per_m, tiles)
        phases = np.conj(transfer) / np.maximum(np.abs(transfer), np.float32(1e-9))
        return np.asarray(scipy.fft.irfft2(spectra * phases, self.tiling.size))

    def windows(self, vergence_per_m: float, window_px: int) -> Agreement:
        """Agreement in a square window (side in pixels of the frame) about every second pixel, as means."""
        first, second = (self.tiling.join(tiles) for tiles in self.aligned(vergence_per_m))
        parts = (first * second, first * first, second * second)
        return Agreement(*(uniform_filter(part, (window_px + 1) // 2, mode="reflect") for part in parts))

    def segment(self, vergence_per_m: float, mask: NDArray[np.bool_]) -> Agreement:
        """Agreement over the pixels of ``mask`` (the decoded window's shape)."""
        cores = self.tiling.cores(mask[::2, ::2])
        tiles = np.flatnonzero(cores.any(axis=(1, 2)))
        first, second = (self.tiling.core_of(part)[cores[tiles]] for part in self.aligned(vergence_per_m, tiles))
        return Agreement(
            *(np.asarray(np.sum(part, dtype=np.float64)) for part in (first * second, first**2, second**2))
        )


def doubled(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Values at every second pixel brought back to ``shape``, linear in between."""
    for axis, count in enumerate(shape):
        values = np.moveaxis(values, axis, 0)
        after = np.concatenate([values[1:], values[-1:]])
        pairs = np.stack([values, 0.5 * (values + after)], axis=1)
        values = np.moveaxis(pairs.reshape(-1, *values.shape[1:])[:count], 0, axis)
    return values


def _weight(power: FloatArray, size: tuple[int, int], levels: Levels, whitening: float) -> Image:
    """Square root of what each frequency adds to the likelihood, whitened; nothing slower than a window."""
    ky, kx = 0.5 * scipy.fft.fftfreq(size[0])[:, None], 0.5 * scipy.fft.rfftfreq(size[1])[None, :]
    k2 = ky * ky + kx * kx
    signal = power * levels.texture_spectrum(k2)
    likelihood = signal / (levels.noise_variance + 2.0 * signal)
    flattening = (signal + levels.noise_variance) ** (-whitening / 2.0)
    high_pass = k2 / (k2 + 4.0 * LOWEST_FREQUENCY**2)
    weight = np.sqrt(likelihood) * flattening * high_pass
    weight[size[0] // 2] = 0.0
    weight[:, -1] = 0.0
    return np.asarray(weight / max(float(weight.max()), 1e-300), dtype=np.float32)
