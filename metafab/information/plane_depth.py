"""Depth of a plane of random texture from two images, and the Cramer-Rao bound of any such estimate.

One model serves every camera. At each spatial frequency the images hold one texture S, Gaussian with power P, behind
transfer functions h, and noise: v = h S + n. Depth changes only their covariance C = P h h^H + N: through the ratio of
the images (a helix pair, for any texture) and through their power (depth from defocus or a double helix, for a texture
of known spectrum only). Maximum likelihood uses both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.interpolation import parabolic_maximum
from metafab.information.texture import Texture

#: Trial contrasts of a plane, whose own contrast is unknown.
_CONTRASTS = (0.06, 0.1, 0.16, 0.25, 0.4, 0.63)
#: Contrast of the expected cepstra.
_CEPSTRUM_CONTRAST = 0.25
#: Frequencies below this many periods a window are left out: there the spectrum is that of the taper.
_LOWEST = 2.5
#: Range of quefrencies, pixels, in which the lobes of a double helix show; below lies the spectrum of the texture.
_QUEFRENCIES = (3.0, 28.0)


@dataclass(frozen=True)
class PlaneEstimator:
    """Estimator of the depth of a plane from square windows of two images."""

    depth_m: FloatArray  #: Shape (n_candidates,), candidate depths, evenly spaced in vergence, ascending.
    #: Shape (n_candidates, 2, n, n // 2 + 1), transfer functions of the pair on windows of n x n pixels.
    transfer: ComplexArray
    #: Spectrum of the texture, electrons and noise of a pixel; the contrast is unknown to the estimates.
    texture: Texture

    @classmethod
    def of(cls, depth_m: FloatArray, kernels: FloatArray, side_px: int, texture: Texture) -> PlaneEstimator:
        """Build the estimator from blur kernels, shape (n_candidates, 2, k, k), on windows of k pixels or more.

        Kernels are PSFs per pixel. The depths, shape (n_candidates,), are evenly spaced in vergence and ascend.
        """
        return cls(depth_m, scipy.fft.rfft2(kernels, (side_px, side_px)), texture)

    def likeliest(self, images: FloatArray) -> float:
        """Maximum-likelihood depth (m) of a plane from its images, shape (2, n, n), electrons."""
        return self.likeliest_of_spectra(self._spectra(images))

    def likeliest_of_spectra(self, spectra: ComplexArray) -> float:
        """Maximum-likelihood depth (m) of the spectra of two images, shape (2, n, n // 2 + 1).

        They are scaled so that white noise has the variance of a pixel.
        """
        matched = np.abs(np.einsum("cpij,pij->cij", self.transfer.conj(), spectra)) ** 2
        gain, cost = self._likelihood
        return self._peak((np.einsum("kcij,cij->kc", gain, matched, optimize=True) - cost).max(axis=0))

    @cached_property
    def _likelihood(self) -> tuple[FloatArray, FloatArray]:
        """Terms of the log likelihood: the gain per power of the matched spectrum, and log det C.

        Shapes (n_contrasts, n_candidates, n, n // 2 + 1) and (n_contrasts, n_candidates); C is noise and a matrix of
        rank one, so its inverse and determinant are closed forms.
        """
        noise_e2 = self.texture.noise_variance_e2
        power = np.stack([self._power(contrast) for contrast in _CONTRASTS])[:, None] / noise_e2
        signal = power * (np.abs(self.transfer) ** 2).sum(axis=1)
        weight = frequency_weight(self._side)
        gain = (weight * power / (1.0 + signal) / noise_e2).astype(np.float32)
        return gain, np.einsum("ij,kcij->kc", weight, np.log1p(signal))

    def by_cepstrum(self, images: FloatArray) -> float:
        """Depth (m) whose expected power cepstrum is nearest to that of the sum of two images, shape (2, n, n).

        Two lobes show the texture twice, which ripples its power spectrum. The logarithm separates the ripple from the
        spectrum of the texture; its transform, the cepstrum, peaks at the distance of the lobes.
        """
        power = np.abs(self._spectra(images).sum(axis=0)) ** 2
        ring, mean, expected = self._expected_cepstra
        measured = self._cepstrum(power)[ring] - mean
        return self._peak(-((expected - measured) ** 2).sum(axis=1))

    @cached_property
    def _expected_cepstra(self) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Quefrencies that depend on depth, their mean cepstrum over depths, and its deviation at each depth."""
        distance = np.hypot(*np.meshgrid(*[scipy.fft.fftfreq(self._side) * self._side] * 2))
        ring = (distance >= _QUEFRENCIES[0]) & (distance <= _QUEFRENCIES[1])
        signal = self._power(_CEPSTRUM_CONTRAST) * np.abs(self.transfer.sum(axis=1)) ** 2
        expected = self._cepstrum(signal + 2.0 * self.texture.noise_variance_e2)[:, ring]
        mean = expected.mean(axis=0)
        return ring, mean, expected - mean

    def _cepstrum(self, power: FloatArray) -> FloatArray:
        floor = 0.01 * self.texture.noise_variance_e2
        return np.asarray(scipy.fft.irfft2(np.log(power + floor), (self._side, self._side)))

    def bound_m(self, depth_m: float, contrast: float) -> float:
        """Cramer-Rao bound of the depth (m) of a plane whose texture has a known spectrum and contrast (rms over mean).

        Whittle's information: half the sum over frequencies of tr(C^-1 C' C^-1 C'), divided by the equivalent noise
        bandwidth of the taper. A window cut out of a larger picture does worse, because light from beyond its edges
        leaks through the taper. The nearest candidate stands for the depth.
        """
        index = int(np.clip(np.argmin(np.abs(self.depth_m - depth_m)), 1, self.depth_m.size - 2))
        transfer = np.moveaxis(self.transfer[index], 0, -1)
        step_m = self.depth_m[index + 1] - self.depth_m[index - 1]
        slope = np.moveaxis((self.transfer[index + 1] - self.transfer[index - 1]) / step_m, 0, -1)
        power = self._power(contrast)[..., None, None]
        change = np.einsum("ijp,ijq->ijpq", slope, transfer.conj())
        change = power * (change + change.conj().swapaxes(-1, -2))
        covariance = power * np.einsum("ijp,ijq->ijpq", transfer, transfer.conj())
        covariance += self.texture.noise_variance_e2 * np.eye(2)
        relative = np.linalg.solve(covariance, change)
        density = np.einsum("ijpq,ijqp->ij", relative, relative).real
        information = 0.5 * float((frequency_weight(self._side) * density).sum()) / noise_bandwidth(self._side)
        return float("inf") if information <= 0.0 else information**-0.5

    @property
    def _side(self) -> int:
        return int(self.transfer.shape[-2])

    def _power(self, contrast: float) -> FloatArray:
        """Power of the texture at a contrast, shape (n, n // 2 + 1), electrons^2."""
        return replace(self.texture, contrast=contrast).half_power(self._side)

    def _spectra(self, images: FloatArray) -> ComplexArray:
        """Spectra of tapered windows, shape (2, n, n // 2 + 1), scaled so that white noise keeps its variance."""
        taper = _taper(self._side)
        level = (images * taper).sum(axis=(-2, -1), keepdims=True) / taper.sum()
        return np.asarray(scipy.fft.rfft2((images - level) * taper) / np.sqrt((taper**2).sum()))

    def _peak(self, score: FloatArray) -> float:
        """Depth of the highest score, refined by a parabola through the neighbouring candidates."""
        place = parabolic_maximum(score)
        if math.isnan(place):
            return float(self.depth_m[np.argmax(score)])
        return 1.0 / float(np.interp(place, np.arange(score.size), 1.0 / self.depth_m))


def frequency_weight(side: int) -> FloatArray:
    """Multiplicity of each frequency of a half spectrum, shape (side, side // 2 + 1); 0 below the lowest one in use."""
    frequency = np.hypot(scipy.fft.fftfreq(side)[:, None], scipy.fft.rfftfreq(side)) * side
    weight = np.where(frequency >= _LOWEST, 2.0, 0.0)
    weight[:, 0] *= 0.5
    if side % 2 == 0:
        weight[:, -1] *= 0.5
    return weight


def noise_bandwidth(side: int) -> float:
    """Equivalent noise bandwidth of the taper: the number of neighbouring frequencies that count as one.

    sum w^4 / (sum w^2)^2, from the correlation of neighbouring periodogram values: (35/18)^2 = 3.78 for a Hann window.
    """
    taper = _taper(side)
    return float(side**2 * (taper**4).sum() / (taper**2).sum() ** 2)


def _taper(side: int) -> FloatArray:
    """Hann window over a square, shape (side, side)."""
    rise = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
    return np.outer(rise, rise)
