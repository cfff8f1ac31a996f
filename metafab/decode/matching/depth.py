"""Depth of each pixel from the correlation of the twins in windows around it, with its standard error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.confidence import LARGEST_ERROR
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.pooling import mirrored
from metafab.decode.registration.downsampling import enlarged, repeated

#: Mean product of the twins, in standard deviations of that of pure noise, from which there is texture.
_SIGNIFICANT = 5.0
#: Number of windows that are tried, each twice as wide as the one before.
_WINDOWS = 3
#: Width of a window, in pixels of the volume, from which every second pixel is enough.
_WIDE_WINDOW = 8
#: A wider window is trusted while its depth stays within this many standard errors of the narrower one's.
_SAME_DEPTH = 1.5
#: Points per candidate at which splines through the correlation are evaluated.
_POINTS_PER_CANDIDATE = 32
#: Weights of five equally spaced values in the coefficients of the quartic through them, rising powers.
_QUARTIC = np.linalg.inv(np.vander(np.arange(-2.0, 3.0), increasing=True))
#: Newton's steps to the maximum of the quartic.
_NEWTON_ROUNDS = 3
#: Root mean square below which a picture is dark.
_DARK = 1e-15


@dataclass(frozen=True)
class PixelDepth:
    """The depth of each pixel from the windows around it."""

    vergence_per_m: FloatArray  #: Shape (n_y, n_x), 1/depth at the largest correlation.
    relative_error: FloatArray  #: Shape (n_y, n_x), standard error of depth over depth; inf without texture.
    claimed: NDArray[np.bool_]  #: Shape (n_y, n_x), whether a depth is claimed.

    def within(self, rows: slice, columns: slice) -> PixelDepth:
        """A part of the picture."""
        part = (rows, columns)
        return PixelDepth(self.vergence_per_m[part], self.relative_error[part], self.claimed[part])


@dataclass(frozen=True)
class WindowDepth:
    """The depth of each pixel from windows of one size."""

    pixels: PixelDepth  #: Depths and their errors.
    correlation: FloatArray  #: Shape (n_y, n_x), largest correlation of the window.
    largest_product: NDArray[np.float32]  #: Shape (n_y, n_x), largest mean product of the twins.


@dataclass(frozen=True)
class Peak:
    """A maximum of equally spaced values, interpolated between them."""

    place: FloatArray  #: Any shape, place of the maximum, in steps of the values.
    height: FloatArray  #: Any shape, the maximum.
    curvature: FloatArray  #: Any shape, minus the second derivative, per squared step; positive.
    inside: NDArray[np.bool_]  #: Any shape, whether the maximum is inside the range of the values.


def pixel_depth(volume: CostVolume, window: int, noise_variance: FloatArray) -> PixelDepth:
    """Depth from the widest window whose depth agrees with that of the narrower windows.

    The volume has at least three candidates. ``window`` is the side of the narrowest window in its pixels, odd;
    ``noise_variance``, shape (2, n_y, n_x), is the variance of a frame pixel in both images.
    """
    shape = volume.shape
    first = int(window >= _WIDE_WINDOW and min(shape) > 2 * window)
    if first:
        volume, window = volume.halved(), window // 2 | 1
    of_window = window_depth(volume, window)
    narrow = of_window.pixels
    noise = volume.noise_gain * np.sqrt(noise_variance[0] * noise_variance[1])[:: 1 + first, :: 1 + first]
    significant = of_window.largest_product > _SIGNIFICANT * noise / np.sqrt(window**2 * volume.samples)
    claimed = repeated(significant & narrow.claimed & (narrow.relative_error < LARGEST_ERROR), 1 + first, shape)
    vergence = enlarged(narrow.vergence_per_m, 1 + first, shape)
    error = enlarged(narrow.relative_error, 1 + first, shape)
    agreed = claimed
    for level in range(first + 1, first + _WINDOWS):
        if min(volume.shape) < 2 * window:
            break
        volume = volume.halved()
        wide = window_depth(volume, window).pixels
        wide_vergence = enlarged(wide.vergence_per_m, 2**level, shape)
        wide_error = enlarged(wide.relative_error, 2**level, shape)
        inside = enlarged(wide.claimed.astype(np.float32), 2**level, shape) == 1.0
        same_depth = np.abs(wide_vergence / vergence - 1.0) < _SAME_DEPTH * error
        agreed = agreed & inside & same_depth & (wide_error < error)
        vergence, error = np.where(agreed, wide_vergence, vergence), np.where(agreed, wide_error, error)
    return PixelDepth(vergence, np.where(claimed, error, np.inf), claimed)


def window_depth(volume: CostVolume, window: int) -> WindowDepth:
    """Depth at the peak of the correlation in the window about each pixel, claimed inside the range.

    The volume has at least three candidates; ``window`` is the side of the window in its pixels, odd.
    """
    count = volume.vergences_per_m.size
    best, around, largest_product = best_candidates(volume.products, window)
    peak = quartic_peak(around)
    vergence = volume.vergences_per_m[np.clip(best, 1, count - 2)] + volume.step_per_m * peak.place
    curvature = peak.curvature / volume.step_per_m**2
    error = standard_error(peak.height, curvature, window**2 * volume.samples) / np.abs(vergence)
    # At an end of the range the true depth may lie beyond it.
    pixels = PixelDepth(vergence, error, (best > 0) & (best < count - 1))
    return WindowDepth(pixels, peak.height, largest_product)


def parabolic_peak(below: FloatArray, at: FloatArray, above: FloatArray) -> Peak:
    """Vertex of the parabola through three equally spaced values of one shape, counted from the middle one."""
    curvature = np.maximum(2.0 * at - below - above, 1e-12)
    shift = 0.5 * (above - below) / curvature
    return Peak(shift, at + 0.25 * (above - below) * shift, curvature, np.abs(shift) <= 1.0)


def quartic_peak(values: NDArray[np.float32]) -> Peak:
    """Maximum of the quartic through five values at every half step; its place counts in steps from the middle one.

    A parabola through three candidates is off by up to a tenth of a step where the maximum is as narrow as two steps:
    0.9 % of the depth at the sides of Shen's field, calibrated from 0.23 to 0.71 m. Values of shape (5, ...) give
    the peak within a step of the middle, shape (...).
    """
    flat = np.ascontiguousarray(values, dtype=np.float32).reshape(5, -1)
    place, height, curvature, inside = *np.empty((3, flat.shape[1])), np.empty(flat.shape[1], dtype=np.bool_)
    spread(_quartic_peaks, flat.shape[1], flat, _QUARTIC, place, height, curvature, inside)
    shape = values.shape[1:]
    return Peak(place.reshape(shape), height.reshape(shape), curvature.reshape(shape), inside.reshape(shape))


@compiled
def _quartic_peaks(
    first: int,
    stop: int,
    values: NDArray[np.float32],
    quartic: NDArray[np.float64],
    place: FloatArray,
    height: FloatArray,
    curvature: FloatArray,
    inside: NDArray[np.bool_],
) -> None:
    """Maximum of each quartic by Newton's method, from the parabola about the largest value and within a step of it."""
    for i in range(first, stop):
        best = 1  # largest of the three inner values, or the inner one next to a larger end
        for k in range(2, 4):
            if values[k, i] > values[best, i]:
                best = k
        if values[4, i] > max(values[0, i], values[best, i]):
            best = 3
        elif values[0, i] >= values[best, i]:
            best = 1
        below, at, above = np.float64(values[best - 1, i]), np.float64(values[best, i]), np.float64(values[best + 1, i])
        bend = max(2.0 * at - below - above, 1e-12)
        shift = 0.5 * (above - below) / bend
        lowest, highest, least = best - 3.0, best - 1.0, 0.25 * bend
        x = min(max(best - 2.0 + shift, lowest), highest)
        c0 = c1 = c2 = c3 = c4 = 0.0
        for k in range(5):
            value = np.float64(values[k, i])
            c0 += quartic[0, k] * value
            c1 += quartic[1, k] * value
            c2 += quartic[2, k] * value
            c3 += quartic[3, k] * value
            c4 += quartic[4, k] * value
        for _ in range(_NEWTON_ROUNDS):
            slope = c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * 4.0 * c4))
            second = 2.0 * c2 + x * (6.0 * c3 + x * 12.0 * c4)
            x = min(max(x - slope / min(second, -least), lowest), highest)
        place[i], height[i] = 0.5 * x, c0 + x * (c1 + x * (c2 + x * (c3 + x * c4)))
        curvature[i] = 4.0 * max(-(2.0 * c2 + x * (6.0 * c3 + x * 12.0 * c4)), least)
        inside[i] = abs(shift) <= 1.0


