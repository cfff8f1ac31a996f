"""Least-squares fit of the predicted PSF to one image of a point in a photograph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import OptimizeResult, least_squares

from metafab.camera.frames.frame import RawFrame
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.interpolation import spline_weights

#: Largest distance of an image from its predicted place, pixels.
_SEARCH_PX = 64
#: Trial vergences of the matched-filter search, over the calibrated range.
_TRIALS = 9
#: Distance from an end of the calibrated range, as a share of the range, within which a fit counts as stopped there.
_AT_END = 1e-3
#: Least brightness of a saturated pixel's neighbours, as a share of saturation, if it belongs to the point; among
#: darker neighbours it is a hot pixel.
_LIT = 0.25


@dataclass(frozen=True)
class PointImage:
    """Fit of the prediction to one image of the point."""

    vergence_per_m: float  #: 1/depth at which the prediction fits best.
    place_um: tuple[float, float]  #: (x, y) on the sensor.
    #: Variance of the vergence and of both coordinates of the place, from the photograph's noise, or from the
    #: residual where that is larger.
    variance: tuple[float, float, float]
    chi_square: float  #: Mean square of the residual over that of photon and read noise; 1 for a perfect model.
    misfit: float  #: Share of the image's power that neither the model nor noise explains.
    full_pixels: int  #: Number of saturated pixels in the image.
    at_end: bool  #: Whether the vergence was stopped by an end of the predicted range.


def find_point(
    frame: RawFrame, depth_m: float, polarisation: int, kernels: PairKernels, place_um: FloatArray
) -> PointImage:
    """Find the image of a point and fit the prediction on the axis, ``kernels``, to it; ``polarisation`` 0 is x.

    ``depth_m`` is for messages; ``place_um`` is the predicted place (x, y) on the sensor. InputError if there is no
    image of a point near it.
    """
    n_y, n_x = kernels.shape
    column, row = (round((place_um[axis] - frame.origin_um[axis]) / frame.pixel_um) for axis in (0, 1))
    half_y, half_x = n_y // 2 + _SEARCH_PX, n_x // 2 + _SEARCH_PX
    top, left = max(0, row - half_y), max(0, column - half_x)
    part = np.asarray(frame.frame, dtype=np.float64)[top : row + half_y, left : column + half_x]
    if part.shape[0] < n_y or part.shape[1] < n_x or not np.isfinite(part).all():
        raise _no_point(depth_m, polarisation)
    part, full = _without_hot_pixels(part, frame.saturation_e)
    part = part - np.median(part)
    start, at = _matched_place(part, kernels, polarisation, 1.0 / kernels.psf.depth_m)
    window = slice(at[0], at[0] + n_y), slice(at[1], at[1] + n_x)
    cut = part[window]
    if cut.max() <= 6.0 * (frame.read_noise_e + np.median(np.abs(part))):
        raise _no_point(depth_m, polarisation)
    solved, explained = _fitted(cut, kernels, polarisation, start, frame.read_noise_e)
    solution, range_per_m = solved.x, float(np.ptp(1.0 / kernels.psf.depth_m))
    freedom = cut.size - solution.size - 2
    chi_square = 2.0 * float(solved.cost) / freedom
    slopes = np.asarray(solved.jac, dtype=np.float64)
    variance = max(1.0, chi_square) * np.diag(np.linalg.pinv(slopes.T @ slopes))
    variance = variance * np.array([range_per_m, frame.pixel_um, frame.pixel_um]) ** 2
    x_um = frame.origin_um[0] + frame.pixel_um * (left + at[1] + n_x // 2 + float(solution[2]))
    y_um = frame.origin_um[1] + frame.pixel_um * (top + at[0] + n_y // 2 + float(solution[1]))
    unexplained = max(0.0, 2.0 * float(solved.cost) - freedom)
    return PointImage(
        float(1.0 / kernels.psf.depth_m.max() + solution[0] * range_per_m),
        (x_um, y_um),
        (float(variance[0]), float(variance[1]), float(variance[2])),
        chi_square,
        unexplained / max(unexplained + explained, 1e-300),
        int(full[window].sum()),
        bool(min(solution[0], 1.0 - solution[0]) < _AT_END),
    )


def _without_hot_pixels(part: FloatArray, saturation_e: float | None) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The picture with hot pixels replaced by the median about them, and whether each other pixel is saturated."""
    if saturation_e is None or not (full := part >= saturation_e).any():
        return part, np.zeros(part.shape, dtype=np.bool_)
    median = median_filter(part, 3)
    lit = median > _LIT * saturation_e
    return np.where(full & ~lit, median, part), full & lit


