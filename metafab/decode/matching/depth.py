"""Depth of each pixel from the agreement of the twins in windows about it, with its error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from metafab.core.conventions import FloatArray
from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.peaks import peaks
from metafab.decode.registration.reduce import enlarged, repeated

#: Correlation of the twins, in standard deviations of what pure noise gives, from which there is texture.
_SIGNIFICANT = 5.0
#: Relative standard error at which the confidence is one half; no depth is claimed from four times as much.
HALF_CONFIDENCE = 0.01
_LARGEST_ERROR = 4.0 * HALF_CONFIDENCE
#: Each window is twice as wide as the one before.
_WINDOWS = 3
#: Windows of so many pixels of the volume are looked at on every second one.
_WIDE = 8
#: A wider window is trusted while it stays within this many standard errors of the narrower one.
_SAME_DEPTH = 1.5
#: Points a candidate at which splines through their agreement are read.
_FINE = 32


@dataclass(frozen=True)
class PixelDepth:
    """The depth of each pixel by itself.

    Attributes:
        vergence_per_m: shape (n_y, n_x), 1/depth at the best agreement.
        relative_error: shape (n_y, n_x), standard error of depth over depth; inf without texture.
        claimed: shape (n_y, n_x), whether a depth may be claimed.
    """

    vergence_per_m: FloatArray
    relative_error: FloatArray
    claimed: NDArray[np.bool_]

    def within(self, rows: slice, columns: slice) -> PixelDepth:
        """A part of the picture."""
        part = (rows, columns)
        return PixelDepth(self.vergence_per_m[part], self.relative_error[part], self.claimed[part])


def pixel_depth(volume: Volume, window: int, noise_variance: FloatArray) -> PixelDepth:
    """Depth from the widest window that shows no other depth than the narrower ones in it.

    Args:
        volume: agreement of the twins; at least three candidates.
        window: side of the narrowest window, in pixels of the volume.
        noise_variance: shape (2, n_y, n_x), variance of a pixel of the frame, of both images.
    """
    shape = volume.parts.shape[-2], volume.parts.shape[-1]
    first = int(window >= _WIDE and min(shape) > 2 * window)
    if first:  # windows this wide say the same at every second pixel
        volume, window = volume.halved(), window // 2 | 1
    vergence, error, inside, common = _best(volume, window)
    noise = volume.noise_gain * np.sqrt(noise_variance[0] * noise_variance[1])[:: 1 + first, :: 1 + first]
    significant = common > _SIGNIFICANT * noise / np.sqrt(window**2 * volume.samples)
    claimed = repeated(significant & inside & (error < _LARGEST_ERROR), 1 + first, shape)
    vergence, error = (enlarged(values, 1 + first, shape) for values in (vergence, error))
    agreed = claimed
    for level in range(first + 1, first + _WINDOWS):
        if min(volume.parts.shape[-2:]) < 2 * window:
            break
        volume = volume.halved()
        wider, its_error, its_inside, _ = _best(volume, window)
        wider, its_error = (enlarged(values, 2**level, shape) for values in (wider, its_error))
        inside = enlarged(its_inside.astype(np.float32), 2**level, shape) == 1.0
        agreed = agreed & inside & (np.abs(wider / vergence - 1.0) < _SAME_DEPTH * error) & (its_error < error)
        vergence, error = np.where(agreed, wider, vergence), np.where(agreed, its_error, error)
    return PixelDepth(vergence, np.where(claimed, error, np.inf), claimed)


def _best(volume: Volume, window: int) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.float32]]:
    """The depth at which the twins agree best in a window about each pixel.

    Returns:
        Vergence by a parabola through the best candidate and its neighbours, its relative standard error, whether it is
        a maximum, and the largest mean product of the twins.
    """
    count = volume.vergences_per_m.size
    best, around, common = peaks(volume.parts, window)
    below, at, above = around
    shift, peak, curvature = parabola(below, at, above)
    vergence = volume.vergences_per_m[np.clip(best, 1, count - 2)] + volume.step_per_m * np.clip(shift, -1.0, 1.0)
    error = standard_error(peak, curvature / volume.step_per_m**2, window**2 * volume.samples) / np.abs(vergence)
    # At an end of the range the true depth may lie beyond it.
    return vergence, error, (best > 0) & (best < count - 1), common


def parabola(below: FloatArray, at: FloatArray, above: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vertex (in steps from the middle), height and curvature (per step squared, positive) through three values."""
    curvature = np.maximum(2.0 * at - below - above, 1e-12)
    shift = 0.5 * (above - below) / curvature
    return shift, at + 0.25 * (above - below) * shift, curvature


def spline_peaks(values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Largest values of splines through equally spaced ones.

    A parabola through three candidates alone is off, and by the same all over a frame.

    Args:
        values: shape (n, n_candidates).

    Returns:
        Shapes (n,): place of the maximum, in steps from the first; the maximum; its curvature (per step squared,
        positive); whether it lies inside of the range.
    """
    fine = values @ _spline_weights(values.shape[1]).T
    best = fine.argmax(axis=1)
    inner = np.clip(best, 1, fine.shape[1] - 2)
    below, at, above = (np.take_along_axis(fine, (inner + d)[:, None], axis=1)[:, 0] for d in (-1, 0, 1))
    shift, peak, curvature = parabola(below, at, above)
    return (inner + np.clip(shift, -1.0, 1.0)) / _FINE, peak, curvature * _FINE**2, best == inner


@lru_cache(maxsize=8)
def _spline_weights(count: int) -> FloatArray:
    """Weights of ``count`` values in their spline, ``_FINE`` points a step: shape (n_points, count)."""
    points = np.arange(_FINE * (count - 1) + 1) / _FINE
    return np.asarray(make_interp_spline(np.arange(count), np.eye(count), k=min(5, count - 1))(points))


def standard_error(peak: FloatArray, curvature: FloatArray, samples: float) -> FloatArray:
    """Standard error of the place of a correlation's maximum.

    Twins with correlation rho before and kappa rho after a small move have, over ``samples`` independent pairs,
    var = (1 - rho^2) / (samples rho |rho''|): the Cramer-Rao bound of a Gaussian pair.
    """
    rho = np.clip(peak, 1e-6, 1.0 - 1e-6)
    return np.sqrt((1.0 - rho**2) / (samples * rho * np.maximum(curvature, 1e-30)))
