"""The decoded 4D image: two intensities, their contrast, depth, and the confidence in it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class SegmentFigures:
    """Depth and contrast of one segment; standard errors are those of photon and read noise.

    Attributes:
        number: of the segment, from 1, as in :attr:`Image4D.segment`.
        pixels: pixels of the segment.
        depth_m: depth at the middle of the segment.
        slope_x_per_m: change of 1/depth a pixel along x, 1/m; 0 for a segment of one depth. Likewise ``slope_y_per_m``.
        error_m: standard error of ``depth_m``.
        contrast: I_x / I_y, mean over the interior of the segment.
        contrast_error: standard error of ``contrast``.
        correlation: normalised cross-correlation of the twin images at that depth, 0 to 1.
    """

    number: int
    pixels: int
    depth_m: float
    slope_x_per_m: float
    slope_y_per_m: float
    error_m: float
    contrast: float
    contrast_error: float
    correlation: float


@dataclass(frozen=True)
class Image4D:
    """All-in-focus polarisation images and depth on the geometric image grid of the x polarisation.

    Attributes:
        intensity_x: shape (n_y, n_x), electrons.
        intensity_y: shape (n_y, n_x), electrons.
        contrast: shape (n_y, n_x), I_x / I_y; NaN where there is no signal.
        depth_m: shape (n_y, n_x), depth of the pixel's segment; NaN where no depth is claimed.
        confidence: shape (n_y, n_x), 0 to 1; 0 where no depth is claimed.
        segment: shape (n_y, n_x), number of the segment from 1; 0 for none.
        origin_um: (x, y) on the sensor of the centre of pixel [0, 0].
        pixel_um: pixel pitch.
        segments: figures of each segment.
        depth_pixel_m: shape (n_y, n_x), depth of each pixel from the window about it; NaN where none is claimed.
        contrast_error: shape (n_y, n_x), standard error of each pixel's contrast by photon and read noise; NaN where
            there is no signal.
        nmae: mean |depth error| / depth over decoded pixels with known truth; None without truth.
        details: figures of the computing (seconds, pixels skipped and why, ...).
    """

    intensity_x: FloatArray
    intensity_y: FloatArray
    contrast: FloatArray
    depth_m: FloatArray
    confidence: FloatArray
    segment: NDArray[np.int32]
    origin_um: tuple[float, float]
    pixel_um: float
    segments: tuple[SegmentFigures, ...] = ()
    depth_pixel_m: FloatArray | None = None
    contrast_error: FloatArray | None = None
    nmae: float | None = None
    details: dict[str, float | str] = field(default_factory=dict)
