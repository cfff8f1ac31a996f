"""Depth of a plane of random texture from its images, by whatever its PSFs tell, and the bound of any such estimate.

One model for every camera: at each spatial frequency the images hold one texture S, a Gaussian number of power P,
behind transfer functions h, and noise: v = h S + n. Their covariance C = P h h^H + N is all that depth changes, through
the ratio of the images (a helix pair, of any texture) and through their power (depth from defocus, a double helix: only
of a texture whose spectrum is known). The likeliest depth makes the most of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.camera.kernels import PairKernels
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.information.sharpness import texture_power

_CANDIDATES = 61
#: Contrasts that are tried: that of a plane is not known.
_CONTRASTS = (0.06, 0.1, 0.16, 0.25, 0.4, 0.63)
#: Frequencies below this many periods a window are those of the window itself.
_LOWEST = 2.5
#: Quefrencies, in pixels, in which lobes of a double helix show; below lies the texture's own spectrum.
_QUEFRENCIES = (3.0, 28.0)


@dataclass(frozen=True)
class PlaneEstimator:
    """Depth of planes from windows of a fixed size.

    Attributes:
        depth_m: shape (n_candidates,), depths that are tried, evenly spaced in vergence, ascending.
        transfer: shape (n_candidates, 2, n, n // 2 + 1), of the pair.
        electrons: mean of a pixel.
        noise_e2: variance of a pixel.
    """

    depth_m: FloatArray
    transfer: ComplexArray
    electrons: float
    noise_e2: float

    @classmethod
    def of(cls, kernels: PairKernels, side_px: int, electrons: float, read_noise_e: float) -> PlaneEstimator:
        """Estimates by a calibration, over all of its depths."""
        vergence = np.linspace(1.0 / kernels.psf.depth_m[0], 1.0 / kernels.psf.depth_m[-1], _CANDIDATES)
        pairs = np.stack([kernels.at_depth(1.0 / v)[:, 0, 0] for v in vergence])
        transfer = scipy.fft.rfft2(pairs, (side_px, side_px))
        return cls(1.0 / vergence, transfer, electrons, electrons + read_noise_e**2)

    def likeliest(self, images: FloatArray) -> float:
        """Depth at which two images, shape (2, n, n), electrons, are likeliest."""
        return self.likeliest_of_spectra(self._spectra(images))

    def likeliest_of_spectra(self, seen: ComplexArray) -> float:
        """The same for spectra, shape (2, n, n // 2 + 1), scaled so that white noise has the variance of a pixel."""
        matched = np.abs(np.einsum("cpij,pij->cij", self.transfer.conj(), seen)) ** 2
        gain, cost = self._model
        return self._peak((np.einsum("kcij,cij->kc", gain, matched, optimize=True) - cost).max(axis=0))

    @cached_property
    def _model(self) -> tuple[FloatArray, FloatArray]:
        """What a matched spectrum's power adds to the log likelihood, and what it costs, contrast by contrast.

        Shapes (n_contrasts, n_candidates, n, n // 2 + 1) and (n_contrasts, n_candidates): C^-1 and log det C of a
        covariance of rank one and noise.
        """
        side = self.transfer.shape[-2]
        power = np.stack([texture_power(side, self.electrons, c) for c in _CONTRASTS])[:, None] / self.noise_e2
        told = power * (np.abs(self.transfer) ** 2).sum(axis=1)
        weight = self._weight()
        gain = (weight * power / (1.0 + told) / self.noise_e2).astype(np.float32)
        return gain, np.einsum("ij,kcij->kc", weight, np.log1p(told))

    def by_cepstrum(self, images: FloatArray) -> float:
        """Depth whose PSF leaves the nearest trace in the power cepstrum of the images' sum.

        Two lobes print the texture twice, which ripples its power spectrum; the logarithm parts that ripple from the
        texture's spectrum, and its transform, the cepstrum, peaks at the distance of the lobes.
        """
        seen = np.abs(self._spectra(images).sum(axis=0)) ** 2
        ring, mean, traces = self._traces
        trace = self._cepstrum(seen)[ring] - mean
        return self._peak(-((traces - trace) ** 2).sum(axis=1))

    @cached_property
    def _traces(self) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Quefrencies that tell depth, the mean over depths of what is expected there, and how each depth differs."""
        side = self.transfer.shape[-2]
        place = np.hypot(*np.meshgrid(*[scipy.fft.fftfreq(side) * side] * 2))
        ring = (place >= _QUEFRENCIES[0]) & (place <= _QUEFRENCIES[1])
        power = texture_power(side, self.electrons, _CONTRASTS[3])
        expected = self._cepstrum(power * np.abs(self.transfer.sum(axis=1)) ** 2 + 2.0 * self.noise_e2)[:, ring]
        mean = expected.mean(axis=0)
        return ring, mean, expected - mean

    def _cepstrum(self, power: FloatArray) -> FloatArray:
        side = power.shape[-2]
        return np.asarray(scipy.fft.irfft2(np.log(power + 0.01 * self.noise_e2), (side, side)))

    def bound_m(self, depth_m: float, contrast: float) -> float:
        """Smallest standard deviation of depth from a plane whose texture's spectrum is known, and nothing else.

        Whittle's information: half the sum over frequencies of tr(C^-1 C' C^-1 C'), over the number of frequencies that
        a taper makes one. A window that is cut out of a larger picture does worse: what its taper lets in from beyond
        the edges is in no model.
        """
        index = int(np.clip(np.argmin(np.abs(self.depth_m - depth_m)), 1, self.depth_m.size - 2))
        here = self.transfer[index]
        step = self.depth_m[index + 1] - self.depth_m[index - 1]
        slope = (self.transfer[index + 1] - self.transfer[index - 1]) / step
        power = texture_power(here.shape[-2], self.electrons, contrast)
        turned = np.moveaxis(here, 0, -1), np.moveaxis(slope, 0, -1)
        outer = np.einsum("ijp,ijq->ijpq", turned[0], turned[0].conj())
        change = np.einsum("ijp,ijq->ijpq", turned[1], turned[0].conj())
        change = power[..., None, None] * (change + change.conj().swapaxes(-1, -2))
        covariance = power[..., None, None] * outer + self.noise_e2 * np.eye(2)
        relative = np.linalg.solve(covariance, change)
        told = np.einsum("ijpq,ijqp->ij", relative, relative).real
        information = 0.5 * float((self._weight() * told).sum()) / frequencies_in_one(here.shape[-2])
        return float("inf") if information <= 0.0 else information**-0.5

    def _spectra(self, images: FloatArray) -> ComplexArray:
        """Spectra of tapered windows, scaled so that white noise keeps its variance: shape (2, n, n // 2 + 1)."""
        side = images.shape[-1]
        taper = _taper(side)
        level = (images * taper).sum(axis=(-2, -1), keepdims=True) / taper.sum()
        return np.asarray(scipy.fft.rfft2((images - level) * taper) / np.sqrt((taper**2).sum()))

    def _weight(self) -> FloatArray:
        """How often each frequency of a half spectrum counts: shape (n, n // 2 + 1)."""
        side = self.transfer.shape[-2]
        frequency = np.hypot(scipy.fft.fftfreq(side)[:, None], scipy.fft.rfftfreq(side)) * side
        weight = np.where(frequency >= _LOWEST, 2.0, 0.0)
        weight[:, 0] *= 0.5
        if side % 2 == 0:
            weight[:, -1] *= 0.5
        return weight

    def _peak(self, score: FloatArray) -> float:
        """Depth of the highest score, between the candidates by a parabola."""
        top = int(np.argmax(score))
        if not 0 < top < score.size - 1:
            return float(self.depth_m[top])
        low, middle, high = score[top - 1 : top + 2]
        place = top + 0.5 * (low - high) / min(float(low - 2.0 * middle + high), -1e-12)
        return 1.0 / float(np.interp(place, np.arange(score.size), 1.0 / self.depth_m))


def _taper(side: int) -> FloatArray:
    """Hann's window over a square."""
    rise = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
    return np.outer(rise, rise)


def frequencies_in_one(side: int) -> float:
    """How many neighbouring frequencies of a tapered window tell as much as one: its equivalent noise bandwidth.

    (35/18)^2 = 3.78 for Hann's window; by the correlation of neighbouring periodogram values, sum w^4 / (sum w^2)^2.
    """
    taper = _taper(side)
    return float(side**2 * (taper**4).sum() / (taper**2).sum() ** 2)
