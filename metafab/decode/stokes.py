"""Six images of orthogonal pairs of polarisation states -> depth and Stokes vector of every pixel.

Depth: the images of two orthogonal states show the same texture once each is filtered by the other's transfer function
for the right depth. The products of the three pairs add up to one cost volume, from which segments and their depths
follow as in the decoder of two images. Stokes vectors: at each frequency and depth, the six images are a 6 x 4 matrix
times the four Stokes parameters. Regularised least squares invert it, cross-talk between the images included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, map_coordinates, uniform_filter

from metafab.camera.stokes import StokesFrame, kernels_at
from metafab.core.conventions import FloatArray
from metafab.core.numeric.spectra import independent_samples, transfer_functions
from metafab.core.polarisation import ORTHOGONAL
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import window_depth
from metafab.decode.matching.levels import Levels
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.layers import assign_layers, connected_segments, depth_layers, grown
from metafab.decode.segmentation.planes import Cells, Plane, fit_plane
from metafab.decode.segmentation.segment_depth import interior, segment_depth
from metafab.decode.segmentation.surfaces import layer_separation_per_m
from metafab.optics.polarisation_states import StokesPsf

#: Candidate depths of the cost volume, and depths at which the images are inverted.
_CANDIDATES, _INVERTED_DEPTHS = 25, 9
#: Side of the windows in which images are compared, pixels; coarser structure is filtered out.
_WINDOW_PX = 33
#: Least correlation of the pairs at which a depth is claimed.
_LEAST_CORRELATION = 0.5
#: Share of the strongest frequency's power that regularises the filters: weaker frequencies hold noise.
_FAINTEST = 1e-4
#: Least weight of a frequency, so that all count equally in a dark frame.
_DARK_WEIGHT = 1e-9
#: Least brightness of a lit pixel, over the 99th percentile of the frame.
_LIT = 0.2
#: Pixels along outlines that do not count to an object's interior, and side of the windows of the rms error.
_OUTLINE_PX, _ERROR_WINDOW_PX = 6, 9


@dataclass(frozen=True)
class StokesImage:
    """Decoded depth and polarisation."""

    stokes: FloatArray  #: Shape (4, n_y, n_x), Stokes parameters in electrons, as in :class:`StokesFrame`.
    #: Shape (n_y, n_x), depth of each pixel's segment; NaN where it is dark or the pairs agree at no depth.
    depth_m: FloatArray
    agreement: FloatArray  #: Shape (n_y, n_x), correlation of the three pairs at that depth, -1 to 1.


@dataclass(frozen=True)
class StokesErrors:
    """Errors of a decoded image against the truth."""

    nmae: float  #: Mean of |z - z_true| / z_true where a depth is claimed; NaN without any.
    share_decoded: float  #: Share of the objects' pixels with a claimed depth.
    stokes_rms: float  #: Rms error of (S1, S2, S3) / S0 in windows of 9 x 9 pixels within objects.
    stokes_object_error: float  #: Largest error of any object's (S1, S2, S3) / S0.
    #: Largest error of any object without the 6 pixels along outlines, where blurred neighbours mix.
    stokes_interior_error: float
    psnr_s0_db: float  #: Peak signal-to-noise ratio of S0 within objects.


def decode_stokes(frame: StokesFrame, psf: StokesPsf) -> StokesImage:
    """Decode depth and Stokes vectors of a frame, over the range of depths of the PSFs."""
    volume = _cost_volume(frame, psf)
    mean = frame.images.mean(axis=0)
    least_lit = _LIT * float(np.percentile(mean, 99.0))
    segment, planes = _segments(volume, uniform_filter(mean, 3) > least_lit)
    nodes = volume.vergences_per_m
    vergence = np.full(mean.shape, 0.5 * (nodes[0] + nodes[-1]))
    nearest = grown(segment)
    for number, plane in enumerate(planes, start=1):
        np.copyto(vergence, np.clip(plane.over(mean.shape), nodes[0], nodes[-1]), where=nearest == number)
    stokes = _stokes_parameters(frame, psf, vergence)
    # Blur reaches beyond outlines: only what is bright in the sharp image belongs to an object.
    shown = (grown(segment, 0.5 * _WINDOW_PX) > 0) & (uniform_filter(stokes[0], 3) > least_lit)
    agreement = correlation(window_means(volume.at(vergence[None])[:, 0], _WINDOW_PX))
    return StokesImage(stokes, np.where(shown, 1.0 / vergence, np.nan), agreement.astype(np.float64))


def _cost_volume(frame: StokesFrame, psf: StokesPsf) -> CostVolume:
    """Sum of the three pairs' products at equally spaced vergences.

    Each image is filtered by the other's transfer function over the root of their mean power. In white noise the
    residual of this comparison is the likelihood (:mod:`metafab.decode.matching.filters`).
    """
    vergences = np.linspace(1.0 / psf.depth_m[-1], 1.0 / psf.depth_m[0], _CANDIDATES)
    n_y, n_x = frame.images.shape[1:]
    margin = psf.psf.shape[-1]
    size = (scipy.fft.next_fast_len(n_y + margin, real=True), scipy.fft.next_fast_len(n_x + margin, real=True))
    spectra = scipy.fft.rfft2(frame.images, size)
    unpolarised = np.stack([kernels_at(psf, 1.0 / vergence)[:, 0] for vergence in vergences])
    transfer = transfer_functions(unpolarised / unpolarised.sum(axis=(-2, -1), keepdims=True), size)
    power = np.abs(transfer) ** 2
    frequency_squared = scipy.fft.fftfreq(size[0])[:, None] ** 2 + scipy.fft.rfftfreq(size[1]) ** 2
    levels = Levels.of(frame.images, frame.read_noise_e)
    weight = np.maximum(levels.likelihood_weight(power.mean(axis=(0, 1)), frequency_squared), _DARK_WEIGHT)
    parts = np.empty((3, _CANDIDATES, n_y, n_x), dtype=np.float32)
    for index, (transfers, powers) in enumerate(zip(transfer, power, strict=True)):
        of_pairs = np.repeat(powers[::2] + powers[1::2], 2, axis=0)
        filters = transfers[list(ORTHOGONAL)] * (weight / np.sqrt(0.5 * of_pairs + _FAINTEST * of_pairs.max()))
        filtered = scipy.fft.irfft2(spectra * filters, size)[:, :n_y, :n_x]
        filtered -= uniform_filter(filtered, (0, _WINDOW_PX, _WINDOW_PX))
        first, second = filtered[::2], filtered[1::2]
        squares = uniform_filter(filtered * filtered, (0, _WINDOW_PX, _WINDOW_PX)) + np.finfo(np.float32).tiny
        # Polarised light divides unequally over a pair: both images are scaled to the mean; a dark one adds nothing.
        balance = np.sqrt(squares[1::2] / squares[::2])
        for part, product in enumerate((first * second, first * first * balance, second * second / balance)):
            parts[part, index] = product.sum(axis=0)
    samples, gain = independent_samples(weight, size)
    # Three pairs have three times the samples, and their products three times the noise.
    return CostVolume(vergences, parts, 3.0 * samples, 3.0 * gain)


def _segments(volume: CostVolume, lit: NDArray[np.bool_]) -> tuple[NDArray[np.int32], list[Plane]]:
    """Number of each lit pixel's segment from 1 (0 for none), and the plane of each segment."""
    of_window = window_depth(volume, _WINDOW_PX)
    claimed = of_window.pixels.claimed & lit & (of_window.correlation >= _LEAST_CORRELATION)
    pixels = replace(of_window.pixels, claimed=claimed)
    separation = layer_separation_per_m(volume)
    layers = [Plane(vergence) for vergence in depth_layers(pixels, separation).tolist()]
    label, planes = np.zeros(lit.shape, dtype=np.int32), list[Plane]()
    if not layers:
        return label, planes
    parts = connected_segments(
        assign_layers(volume, layers, pixels, separation, step=1, lit=lit), lit, _WINDOW_PX, step=1
    )
    for number in range(1, int(parts.max(initial=0)) + 1):
        inner = interior(parts, number, step=1)
        depth = segment_depth(volume, volume.label_sums(inner.astype(np.int32), 1)[0], float(inner.sum()))
        if np.isfinite(depth.relative_error) and depth.correlation >= _LEAST_CORRELATION:
            planes.append(fit_plane(Cells.of(volume, inner, 1)) or depth.plane)
            label[parts == number] = len(planes)
    return label, planes


