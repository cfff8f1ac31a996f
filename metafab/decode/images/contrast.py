"""Contrast I_x / I_y of pixels and of segments, and its standard error to first order in the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import spread
from metafab.decode.images.deconvolution import NOISE_WINDOW_PX, SharpImages
from metafab.decode.matching.pooling import window_means


def pixel_contrast(sharp: SharpImages, read_noise_e: float, lit: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Contrast of each pixel and its standard error: shape (n_y, n_x) each.

    Both are NaN where ``lit``, shape (n_y, n_x), is not set or I_y is 0.
    """
    variance = window_means(sharp.images, NOISE_WINDOW_PX)
    variance += np.float32(read_noise_e**2)
    variance *= sharp.noise_gain
    return contrast_with_error(sharp.images, variance, lit)


def contrast_with_error(
    images: NDArray[np.float32], variance: NDArray[np.float32], lit: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Ratio of two images and its standard error, from the variance of their pixels: shape (n_y, n_x) each.

    Images (electrons) and variances have the shape (2, n_y, n_x). Both results are NaN where ``lit``, shape (n_y, n_x),
    is not set or the second image is 0.
    """
    contrast, error = np.empty(lit.shape), np.empty(lit.shape)
    spread(_divide_images, lit.shape[0], images, variance, lit, contrast, error)
    return contrast, error


@compiled
def _divide_images(
    first: int,
    stop: int,
    images: NDArray[np.float32],
    variance: NDArray[np.float32],
    lit: NDArray[np.bool_],
    contrast: FloatArray,
    error: FloatArray,
) -> None:
    for i in range(first, stop):
        for j in range(lit.shape[1]):
            known = lit[i, j] and images[1, i, j] > np.float32(0.0)
            y = images[1, i, j] if known else np.float32(1.0)
            ratio = images[0, i, j] / y
            spread = np.sqrt(variance[0, i, j] + ratio * ratio * variance[1, i, j]) / y
            contrast[i, j] = ratio if known else np.float32(np.nan)
            error[i, j] = spread if known else np.float32(np.nan)


@dataclass(frozen=True)
class SegmentLight:
    """Light of each segment."""

    pixels: NDArray[np.intp]  #: Shape (n,), pixels of each segment.
    inner: NDArray[np.intp]  #: Shape (n,), pixels of its interior.
    light_e: FloatArray  #: Shape (2, n), sum of each image over the interior, electrons.

    @classmethod
    def of(
        cls, images: NDArray[np.float32], segment: NDArray[np.int32], inner: NDArray[np.int32], count: int
    ) -> SegmentLight:
        """Sum both images, shape (2, n_y, n_x), electrons, over the segments from 1 to ``count``.

        ``segment``, shape (n_y, n_x), is the number of each pixel's segment, 0 for none; ``inner`` that of the segment
        whose interior holds the pixel, which counts where ``segment`` is not 0.
        """
        rows = np.zeros((segment.shape[0], 4, count + 1))
        spread(_add_segments, segment.shape[0], images, segment, inner, rows)
        sums = rows.sum(axis=0)[:, 1:]
        pixels, within = np.rint(sums[:2]).astype(np.intp)
        return cls(pixels, within, sums[2:])

    def contrast(self, read_noise_e: float) -> tuple[FloatArray, FloatArray]:
        """I_x / I_y of each segment and its standard error: shapes (n,)."""
        x, y = np.maximum(self.light_e, 1e-30)
        read = self.inner * read_noise_e**2
        ratio = x / y
        return ratio, ratio * np.sqrt((x + read) / x**2 + (y + read) / y**2)


@compiled
def _add_segments(
    first: int,
    stop: int,
    images: NDArray[np.float32],
    segment: NDArray[np.int32],
    inner: NDArray[np.int32],
    rows: FloatArray,
) -> None:
    """Add up, in each row, the pixels of each segment, of its interior, and the light of both images there."""
    for i in range(first, stop):
        sums, start = rows[i], 0
        # Runs of equal numbers: each sum grows in a register.
        while start < segment.shape[1]:
            number, within, j, x, y = segment[i, start], inner[i, start], start, 0.0, 0.0
            while j < segment.shape[1] and segment[i, j] == number and inner[i, j] == within:
                x += images[0, i, j]
                y += images[1, i, j]
                j += 1
            if number > 0:
                sums[0, number] += j - start
                sums[1, within] += j - start
                sums[2, within] += x
                sums[3, within] += y
            start = j
