"""Six images -> depth and the Stokes vector of every pixel.

Depth: of the images of two orthogonal states, each blurred by the other's kernel, both show the same texture where the
candidate depth is right; their local correlation, summed over the three pairs, peaks there. Stokes: at each depth the
six images are a linear function of the four parameters' images, one 6 x 4 matrix a frequency, which regularised least
squares invert, cross-talk between the places included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.stokes.camera import StokesFrame, kernels_at, spread
from metafab.stokes.spread import StokesPsf

_CANDIDATES = 25
_LAYERS = 9
_WINDOW_PX = 33
#: Below this correlation of the twins no depth is claimed.
_LEAST_AGREEMENT = 0.5


@dataclass(frozen=True)
class StokesImage:
    """What was decoded.

    Attributes:
        stokes: shape (4, n_y, n_x), electrons as in :class:`StokesFrame`.
        depth_m: shape (n_y, n_x), NaN where the twins do not agree at any depth.
        agreement: shape (n_y, n_x), mean correlation of the three pairs at that depth, -1 to 1.
    """

    stokes: FloatArray
    depth_m: FloatArray
    agreement: FloatArray


def decode_stokes(frame: StokesFrame, psf: StokesPsf) -> StokesImage:
    """Depth and Stokes vectors of a frame by the PSFs of six places, over the range of their depths."""
    vergences = np.linspace(1.0 / psf.depth_m[-1], 1.0 / psf.depth_m[0], _CANDIDATES)
    floor = 0.05 * float(np.percentile(frame.images.mean(axis=0), 99.0))
    agreement = np.stack([_agreement(frame.images, kernels_at(psf, 1.0 / v), floor) for v in vergences])
    best, height = _peak(agreement)
    found = np.interp(best, np.arange(_CANDIDATES), vergences)
    claimed = (height >= _LEAST_AGREEMENT) & (uniform_filter(frame.images.mean(axis=0), 3) > 4.0 * floor)
    depth_m = np.where(claimed, 1.0 / found, np.nan)
    return StokesImage(_restored(frame, psf, found), depth_m, height)


def _agreement(images: FloatArray, kernels: FloatArray, floor_e: float) -> FloatArray:
    """Mean over the pairs of the local correlation of the twins at one depth, shape (n_y, n_x)."""
    own = kernels[:, 0] / kernels[:, 0].sum(axis=(-2, -1), keepdims=True)
    crossed = spread(images, own[[1, 0, 3, 2, 5, 4]])
    total = np.zeros(images.shape[1:])
    for first, second in zip(crossed[::2], crossed[1::2], strict=True):
        means = [uniform_filter(part, _WINDOW_PX) for part in (first, second)]
        deviations = [part - mean for part, mean in zip((first, second), means, strict=True)]
        covariance = uniform_filter(deviations[0] * deviations[1], _WINDOW_PX)
        powers = [uniform_filter(d * d, _WINDOW_PX) for d in deviations]
        # A pair of which one state is dark says nothing: its correlation fades instead of being noise.
        total += covariance / (np.sqrt(powers[0] * powers[1]) + floor_e)
    return total / 3.0


def _peak(agreement: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Place (in candidates, between them by a parabola) and height of each pixel's highest agreement."""
    top = np.clip(agreement.argmax(axis=0), 1, agreement.shape[0] - 2)
    low, middle, high = (np.take_along_axis(agreement, (top + step)[None], axis=0)[0] for step in (-1, 0, 1))
    bend = np.minimum(low - 2.0 * middle + high, -1e-12)
    return top + np.clip(0.5 * (low - high) / bend, -1.0, 1.0), middle


def _restored(frame: StokesFrame, psf: StokesPsf, vergences: FloatArray) -> FloatArray:
    """Stokes images restored at several depths, between which each pixel takes its own share: shape (4, n_y, n_x)."""
    layers = np.linspace(vergences.min(), vergences.max(), _LAYERS)
    sharp = np.stack([_inverted(frame, kernels_at(psf, 1.0 / v)) for v in layers])
    span = max(float(layers[-1] - layers[0]), 1e-12)
    place = (vergences - layers[0]) / span * (_LAYERS - 1)
    lower = np.clip(np.floor(place).astype(np.intp), 0, _LAYERS - 2)
    share = place - lower
    rows, columns = np.indices(vergences.shape)
    return np.asarray(
        (1.0 - share) * sharp[lower, :, rows, columns].transpose(2, 0, 1)
        + share * sharp[lower + 1, :, rows, columns].transpose(2, 0, 1)
    )


