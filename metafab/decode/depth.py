"""Depth of each pixel from the agreement of the twins in a window about it, with its error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.progress import Progress
from metafab.decode.align import Aligner, doubled

#: Correlation of the twins, in standard deviations of what pure noise gives, from which there is texture.
_SIGNIFICANT = 5.0
#: Relative standard error at which the confidence is one half; no depth is claimed from four times as much.
HALF_CONFIDENCE = 0.01
_LARGEST_ERROR = 4.0 * HALF_CONFIDENCE


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


def pixel_depth(
    aligner: Aligner, vergences_per_m: FloatArray, window_px: int, noise_variance: FloatArray, progress: Progress
) -> PixelDepth:
    """The best of the candidates, refined by a parabola.

    Args:
        aligner: the twins.
        vergences_per_m: candidates, equally spaced, at least three.
        window_px: side of the window.
        noise_variance: shape (2, n_y, n_x), variance of both images' pixels.
        progress: called after each candidate.
    """
    count = vergences_per_m.size
    shape = aligner.tiling.shape
    volume = np.empty((count, *shape), dtype=np.float32)
    cross = np.full(shape, -np.inf, dtype=np.float32)
    for index, vergence in enumerate(vergences_per_m):
        agreement = aligner.windows(float(vergence), window_px)
        volume[index] = agreement.correlation
        np.maximum(cross, agreement.cross, out=cross)
        progress("decode", index + 1, count)
    best = volume.argmax(axis=0)
    inner = np.clip(best, 1, count - 2)
    below, at, above = (np.take_along_axis(volume, (inner + d)[None], axis=0)[0].astype(np.float64) for d in (-1, 0, 1))
    shift, peak, curvature = parabola(below, at, above)
    step = float(vergences_per_m[1] - vergences_per_m[0])
    vergence = vergences_per_m[inner] + step * np.clip(shift, -1.0, 1.0)
    samples = window_px**2 * aligner.bandwidth
    error = standard_error(peak, curvature / step**2, samples) / np.abs(vergence)
    noise = aligner.noise_gain * np.sqrt(noise_variance[0] * noise_variance[1])[::2, ::2]
    significant = cross > _SIGNIFICANT * noise / np.sqrt(samples)
    # At an end of the range the true depth may lie beyond it.
    open_ended = (best == 0) | (best == count - 1)
    error = np.where(significant & ~open_ended, error, np.inf)
    full = noise_variance.shape[1], noise_variance.shape[2]
    error = np.repeat(np.repeat(error, 2, axis=0), 2, axis=1)[: full[0], : full[1]]
    return PixelDepth(doubled(vergence, full), error, error < _LARGEST_ERROR)


def parabola(below: FloatArray, at: FloatArray, above: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vertex (in steps from the middle), height and curvature (per step squared, positive) through three values."""
    curvature = np.maximum(2.0 * at - below - above, 1e-12)
    shift = 0.5 * (above - below) / curvature
    return shift, at + 0.25 * (above - below) * shift, curvature


def standard_error(peak: FloatArray, curvature: FloatArray, samples: float) -> FloatArray:
    """Standard error of the place of a correlation's maximum.

    Twins with correlation rho before and kappa rho after a small move have, over ``samples`` independent pairs,
    var = (1 - rho^2) / (samples rho |rho''|): the Cramer-Rao bound of a Gaussian pair.
    """
    rho = np.clip(peak, 1e-6, 1.0 - 1e-6)
    return np.sqrt((1.0 - rho**2) / (samples * rho * np.maximum(curvature, 1e-30)))
