"""Light sources of the bounds: a random texture with a 1/f spectrum, and a point; both with the noise of their images.

The power of a texture falls as 1 / frequency^exponent (2 for natural scenes: Field, J. Opt. Soc. Am. A 4, 2379, 1987).
Photon noise, dark current and read noise are independent, so their variances add.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class Texture:
    """A random texture of known spectrum and the noise of its image.

    Attributes:
        electrons: mean of an image pixel.
        contrast: rms over mean of the texture, on the scale of the pixels and above.
        exponent: the power falls as 1 / frequency^exponent; 0 is white.
        background_e: mean of a pixel without the texture (stray light, dark current), electrons; adds photon noise.
        read_noise_e: standard deviation of the read noise, electrons.
    """

    electrons: float = 3000.0
    contrast: float = 0.25
    exponent: float = 2.0
    background_e: float = 0.0
    read_noise_e: float = 2.0

    @property
    def noise_variance_e2(self) -> float:
        """Variance of a pixel: photon noise of texture and background, and read noise; electrons^2."""
        return self.electrons + self.background_e + self.read_noise_e**2

    def power(self, shape: tuple[int, int], extent: tuple[int, int] | None = None) -> FloatArray:
        """Power spectrum of the texture.

        Args:
            shape: (n_y, n_x) pixels of the DFT.
            extent: (n_y, n_x) pixels over which the texture has its contrast; ``shape`` by default. In a larger
                extent a part of the contrast belongs to structure that is wider than ``shape``.

        Returns:
            Shape ``shape``, electrons^2, zero frequency first. The mean over all frequencies is
            (electrons contrast)^2. The zero frequency has no power, because the mean brightness is unknown.
        """
        spectrum = self._spectrum(shape)
        mean = spectrum.mean() if extent is None else self._spectrum(extent).mean()
        return np.asarray((self.electrons * self.contrast) ** 2 * spectrum / mean)

    def half_power(self, side_px: int) -> FloatArray:
        """Power spectrum of a square of ``side_px`` pixels on the frequencies of a real transform.

        Returns:
            Shape (side_px, side_px // 2 + 1), electrons^2: the first columns of :meth:`power`.
        """
        return self.power((side_px, side_px))[:, : side_px // 2 + 1]

    def signal_to_noise(self, shape: tuple[int, int], extent: tuple[int, int] | None = None) -> FloatArray:
        """Power of the texture over the power of the noise; arguments as in :meth:`power`.

        Returns:
            Shape ``shape``, zero frequency first.
        """
        return self.power(shape, extent) / self.noise_variance_e2

    def _spectrum(self, shape: tuple[int, int]) -> FloatArray:
        """1 / frequency^exponent, without the zero frequency."""
        frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :])
        frequency[0, 0] = np.inf if self.exponent > 0.0 else 1.0
        spectrum = frequency**-self.exponent
        spectrum[0, 0] = 0.0
        return np.asarray(spectrum)


@dataclass(frozen=True)
class PointSource:
    """A point source and the noise of its image.

    Attributes:
        electrons: detected electrons per polarisation, if the whole PSF is caught.
        background_e: mean of a pixel without the source, electrons.
        read_noise_e: standard deviation of the read noise, electrons.
    """

    electrons: float = 5000.0
    background_e: float = 5.0
    read_noise_e: float = 2.0
