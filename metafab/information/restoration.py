"""Residual error of the best linear restoration of a texture: the sharpness that a set of PSFs allows.

The Wiener filter for several images of one texture of power S leaves, at each spatial frequency, the share
1 / (1 + S sum_p |H_p|^2 / N_p) of S, where image p has the transfer function H_p and the noise power N_p. Transfer
functions and photons alone decide, so a helix pair and a standard lens are measured alike (Supplementary 8 of Shen
2023 compares them by pictures).
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from metafab.core.conventions import FloatArray
from metafab.information.texture import Texture


def restored_error(kernels: FloatArray, texture: Texture, *, side_px: int = 128) -> float:
    """Relative rms error that the Wiener filter leaves of a texture.

    Args:
        kernels: shape (n_images, n, n), PSFs per pixel of simultaneous images; the sum of each is its share of the
            light at the sensor (at most 1).
        texture: spectrum; its ``electrons`` are the mean of a pixel of one image behind a kernel of sum 1.
        side_px: side of the picture whose frequencies are summed, pixels; at least n.

    Returns:
        Rms error over the rms of the texture: 0 for a perfect restoration, 1 if nothing is restored.
    """
    power = texture.power((side_px, side_px))
    gain = np.zeros_like(power)
    for kernel in kernels:
        transfer = scipy.fft.fft2(kernel, (side_px, side_px))
        noise = texture.electrons * float(kernel.sum()) + texture.background_e + texture.read_noise_e**2
        gain += np.abs(transfer) ** 2 / noise
    residual = power / (1.0 + power * gain)
    return float(np.sqrt(residual.mean() / power.mean()))