def spline_peaks(values: FloatArray) -> Peak:
    """Largest values of splines through equally spaced values; places are counted from the first one.

    A parabola through three candidates would have the same error all over a frame, which no mean removes. Values of
    shape (n, n_candidates) give n peaks.
    """
    fine = values @ _spline_table(values.shape[1]).T
    best = fine.argmax(axis=1)
    inner = np.clip(best, 1, fine.shape[1] - 2)
    rows = np.arange(best.size)
    peak = parabolic_peak(fine[rows, inner - 1], fine[rows, inner], fine[rows, inner + 1])
    place = (inner + np.clip(peak.place, -1.0, 1.0)) / _POINTS_PER_CANDIDATE
    return Peak(place, peak.height, peak.curvature * _POINTS_PER_CANDIDATE**2, best == inner)


@lru_cache(maxsize=8)
def _spline_table(count: int) -> FloatArray:
    """Weights of ``count`` values in the spline through them: shape (n_points, count)."""
    points = np.arange(_POINTS_PER_CANDIDATE * (count - 1) + 1) / _POINTS_PER_CANDIDATE
    return np.asarray(make_interp_spline(np.arange(count), np.eye(count), k=min(5, count - 1))(points))


def standard_error(height: FloatArray, curvature: FloatArray, samples: float) -> FloatArray:
    """Standard error of the place of a correlation's maximum: the Cramer-Rao bound of a Gaussian pair of images.

    With correlation rho over ``samples`` independent pairs of pixels, var = (1 - rho^2) / (samples rho |rho''|). The
    height rho and the curvature -rho'' have any one shape, like the error, which is in the unit of place.
    """
    rho = np.clip(height, 1e-6, 1.0 - 1e-6)
    return np.sqrt((1.0 - rho**2) / (samples * rho * np.maximum(curvature, 1e-30)))


