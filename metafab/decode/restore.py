"""All-in-focus images: each depth's blur undone by a Wiener filter, and composed by what depth a pixel has."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.calibration import Calibration, Transfer
from metafab.decode.levels import Levels


def sharpened(spectra: Transfer, calibration: Calibration, levels: Levels, vergence_per_m: float) -> FloatArray:
    """Both images as if all of them were at one depth: shape (2, n_y, n_x), electrons, not clipped.

    The filter H* / (|H|^2 + noise / texture) is the best linear one for a texture with the spectrum of
    :meth:`Levels.texture_spectrum` in white noise; it keeps the mean.
    """
    tiling = calibration.tiling
    ky, kx = scipy.fft.fftfreq(tiling.size[0])[:, None], scipy.fft.rfftfreq(tiling.size[1])[None, :]
    noise_to_signal = levels.noise_variance / np.maximum(levels.texture_spectrum(ky * ky + kx * kx), 1e-300)
    noise_to_signal[0, 0] = 0.0
    transfer = calibration.transfer(vergence_per_m)
    filters = np.conj(transfer) / (np.abs(transfer) ** 2 + noise_to_signal.astype(np.float32))
    tiles = scipy.fft.irfft2(spectra * filters, tiling.size)
    return np.stack([tiling.join(part) for part in tiles]).astype(np.float64)


def composed(layers: dict[int, FloatArray], label: NDArray[np.int32]) -> FloatArray:
    """One image pair from those of each label: shape (2, n_y, n_x), never negative."""
    images = np.zeros((2, *label.shape))
    for number, layer in layers.items():
        np.copyto(images, layer, where=label == number)
    return np.maximum(images, 0.0)
