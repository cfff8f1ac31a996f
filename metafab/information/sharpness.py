"""How sharp a texture can be restored through some PSFs: the all-in-focus quality.

The best linear restoration of a texture of known spectrum from images of the same scene through several PSFs leaves,
at each spatial frequency, the share 1 / (1 + S sum_p |H_p|^2 / N_p) of the texture's power S: the Wiener filter's. It
judges a helix pair and a standard lens alike, by their transfer functions and photons alone (Supplementary 8 of the
paper compares them by pictures).
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from metafab.core.conventions import FloatArray


def texture_power(side_px: int, electrons: float, contrast: float) -> FloatArray:
    """Power of a 1/f texture at each frequency, shape (n, n // 2 + 1), electrons^2: its mean square is the variance."""
    frequency2 = scipy.fft.fftfreq(side_px)[:, None] ** 2 + scipy.fft.rfftfreq(side_px) ** 2
    frequency2[0, 0] = np.inf
    power = 1.0 / frequency2
    return np.asarray(power * (contrast * electrons) ** 2 / _mean(power, side_px))


def restored_error(
    kernels: FloatArray, electrons: float, contrast: float, *, read_noise_e: float = 0.0, side_px: int = 128
) -> float:
    """Relative rms error that the best linear restoration of a texture leaves.

    Args:
        kernels: shape (n_images, n, n), PSFs per pixel, of the images that are taken at once; each sums to its share of
            the light that arrives at the sensor (at most 1).
        electrons: mean of a pixel behind a kernel of sum 1, per image.
        contrast: of the texture, rms over mean.
        read_noise_e: standard deviation of a pixel's read noise.
        side_px: frequencies are those of a picture of so many pixels a side, at least the kernels'.

    Returns:
        Rms error over the texture's rms: 0 perfect, 1 nothing restored.
    """
    power = texture_power(side_px, electrons, contrast)
    gain = np.zeros_like(power)
    for kernel in kernels:
        transfer = scipy.fft.rfft2(kernel, (side_px, side_px))
        noise = electrons * float(kernel.sum()) + read_noise_e**2
        gain += np.abs(transfer) ** 2 / noise
    left = power / (1.0 + power * gain)
    return float(np.sqrt(_mean(left, side_px) / _mean(power, side_px)))


def _mean(power: FloatArray, side_px: int) -> float:
    """Mean over all frequencies of a half spectrum."""
    weight = np.full(power.shape[-1], 2.0)
    weight[0] = 1.0
    if side_px % 2 == 0:
        weight[-1] = 1.0
    return float((power * weight).sum() / side_px**2)
