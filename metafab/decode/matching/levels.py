"""How bright, how noisy and how textured a frame is: what the filters need to know before anything is decoded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray

#: Textures are compared down to this frequency, cycles a pixel.
LOWEST_FREQUENCY = 1.0 / 64.0
_TEXTURE_CONTRAST = 0.2
#: No calibration is better than this: it stands in for noise where there are very many photons.
_MODEL_ERROR = 0.03


@dataclass(frozen=True)
class Levels:
    """Figures of a pair of images.

    Attributes:
        signal: typical brightness of what is lit, electrons a pixel (0 for a dark frame).
        noise_variance: typical variance of a lit pixel, electrons squared.
        texture_rms: rms of the texture that filters are made for, electrons.
        read_noise_e: standard deviation without light.
    """

    signal: float
    noise_variance: float
    texture_rms: float
    read_noise_e: float

    @classmethod
    def of(cls, images: NDArray[np.floating[Any]], read_noise_e: float) -> Levels:
        """Measure the levels of both images, shape (2, n_y, n_x)."""
        brightest = float(np.percentile(images, 99.0)) if images.size else 0.0
        floor = max(0.2 * brightest, 5.0 * read_noise_e)
        lit = images[images > floor]
        signal = float(np.mean(lit)) if lit.size else 0.0
        texture = _TEXTURE_CONTRAST * signal
        variance = max(signal, 0.0) + read_noise_e**2 + (_MODEL_ERROR * texture) ** 2
        return cls(signal, max(variance, 1e-12), texture, read_noise_e)

    def texture_spectrum(self, frequency_squared: FloatArray) -> FloatArray:
        """Expected power of the sharp image at a squared frequency (cycles a pixel): amplitude 1/k, as in nature."""
        low = LOWEST_FREQUENCY**2
        return np.asarray(self.texture_rms**2 / (math.pi * math.log(0.25 / low)) / (frequency_squared + low))