def _stokes_parameters(frame: StokesFrame, psf: StokesPsf, vergence_per_m: FloatArray) -> FloatArray:
    """Stokes parameters inverted at several depths, interpolated to each pixel's own: shape (4, n_y, n_x)."""
    low, high = float(vergence_per_m.min()), float(vergence_per_m.max())
    inverted = np.stack([_inverted(frame, kernels_at(psf, 1.0 / v)) for v in np.linspace(low, high, _INVERTED_DEPTHS)])
    place = (vergence_per_m - low) / max(high - low, 1e-12) * (_INVERTED_DEPTHS - 1)
    at = [place, *np.indices(place.shape)]
    return np.stack([map_coordinates(inverted[:, k], at, order=1, mode="nearest") for k in range(4)])


def _inverted(frame: StokesFrame, kernels: FloatArray) -> FloatArray:
    """Wiener estimate of the four parameters at one depth, shape (4, n_y, n_x), with a 1 / f^2 spectrum as prior."""
    n_y, n_x = frame.images.shape[-2:]
    margin = kernels.shape[-1] // 2
    size = (scipy.fft.next_fast_len(n_y + 2 * margin, real=True), scipy.fft.next_fast_len(n_x + 2 * margin, real=True))
    around = ((0, 0), (margin, margin), (margin, margin))
    images = np.moveaxis(scipy.fft.rfft2(np.pad(frame.images, around), size), 0, -1)
    transfer = np.moveaxis(transfer_functions(kernels, size), (0, 1), (-2, -1))
    mean = float(np.mean(frame.images))
    noise_to_signal = (mean + frame.read_noise_e**2) / _prior_power(size, mean, frame.images)
    adjoint = transfer.conj().swapaxes(-1, -2)
    normal = adjoint @ transfer + noise_to_signal[..., None, None] * np.eye(4)
    solved = np.linalg.solve(normal, adjoint @ images[..., None])[..., 0]
    sharp = scipy.fft.irfft2(np.moveaxis(solved, -1, 0), size)
    return np.asarray(sharp[:, margin : margin + n_y, margin : margin + n_x])


