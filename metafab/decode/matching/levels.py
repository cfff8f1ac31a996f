"""Brightness, noise and texture of a frame: the figures that matched and Wiener filters depend on; edges of light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray

#: Lowest frequency at which textures are compared, cycles a pixel.
LOWEST_FREQUENCY = 1.0 / 64.0
#: Cut-off of the high-pass, in lowest frequencies: slower structure varies with the light, and reaches across outlines.
_HIGH_PASS = 3.0
#: Rms contrast of the texture that filters are made for.
_TEXTURE_CONTRAST = 0.2
#: Error of the calibration, as a share of the texture: it adds to the noise where there are very many photons.
_MODEL_ERROR = 0.03
#: Light, over the mean, that is added before its logarithm is taken.
_ADDED_LIGHT = 0.05


@dataclass(frozen=True)
class Levels:
    """Typical figures of the lit pixels of a pair of images."""

    signal: float  #: Brightness, electrons a pixel; 0 for a dark frame.
    noise_variance: float  #: Variance of a pixel, electrons squared.
    texture_rms: float  #: Rms of the texture that filters are made for, electrons.
    #: Standard deviation of a pixel without light, electrons; with the photon noise of the pedestal.
    read_noise_e: float
    pedestal_e: float = 0.0  #: Light that forms no image, subtracted from the frame, electrons a pixel.

    @classmethod
    def of(cls, images: NDArray[np.floating[Any]], read_noise_e: float) -> Levels:
        """Measure the levels of images of shape (2, n_y, n_x)."""
        brightest = float(np.percentile(images, 99.0)) if images.size else 0.0
        floor = max(0.2 * brightest, 5.0 * read_noise_e)
        lit = images[images > floor]
        signal = float(np.mean(lit)) if lit.size else 0.0
        texture = _TEXTURE_CONTRAST * signal
        variance = max(signal, 0.0) + read_noise_e**2 + (_MODEL_ERROR * texture) ** 2
        return cls(signal, max(variance, 1e-12), texture, read_noise_e)

    def texture_spectrum(self, frequency_squared: FloatArray) -> FloatArray:
        """Expected power of the sharp image, electrons squared, with amplitude 1/k as in natural scenes.

        Squared frequencies, (cycles a pixel)^2, have any shape, which the power shares.
        """
        low = LOWEST_FREQUENCY**2
        return np.asarray(self.texture_rms**2 / (math.pi * math.log(0.25 / low)) / (frequency_squared + low))

    def likelihood_weight(self, power: FloatArray, frequency_squared: FloatArray) -> FloatArray:
        """Root of each frequency's share in the likelihood of a pair's depth, high-passed: 0 to 1.

        The mean squared transfer function of the pair and the squared frequency, (cycles a pixel)^2, have any one
        shape.
        """
        signal = power * self.texture_spectrum(frequency_squared)
        share = np.sqrt(2.0 * signal / (self.noise_variance + 2.0 * signal))
        return np.asarray(share * high_pass(frequency_squared))


def high_pass(frequency_squared: FloatArray) -> FloatArray:
    """Amplitude of the high-pass at squared frequencies of any shape, (cycles a pixel)^2: 0 to 1, the same shape."""
    return np.asarray(frequency_squared / (frequency_squared + (_HIGH_PASS * LOWEST_FREQUENCY) ** 2))


def log_light(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithm of pictures of light, of any shape; a share of their mean is added, so that darkness is even."""
    return np.asarray(np.log(np.maximum(light, 0.0) + np.float32(_ADDED_LIGHT) * light.mean() + np.float32(1e-9)))


def light_steps(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Changes of :func:`log_light` from each pixel to the next along y and along x, 0 for the last ones.

    Shape (2, n_pictures, n_y, n_x), for pictures of shape (n_pictures, n_y, n_x).
    """
    logarithm = log_light(light)
    return np.stack([np.diff(logarithm, axis=axis, append=logarithm.take([-1], axis=axis)) for axis in (1, 2)])
