"""What a pair of images of one unknown texture can tell about depth: Fisher information per spatial frequency.

At each frequency the two images hold the same unknown texture S behind two transfer functions, and noise: Y_j = O_j
S + n_j. With Gaussian texture of unknown power P, the information about depth that is left after P has taken its
share is

    J = 2 |b_x b_y' - b_y b_x'|^2 / (1 + |b_x|^2 + |b_y|^2),    b_j = O_j sqrt(P) / noise_j,

where ' is the derivative with respect to depth: only a change of the *ratio* of the two transfer functions counts.
For a conjugate pair O_y = conj(O_x) = |O| exp(-i alpha), and J = 8 (P |O|^2)^2 alpha'^2 / (1 + 2 P |O|^2): the
depth is in the phase. One image alone, a symmetric PSF (lens, double helix), or two equal ones give J = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray


@dataclass(frozen=True)
class Texture:
    """An unknown texture and the noise of its image.

    Attributes:
        electrons: mean of an image pixel.
        contrast: rms over mean of the texture, on the scale of the pixels and above.
        exponent: its power falls as 1 / frequency^exponent (2: natural scenes; 0: white).
        background_e: mean of a pixel that carries no picture (stray light, dark current); adds photon noise.
        read_noise_e: standard deviation of the read noise.
    """

    electrons: float = 3000.0
    contrast: float = 0.25
    exponent: float = 2.0
    background_e: float = 0.0
    read_noise_e: float = 2.0

    def signal_to_noise(self, shape: tuple[int, int], extent: tuple[int, int] | None = None) -> FloatArray:
        """Power of the texture over that of the noise at each frequency of a DFT of ``shape``, shape ``shape``.

        The mean over all frequencies is (electrons contrast)^2 / variance; the zero frequency has none: the mean
        brightness is not known.

        Args:
            shape: (n_y, n_x) pixels.
            extent: (n_y, n_x) pixels of the piece over which the texture has its contrast; ``shape`` by default. A
                larger piece has some of it in structure that ``shape`` does not hold.
        """
        power = self._spectrum(shape)
        mean = power.mean() if extent is None else self._spectrum(extent).mean()
        variance = self.electrons + self.background_e + self.read_noise_e**2
        return np.asarray((self.electrons * self.contrast) ** 2 / variance * power / mean)

    def _spectrum(self, shape: tuple[int, int]) -> FloatArray:
        """1 / frequency^exponent, without the zero frequency."""
        frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :])
        frequency[0, 0] = np.inf if self.exponent > 0.0 else 1.0
        power = frequency**-self.exponent
        power[0, 0] = 0.0
        return np.asarray(power)


@dataclass(frozen=True)
class PointSource:
    """A point source and the noise of its image.

    Attributes:
        electrons: detected from each polarisation if the whole PSF is caught.
        background_e: mean of a pixel without the source.
        read_noise_e: standard deviation of the read noise.
    """

    electrons: float = 5000.0
    background_e: float = 5.0
    read_noise_e: float = 2.0


def twin_information(
    transfer: ComplexArray, slope: ComplexArray, signal_to_noise: FloatArray, *, contrast_known: bool = False
) -> float:
    """Information about depth in the pair, summed over frequencies.

    Args:
        transfer: shape (2, n_y, n_x), DFT of both PSFs (all frequencies, zero first).
        slope: the same shape, its derivative with respect to depth.
        signal_to_noise: shape (n_y, n_x), power of the texture over that of the noise in either image.
        contrast_known: whether the brightness ratio of the two images is known; for a conjugate pair it makes no
            difference.

    Returns:
        Inverse square of the unit of depth.
    """
    mixed = signal_to_noise * (transfer[0] * slope[1] - transfer[1] * slope[0])
    ratio = signal_to_noise * transfer[0] * transfer[1]
    weight = 1.0 / (1.0 + signal_to_noise * (np.abs(transfer) ** 2).sum(axis=0))
    # Images are real: each frequency and its negative are one measurement, hence the halves.
    depth = float((np.abs(mixed) ** 2 * weight).sum())
    if contrast_known or depth == 0.0:
        return depth
    contrast = float((np.abs(ratio) ** 2 * weight).sum())
    cross = float(((mixed * ratio.conj()).real * weight).sum())
    return depth - cross**2 / contrast


def known_texture_information(slope: ComplexArray, signal_to_noise: FloatArray) -> float:
    """Information about depth in the pair if the texture were known, summed over frequencies: |b_x'|^2 + |b_y'|^2.

    Args:
        slope: shape (2, n_y, n_x), derivative of the DFT of both PSFs with respect to depth.
        signal_to_noise: shape (n_y, n_x), power of the texture over that of the noise in either image.

    Returns:
        Inverse square of the unit of depth; never less than :func:`twin_information`.
    """
    return float((signal_to_noise * (np.abs(slope) ** 2).sum(axis=0)).sum())
