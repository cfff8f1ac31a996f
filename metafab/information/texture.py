"""Sources of light for depth bounds: a random texture with a 1/f spectrum and a point, each with its image noise.

The power of a texture falls as 1 / frequency^exponent (2 for natural scenes: Field, J. Opt. Soc. Am. A 4, 2379, 1987).
Photon noise, dark current and read noise are independent, so their variances add.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from metafab.core.conventions import FloatArray


@dataclass(frozen=True, kw_only=True)
class Texture:
    """A random texture of known spectrum and the noise of its image."""

    electrons: float = 3000.0  #: Mean of an image pixel.
    contrast: float = 0.25  #: Rms over mean of the texture, on the scale of the pixels and above.
    exponent: float = 2.0  #: The power falls as 1 / frequency^exponent; 0 is white.
    #: Mean of a pixel without the texture (stray light, dark current), electrons; adds photon noise.
    background_e: float = 0.0
    read_noise_e: float = 2.0  #: Standard deviation of the read noise, electrons.

    @property
    def noise_variance_e2(self) -> float:
        """Variance of a pixel: photon noise of texture and background, and read noise; electrons^2."""
        return self.electrons + self.background_e + self.read_noise_e**2

    def power(self, shape: tuple[int, int], extent: tuple[int, int] | None = None) -> FloatArray:
        """Power spectrum of the texture, electrons^2, on the frequencies of a DFT of ``shape``, zero frequency first.

        The mean over all frequencies is (electrons contrast)^2; the zero frequency has no power, because the mean
        brightness is unknown. ``extent`` is the shape over which the texture has its contrast, ``shape`` by default: in
        a larger one a part of the contrast belongs to structure that is wider than ``shape``.
        """
        spectrum = self._spectrum(shape)
        mean = spectrum.mean() if extent is None else self._spectrum(extent).mean()
        return np.asarray((self.electrons * self.contrast) ** 2 * spectrum / mean)

    def half_power(self, side_px: int) -> FloatArray:
        """The first columns of :meth:`power` of a square, as of a real transform: shape (side_px, side_px // 2 + 1)."""
        return self.power((side_px, side_px))[:, : side_px // 2 + 1]

    def signal_to_noise(self, shape: tuple[int, int], extent: tuple[int, int] | None = None) -> FloatArray:
        """Power of the texture over the power of the noise; arguments and shape as in :meth:`power`."""
        return self.power(shape, extent) / self.noise_variance_e2

    def _spectrum(self, shape: tuple[int, int]) -> FloatArray:
        """1 / frequency^exponent, without the zero frequency."""
        frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :])
        frequency[0, 0] = np.inf if self.exponent > 0.0 else 1.0
        spectrum = frequency**-self.exponent
        spectrum[0, 0] = 0.0
        return np.asarray(spectrum)


@dataclass(frozen=True, kw_only=True)
class PointSource:
    """A point source and the noise of its image."""

    electrons: float = 5000.0  #: Detected electrons per polarisation, if the whole PSF is caught.
    background_e: float = 5.0  #: Mean of a pixel without the source, electrons.
    read_noise_e: float = 2.0  #: Standard deviation of the read noise, electrons.


def restored_error(kernels: FloatArray, texture: Texture, *, side_px: int = 128) -> float:
    """Relative rms error of the best linear restoration of a texture: the sharpness that a set of PSFs allows.

    The Wiener filter for several images of one texture of power S leaves, at each spatial frequency, the share 1 / (1 +
    S sum_p |H_p|^2 / N_p) of S, where image p has the transfer function H_p and the noise power N_p. Transfer functions
    and photons alone decide, so a helix pair and a standard lens are measured alike (Supplementary 8 of Shen 2023
    compares them by pictures). 0 is a perfect restoration, 1 none.

    Args:
        kernels: shape (n_images, n, n), PSFs per pixel of simultaneous images; the sum of each is its share of the
            light at the sensor (at most 1).
        texture: spectrum; its ``electrons`` are the mean of a pixel of one image behind a kernel of sum 1.
        side_px: side of the picture whose frequencies are summed, pixels; at least n.
    """
    power = texture.power((side_px, side_px))
    gain = np.zeros_like(power)
    for kernel in kernels:
        transfer = scipy.fft.fft2(kernel, (side_px, side_px))
        noise = texture.electrons * float(kernel.sum()) + texture.background_e + texture.read_noise_e**2
        gain += np.abs(transfer) ** 2 / noise
    residual = power / (1.0 + power * gain)
    return float(np.sqrt(residual.mean() / power.mean()))