def _fitted(
    cut: FloatArray, kernels: PairKernels, polarisation: int, start_per_m: float, read_noise_e: float
) -> tuple[OptimizeResult, float]:
    """Fit vergence (as a share of the range) and place (row, column, from the middle) of a point in a window.

    The second value is the power that the model explains, in units of the noise's variance, as the fit's cost is.
    """
    n_y, n_x = cut.shape
    nodes = 1.0 / kernels.psf.depth_m
    deviation = np.sqrt(np.maximum(cut, 0.0) + read_noise_e**2 + 1.0)
    ky, kx = scipy.fft.fftfreq(n_y)[:, None], scipy.fft.rfftfreq(n_x)[None, :]
    basis = kernels.nodes[polarisation, :, 0, 0].astype(np.float64)
    data, one = (cut / deviation).ravel(), (1.0 / deviation).ravel()

    def model(unknown: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The point's image and the whole model; brightness and background are solved linearly."""
        kernel = np.tensordot(spline_weights(nodes, nodes.min() + unknown[0] * np.ptp(nodes)), basis, axes=(0, 0))
        moved = scipy.fft.rfft2(kernel) * np.exp(-2j * np.pi * (ky * unknown[1] + kx * unknown[2]))
        image = (scipy.fft.irfft2(moved, (n_y, n_x)) / deviation).ravel()
        design = np.stack([image, one], axis=1)
        share, *_ = np.linalg.lstsq(design, data, rcond=None)
        return np.asarray(share[0] * image), np.asarray(design @ share)

    def residual(unknown: FloatArray) -> FloatArray:
        return np.asarray(data - model(unknown)[1])

    bounds = ([0.0, -8.0, -8.0], [1.0, 8.0, 8.0])
    first = [float(np.clip((start_per_m - nodes.min()) / np.ptp(nodes), 0.02, 0.98)), 0.0, 0.0]
    solved = least_squares(residual, first, bounds=bounds, x_scale=(0.05, 0.3, 0.3))
    return solved, float((model(solved.x)[0] ** 2).sum())


def _matched_place(
    part: FloatArray, kernels: PairKernels, polarisation: int, nodes: FloatArray
) -> tuple[float, tuple[int, int]]:
    """Trial vergence and first pixel (row, column) of the window with the largest matched-filter response."""
    n_y, n_x = kernels.shape
    spectrum = scipy.fft.rfft2(part)
    best: tuple[float, float, tuple[int, int]] = (-np.inf, 0.0, (0, 0))
    for trial in np.linspace(nodes.min(), nodes.max(), _TRIALS):
        kernel = kernels.at_depth(float(1.0 / trial))[polarisation, 0, 0]
        match = scipy.fft.irfft2(spectrum * np.conj(scipy.fft.rfft2(kernel, part.shape)), part.shape)
        match = match[: part.shape[0] - n_y + 1, : part.shape[1] - n_x + 1] / np.linalg.norm(kernel)
        row, column = np.unravel_index(int(match.argmax()), match.shape)
        if match[row, column] > best[0]:
            best = (float(match[row, column]), float(trial), (int(row), int(column)))
    return best[1], best[2]


def _no_point(depth_m: float, polarisation: int) -> InputError:
    expected = f"the {'xy'[polarisation]} image of a point within {_SEARCH_PX} pixels of its predicted place"
    remedy = "leave the frame out, or expose longer"
    return InputError.single("calibration", f"frame at {depth_m:g} m", expected, "none", remedy)