def best_candidates(
    products: NDArray[np.float32], window: int
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Candidates of largest correlation in the window about each pixel; beyond an edge, the products are mirrored.

    Args:
        products: shape (3, n, n_y, n_x), products a b, a^2 and b^2 of the twins at n >= 3 candidates.
        window: side of the window, odd.

    Returns:
        Number of the best candidate, shape (n_y, n_x); the correlation at every half step from the candidate below to
        the one above it (of the nearest candidate that has both neighbours), shape (5, n_y, n_x); the largest mean
        of a b, shape (n_y, n_x).
    """
    shape = products.shape[2:]
    best, around = np.zeros(shape, dtype=np.intp), np.zeros((5, *shape), dtype=np.float32)
    largest_product = np.empty(shape, dtype=np.float32)
    half_steps = _half_step_weights(products.shape[1])
    contiguous = np.ascontiguousarray(products)
    spread(_best_candidates, shape[0], contiguous, window // 2, half_steps, best, around, largest_product)
    return best, around, largest_product


@lru_cache(maxsize=8)
def _half_step_weights(count: int) -> NDArray[np.float32]:
    """Weights of ``count`` values in the spline through them, half a step above each but the last."""
    half = _POINTS_PER_CANDIDATE // 2
    return np.ascontiguousarray(_spline_table(count)[half::_POINTS_PER_CANDIDATE], dtype=np.float32)


@compiled
def _row_means(
    products: NDArray[np.float32],
    v: int,
    row: int,
    reach: int,
    padded: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the means of products (3, n, n_y, n_x) of candidate ``v`` over the windows about a row's pixels: (3, n_x).

    ``padded``, shape (3, n_x + 2 reach), is scratch. All three at once: additions to a single sum wait for one another.
    """
    _, _, n_y, n_x = products.shape
    padded[:] = np.float32(0.0)
    for i in range(row - reach, row + reach + 1):
        at = mirrored(i, n_y)
        for p in range(3):
            line, column_sum = products[p, v, at], padded[p, reach : reach + n_x]
            for j in range(n_x):
                column_sum[j] += line[j]
    for j in range(reach):
        before, after = reach + mirrored(-1 - j, n_x), reach + mirrored(n_x + j, n_x)
        for p in range(3):
            padded[p, reach - 1 - j], padded[p, reach + n_x + j] = padded[p, before], padded[p, after]
    of_x, of_y, of_z = padded[0], padded[1], padded[2]
    x = y = z = 0.0
    for j in range(2 * reach):
        x += of_x[j]
        y += of_y[j]
        z += of_z[j]
    share = 1.0 / (2 * reach + 1) ** 2
    new_x, new_y, new_z = of_x[2 * reach :], of_y[2 * reach :], of_z[2 * reach :]
    for j in range(n_x):
        x += new_x[j]
        y += new_y[j]
        z += new_z[j]
        out[0, j], out[1, j], out[2, j] = np.float32(x * share), np.float32(y * share), np.float32(z * share)
        x -= of_x[j]
        y -= of_y[j]
        z -= of_z[j]


@compiled
def _best_candidates(
    first: int,
    stop: int,
    products: NDArray[np.float32],
    reach: int,
    half_steps: NDArray[np.float32],
    best: NDArray[np.intp],
    around: NDArray[np.float32],
    largest_product: NDArray[np.float32],
) -> None:
    _, count, _, n_x = products.shape
    for i in range(first, stop):
        padded = np.empty((3, n_x + 2 * reach), dtype=np.float32)
        means = np.empty((3, n_x), dtype=np.float32)
        rho, largest = np.empty((count, n_x), dtype=np.float32), np.empty(n_x, dtype=np.float32)
        for v in range(count):
            _row_means(products, v, i, reach, padded, means)
            both, x, y, of_v = means[0], means[1], means[2], rho[v]
            # A loop each for roots and quotients, which are vectorised, and for the choice.
            for j in range(n_x):
                norm = np.sqrt(max(x[j], np.float32(0.0))) * np.sqrt(max(y[j], np.float32(0.0)))
                of_v[j] = both[j] / max(norm, np.float32(_DARK))
            for j in range(n_x):
                largest_product[i, j] = max(both[j], largest_product[i, j]) if v > 0 else both[j]
                if v == 0 or of_v[j] > largest[j]:
                    best[i, j], largest[j] = v, of_v[j]
        for j in range(n_x):
            inner = min(max(best[i, j], 1), count - 2)
            for d in range(3):
                around[2 * d, i, j] = rho[inner - 1 + d, j]
            for v in range(count):
                around[1, i, j] += half_steps[inner - 1, v] * rho[v, j]
                around[3, i, j] += half_steps[inner, v] * rho[v, j]