def _prior_power(size: tuple[int, int], mean: float, images: FloatArray) -> FloatArray:
    """Expected power of the scene at each frequency, per pixel: 1 / f^2, with the variance of the images."""
    frequency_squared = scipy.fft.fftfreq(size[0])[:, None] ** 2 + scipy.fft.rfftfreq(size[1]) ** 2
    frequency_squared[0, 0] = (0.5 / max(size)) ** 2
    falling = 1.0 / frequency_squared
    columns = np.full(falling.shape[1], 2.0)
    columns[0] = 1.0
    scale = float(np.var(images)) * size[0] * size[1] / float((falling * columns).sum())
    return np.asarray(np.maximum(scale * falling, 1e-9 * mean**2 + 1e-30))


def stokes_errors(image: StokesImage, frame: StokesFrame) -> StokesErrors:
    """Compare a decoded image with the truth of its frame."""
    known = np.isfinite(frame.depth_m)
    both = known & np.isfinite(image.depth_m)
    inner = uniform_filter(known.astype(float), _ERROR_WINDOW_PX) > 0.999
    window = (0, _ERROR_WINDOW_PX, _ERROR_WINDOW_PX)
    decoded, true = (uniform_filter(stokes, window) for stokes in (image.stokes, frame.stokes))
    difference = decoded[1:] / np.maximum(decoded[0], 1e-9) - true[1:] / np.maximum(true[0], 1e-9)
    whole = [frame.label == number for number in np.unique(frame.label[frame.label > 0])]
    interiors = [binary_erosion(mask, iterations=_OUTLINE_PX) for mask in whole]
    mean_square = float(np.mean((image.stokes[0] - frame.stokes[0])[inner] ** 2))
    return StokesErrors(
        nmae=float(np.mean(np.abs(image.depth_m[both] / frame.depth_m[both] - 1.0))) if both.any() else float("nan"),
        share_decoded=float(both.sum() / max(1, known.sum())),
        stokes_rms=float(np.sqrt(np.mean(difference[:, inner] ** 2))),
        stokes_object_error=_largest_state_error(image, frame, whole),
        stokes_interior_error=_largest_state_error(image, frame, interiors),
        psnr_s0_db=10.0 * float(np.log10(frame.stokes[0].max() ** 2 / max(mean_square, 1e-30))),
    )


def _largest_state_error(image: StokesImage, frame: StokesFrame, masks: list[NDArray[np.bool_]]) -> float:
    """Largest error of (S1, S2, S3) / S0 summed over each mask, shape (n_y, n_x); NaN if all are empty."""
    errors = []
    for mask in masks:
        if mask.any():
            decoded, true = (part[:, mask].sum(axis=1) for part in (image.stokes, frame.stokes))
            errors.append(float(np.abs(decoded[1:] / decoded[0] - true[1:] / true[0]).max()))
    return max(errors, default=float("nan"))
