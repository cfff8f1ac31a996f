"""Six images -> depth and the Stokes vector of every pixel.

Depth: of the images of two orthogonal states, each passed through the other's transfer function, both show the same
texture where the candidate depth is right. Their products, summed over the three pairs, are a volume like that of one
pair, from which segments and their depths follow as in :mod:`metafab.decode`. Stokes: at each depth the six images are
a linear function of the four parameters' images, one 6 x 4 matrix a frequency, which regularised least squares invert,
cross-talk between the places included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, uniform_filter

from metafab.camera.stokes import StokesFrame, kernels_at
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.decode.matching.cost_volume import Volume, correlation
from metafab.decode.matching.depth import PixelDepth, parabola, standard_error
from metafab.decode.matching.levels import LOWEST_FREQUENCY, Levels
from metafab.decode.matching.peaks import peaks
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation import segment as segments
from metafab.decode.segmentation.planes import Cells, Plane, fitted_plane
from metafab.decode.segmentation.regions import LAYER_SHARE
from metafab.optics.polarisation_states import StokesPsf

_CANDIDATES = 25
_LAYERS = 9
#: Side of the windows in which twins are compared; structure that is slower does not count.
_WINDOW_PX = 33
#: Below this correlation of the twins no depth is claimed.
_LEAST_AGREEMENT = 0.5
#: Share of the strongest frequency's power below which a frequency is not normalised: it is noise.
_FAINTEST = 1e-4
#: Structure slower than this many times the lowest frequency varies with the light, and reaches far across outlines.
_HIGH_PASS = 3.0
#: Pixels along an object's outline that its interior leaves out.
_OUTLINE_PX = 6
#: Share of the brightest from which a pixel is lit.
_LIT = 0.2


@dataclass(frozen=True)
class StokesImage:
    """What was decoded.

    Attributes:
        stokes: shape (4, n_y, n_x), electrons as in :class:`StokesFrame`.
        depth_m: shape (n_y, n_x), of the segment that a pixel belongs to; NaN where it is dark, or where the twins do
            not agree at any depth.
        agreement: shape (n_y, n_x), correlation of the three pairs' twins at that depth, -1 to 1.
    """

    stokes: FloatArray
    depth_m: FloatArray
    agreement: FloatArray


def decode_stokes(frame: StokesFrame, psf: StokesPsf) -> StokesImage:
    """Depth and Stokes vectors of a frame by the PSFs of six places, over the range of their depths."""
    volume = _volume(frame, psf)
    mean = frame.images.mean(axis=0)
    floor = _LIT * float(np.percentile(mean, 99.0))
    segment, planes = _segments(volume, uniform_filter(mean, 3) > floor)
    nodes = volume.vergences_per_m
    vergence = np.full(mean.shape, 0.5 * (nodes[0] + nodes[-1]))
    nearest = segments.grown(segment, float(sum(mean.shape)))
    for number, plane in enumerate(planes, start=1):
        np.copyto(vergence, np.clip(plane.over(mean.shape), nodes[0], nodes[-1]), where=nearest == number)
    stokes = _restored(frame, psf, vergence)
    # Blur reaches beyond outlines: only what is bright once it is sharp belongs to an object.
    shown = (segments.grown(segment, 0.5 * _WINDOW_PX) > 0) & (uniform_filter(stokes[0], 3) > floor)
    agreement = correlation(window_means(volume.at(vergence[None])[:, 0], _WINDOW_PX))
    return StokesImage(stokes, np.where(shown, 1.0 / vergence, np.nan), agreement.astype(np.float64))


def _volume(frame: StokesFrame, psf: StokesPsf) -> Volume:
    """Agreement of the twins at equally spaced vergences, all pairs together.

    Each image passes the other's transfer function, over the root of both their powers: in white noise, the residual of
    the comparison is the likelihood (:mod:`metafab.decode.matching.filters`), each frequency counting as it is above
    the noise.
    """
    vergences = np.linspace(1.0 / psf.depth_m[-1], 1.0 / psf.depth_m[0], _CANDIDATES)
    n_y, n_x = frame.images.shape[1:]
    margin = psf.psf.shape[-1]
    size = (scipy.fft.next_fast_len(n_y + margin, real=True), scipy.fft.next_fast_len(n_x + margin, real=True))
    spectra = scipy.fft.rfft2(frame.images, size)
    own = np.stack([kernels_at(psf, 1.0 / vergence)[:, 0] for vergence in vergences])
    transfer = scipy.fft.rfft2(_padded(own / own.sum(axis=(-2, -1), keepdims=True), size))
    power = np.abs(transfer) ** 2
    weight = _weight(frame, power.mean(axis=(0, 1)), size)
    parts = np.empty((3, _CANDIDATES, n_y, n_x), dtype=np.float32)
    for index, (of_images, powers) in enumerate(zip(transfer, power, strict=True)):
        total = np.repeat(powers[::2] + powers[1::2], 2, axis=0)
        other = of_images[[1, 0, 3, 2, 5, 4]]
        filters = other * (weight / np.sqrt(0.5 * total + _FAINTEST * total.max()))
        crossed = scipy.fft.irfft2(spectra * filters, size)[:, :n_y, :n_x]
        crossed -= uniform_filter(crossed, (0, _WINDOW_PX, _WINDOW_PX))
        first, second = crossed[::2], crossed[1::2]
        squares = uniform_filter(crossed * crossed, (0, _WINDOW_PX, _WINDOW_PX)) + np.finfo(np.float32).tiny
        # Twins of polarised light differ in brightness: each pair as if both had the mean; a dark one adds nothing.
        balance = np.sqrt(squares[1::2] / squares[::2])
        for part, product in enumerate((first * second, first * first * balance, second * second / balance)):
            parts[part, index] = product.sum(axis=0)
    share = _whole_plane(weight**2)
    samples = float(share.sum() ** 2 / (weight**2 * share).sum() / (size[0] * size[1]))
    return Volume(vergences, parts, 3.0 * samples, 3.0 * float(share.sum()) / (size[0] * size[1]))


def _padded(kernels: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Kernels with their origin in the middle, on a larger grid with it at [0, 0]."""
    n_y, n_x = kernels.shape[-2:]
    place = np.zeros((*kernels.shape[:-2], *size))
    place[..., :n_y, :n_x] = kernels
    return np.roll(place, (-(n_y // 2), -(n_x // 2)), axis=(-2, -1))


def _weight(frame: StokesFrame, power: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Root of what each frequency adds to the likelihood, at most 1, of natural texture behind a mean pair."""
    levels = Levels.of(frame.images, frame.read_noise_e)
    k2 = scipy.fft.fftfreq(size[0])[:, None] ** 2 + scipy.fft.rfftfreq(size[1]) ** 2
    signal = power * levels.texture_spectrum(k2)
    high_pass = k2 / (k2 + (_HIGH_PASS * LOWEST_FREQUENCY) ** 2)
    weight = high_pass * np.sqrt(2.0 * signal / (levels.noise_variance + 2.0 * signal))
    return np.asarray(np.maximum(weight, 1e-9))  # without light, all count the same


def _whole_plane(half: FloatArray) -> FloatArray:
    """Counts of a half plane's frequencies for the whole: those beside the edges stand for two."""
    doubled = half.copy()
    doubled[:, 1:-1] *= 2.0
    return doubled


def _pixels(volume: Volume, lit: NDArray[np.bool_]) -> PixelDepth:
    """The depth of each pixel by itself, from the window about it."""
    best, (below, at, above), _ = peaks(volume.parts, _WINDOW_PX)
    last = volume.vergences_per_m.size - 1
    shift, peak, curvature = parabola(below, at, above)
    vergence = volume.vergences_per_m[np.clip(best, 1, last - 1)] + volume.step_per_m * np.clip(shift, -1.0, 1.0)
    error = standard_error(peak, curvature / volume.step_per_m**2, _WINDOW_PX**2 * volume.samples) / vergence
    return PixelDepth(vergence, error, lit & (peak >= _LEAST_AGREEMENT) & (best > 0) & (best < last))


def _segments(volume: Volume, lit: NDArray[np.bool_]) -> tuple[NDArray[np.int32], list[Plane]]:
    """Number of each pixel's segment from 1 (0 for none), and the depth of each.

    Args:
        volume: agreement of the twins.
        lit: where there is light.
    """
    pixels = _pixels(volume, lit)
    separation = LAYER_SHARE * float(np.ptp(volume.vergences_per_m))
    layers = [Plane(vergence) for vergence in segments.depth_layers(pixels, separation).tolist()]
    label = np.zeros(lit.shape, dtype=np.int32)
    found: list[Plane] = []
    if not layers:
        return label, found
    parts = segments.split(segments.assign(volume, layers, pixels, separation, 1, lit), lit, _WINDOW_PX, 1)
    for number in range(1, int(parts.max(initial=0)) + 1):
        inner = segments.interior(parts, number, 1)
        depth = segments.segment_depth(volume, volume.over(inner.astype(np.int32), 1)[0], float(inner.sum()))
        if np.isfinite(depth.relative_error) and depth.correlation >= _LEAST_AGREEMENT:
            found.append(fitted_plane(Cells.of(volume, inner, 1)) or depth.plane)
            label[parts == number] = len(found)
    return label, found


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
        any object's (S1, S2, S3) / S0, ``stokes_interior_error``: the same without the 6 pixels along outlines, where
        blurred neighbours mix, and ``psnr_s0_db``.
    """
    known = np.isfinite(frame.depth_m)
    both = known & np.isfinite(image.depth_m)
    smooth = [uniform_filter(part, (0, 9, 9)) for part in (image.stokes, frame.stokes)]
    inner: NDArray[np.bool_] = uniform_filter(known.astype(float), 9) > 0.999
    normed = [part[1:] / np.maximum(part[0], 1e-9) for part in smooth]
    whole = [frame.label == number for number in np.unique(frame.label[frame.label > 0])]
    inside = [binary_erosion(mask, iterations=_OUTLINE_PX) for mask in whole]
    objects, interiors = ([_state_error(image, frame, mask) for mask in of if mask.any()] for of in (whole, inside))
    mean_square = float(np.mean((image.stokes[0] - frame.stokes[0])[inner] ** 2))
    return {
        "nmae": float(np.mean(np.abs(image.depth_m[both] / frame.depth_m[both] - 1.0))) if both.any() else float("nan"),
        "share_decoded": float(both.sum() / max(1, known.sum())),
        "stokes_rms": float(np.sqrt(np.mean((normed[0] - normed[1])[:, inner] ** 2))),
        "stokes_object_error": max(objects, default=float("nan")),
        "stokes_interior_error": max(interiors, default=float("nan")),
        "psnr_s0_db": 10.0 * float(np.log10(frame.stokes[0].max() ** 2 / max(mean_square, 1e-30))),
    }


def _state_error(image: StokesImage, frame: StokesFrame, mask: NDArray[np.bool_]) -> float:
    """Largest error of (S1, S2, S3) / S0 of some pixels together."""
    got, true = (part[:, mask].sum(axis=1) for part in (image.stokes, frame.stokes))
    return float(np.abs(got[1:] / got[0] - true[1:] / true[0]).max())