def _inverted(frame: StokesFrame, kernels: FloatArray) -> FloatArray:
    """Least squares for all four parameters at one depth, with natural scenes' spectrum as prior: (4, n_y, n_x)."""
    n_y, n_x = frame.images.shape[-2:]
    margin = kernels.shape[-1] // 2
    shape = tuple(scipy.fft.next_fast_len(n + 2 * margin, real=True) for n in (n_y, n_x))
    mean = float(np.mean(frame.images))
    images = _spectrum(np.pad(frame.images, ((0, 0), (margin, margin), (margin, margin))), shape)
    transfer = scipy.fft.rfft2(kernels, shape)
    turn = np.exp(2j * np.pi * margin * np.add.outer(scipy.fft.fftfreq(shape[0]), scipy.fft.rfftfreq(shape[1])))
    transfer = np.moveaxis(transfer * turn, (0, 1), (-2, -1))
    noise = mean + frame.read_noise_e**2
    prior = _prior(shape, mean, frame.images) / noise
    adjoint = transfer.conj().swapaxes(-1, -2)
    normal = adjoint @ transfer + (1.0 / prior)[..., None, None] * np.eye(4)
    solved: Any = np.linalg.solve(normal, adjoint @ np.moveaxis(images, 0, -1)[..., None])
    sharp = scipy.fft.irfft2(np.moveaxis(solved[..., 0], -1, 0), shape)
    return np.asarray(sharp[:, margin : margin + n_y, margin : margin + n_x])


def _prior(shape: tuple[int, ...], mean: float, images: FloatArray) -> FloatArray:
    """Expected power of the scene at each frequency, per pixel: 1 / f^2 with the images' own variance."""
    frequency2 = scipy.fft.fftfreq(shape[0])[:, None] ** 2 + scipy.fft.rfftfreq(shape[1]) ** 2
    frequency2[0, 0] = (0.5 / max(shape)) ** 2
    falling = 1.0 / frequency2
    weight = np.full(shape[1] // 2 + 1, 2.0)
    weight[0] = 1.0
    level = float(np.var(images)) / (float((falling * weight).sum()) / (shape[0] * shape[1]))
    return np.asarray(np.maximum(level * falling, 1e-9 * mean**2 + 1e-30))


def _spectrum(images: FloatArray, shape: tuple[int, ...]) -> ComplexArray:
    return np.asarray(scipy.fft.rfft2(images, shape))


def stokes_errors(image: StokesImage, frame: StokesFrame) -> dict[str, float]:
    """Errors against the truth, over whole objects.

    Returns:
        ``nmae``: mean |z - z_true| / z_true where a depth is claimed; ``share_decoded``; ``stokes_rms``: rms over
        pixels of the error of each of (S1, S2, S3) / S0, windows of 9 x 9; ``stokes_object_error``: largest error of
        any object's (S1, S2, S3) / S0, and ``psnr_s0_db``.
    """
    known = np.isfinite(frame.depth_m)
    both = known & np.isfinite(image.depth_m)
    smooth = [uniform_filter(part, (0, 9, 9)) for part in (image.stokes, frame.stokes)]
    inner: NDArray[np.bool_] = uniform_filter(known.astype(float), 9) > 0.999
    normed = [part[1:] / np.maximum(part[0], 1e-9) for part in smooth]
    objects = []
    for number in np.unique(frame.label[frame.label > 0]):
        mask = frame.label == number
        got, true = (part[:, mask].sum(axis=1) for part in (image.stokes, frame.stokes))
        objects.append(float(np.abs(got[1:] / got[0] - true[1:] / true[0]).max()))
    mean_square = float(np.mean((image.stokes[0] - frame.stokes[0])[inner] ** 2))
    return {
        "nmae": float(np.mean(np.abs(image.depth_m[both] / frame.depth_m[both] - 1.0))) if both.any() else float("nan"),
        "share_decoded": float(both.sum() / max(1, known.sum())),
        "stokes_rms": float(np.sqrt(np.mean((normed[0] - normed[1])[:, inner] ** 2))),
        "stokes_object_error": max(objects, default=float("nan")),
        "psnr_s0_db": 10.0 * float(np.log10(frame.stokes[0].max() ** 2 / max(mean_square, 1e-30))),
    }
