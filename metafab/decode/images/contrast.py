"""I_x / I_y and its standard error to first order in the noise, of pixels and of segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled_parallel, prange
from metafab.decode.images.deconvolution import NOISE_WINDOW_PX, Sharp
from metafab.decode.matching.pooling import window_means


def pixel_contrast(sharp: Sharp, read_noise_e: float, lit: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """The contrast where there is light, and its standard error; NaN elsewhere: both of the shape of ``lit``.

    Args:
        sharp: both images.
        read_noise_e: standard deviation of a pixel of the frame without light.
        lit: shape (n_y, n_x), where there is light.
    """
    about = window_means(sharp.images, NOISE_WINDOW_PX)
    ratios = _ratios if HAS_NUMBA else _ratios_plain
    return ratios(sharp.images, sharp.noise_gain, about, np.float32(read_noise_e**2), lit)


def _ratios_plain(
    images: NDArray[np.float32],
    noise_gain: NDArray[np.float32],
    about: NDArray[np.float32],
    dark: np.float32,
    lit: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    x, y = images
    known = lit & (y > 0.0)
    of_x, of_y = noise_gain * (about + dark)
    contrast, error = np.full((2, *lit.shape), np.nan)
    np.divide(x, y, out=contrast, where=known)
    np.divide(np.sqrt(of_x + contrast * contrast * of_y), y, out=error, where=known)
    return contrast, error


@compiled_parallel
def _ratios(
    images: NDArray[np.float32],
    noise_gain: NDArray[np.float32],
    about: NDArray[np.float32],
    dark: np.float32,
    lit: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    contrast, error = np.empty(lit.shape), np.empty(lit.shape)
    for i in prange(lit.shape[0]):
        for j in range(lit.shape[1]):
            known = lit[i, j] and images[1, i, j] > np.float32(0.0)
            y = images[1, i, j] if known else np.float32(1.0)
            ratio = images[0, i, j] / y
            of_x = noise_gain[0, i, j] * (about[0, i, j] + dark)
            of_y = noise_gain[1, i, j] * (about[1, i, j] + dark)
            spread = np.sqrt(of_x + ratio * ratio * of_y) / y
            contrast[i, j] = ratio if known else np.float32(np.nan)
            error[i, j] = spread if known else np.float32(np.nan)
    return contrast, error


@dataclass(frozen=True)
class SegmentLight:
    """The light of segments.

    Attributes:
        pixels: shape (n,), all that belong to each.
        inner: shape (n,), those that its contrast is from.
        light_e: shape (2, n), of those pixels in both images, electrons.
    """

    pixels: NDArray[np.intp]
    inner: NDArray[np.intp]
    light_e: FloatArray

    @classmethod
    def of(
        cls, images: NDArray[np.float32], segment: NDArray[np.int32], inner: NDArray[np.int32], count: int
    ) -> SegmentLight:
        """Sum up both images (2, n_y, n_x) over the segments from 1 to ``count``.

        Args:
            images: electrons.
            segment: shape (n_y, n_x), number of each pixel's segment; 0 for none.
            inner: the same, of the pixels whose light counts; it counts where they have a segment at all.
            count: the largest number.
        """
        sums = (_light if HAS_NUMBA else _light_plain)(images, segment, inner, count)
        pixels, within = np.rint(sums[:2]).astype(np.intp)
        return cls(pixels, within, sums[2:])

    def contrast(self, read_noise_e: float) -> tuple[FloatArray, FloatArray]:
        """I_x / I_y of each segment and its standard error: shapes (n,)."""
        x, y = np.maximum(self.light_e, 1e-30)
        read = self.inner * read_noise_e**2
        ratio = x / y
        return ratio, ratio * np.sqrt((x + read) / x**2 + (y + read) / y**2)


def _light_plain(
    images: NDArray[np.float32], segment: NDArray[np.int32], inner: NDArray[np.int32], count: int
) -> FloatArray:
    within = (inner * (segment > 0)).ravel()
    weights = (None, *(image.ravel() for image in images))
    of_inner = [np.bincount(within, weight, count + 1)[1:] for weight in weights]
    return np.asarray([np.bincount(segment.ravel(), minlength=count + 1)[1:], *of_inner], dtype=np.float64)


@compiled_parallel
def _light(images: NDArray[np.float32], segment: NDArray[np.int32], inner: NDArray[np.int32], count: int) -> FloatArray:
    rows = np.zeros((segment.shape[0], 4, count + 1))
    for i in prange(segment.shape[0]):
        sums, start = rows[i], 0
        # Runs of the same numbers: each sum grows in a register.
        while start < segment.shape[1]:
            number, within, stop, x, y = segment[i, start], inner[i, start], start, 0.0, 0.0
            while stop < segment.shape[1] and segment[i, stop] == number and inner[i, stop] == within:
                x += images[0, i, stop]
                y += images[1, i, stop]
                stop += 1
            if number > 0:
                sums[0, number] += stop - start
                sums[1, within] += stop - start
                sums[2, within] += x
                sums[3, within] += y
            start = stop
    total: FloatArray = rows.sum(axis=0)[:, 1:]
    return total
