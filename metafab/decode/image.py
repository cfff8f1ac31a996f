"""The decoded 4D image: two intensities, their contrast, depth, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class Image4D:
    """All-in-focus polarisation images and depth on the geometric image grid of the x polarisation.

    Attributes:
        intensity_x: shape (n_y, n_x), electrons; likewise ``intensity_y``.
        contrast: I_x / I_y, NaN where there is no signal.
        depth_m: NaN where no depth is claimed.
        confidence: 0 to 1; 0 where no depth is claimed.
        segment: number of the segment from 1; 0 for none.
        origin_um: (x, y) on the sensor of the centre of pixel [0, 0].
        pixel_um: pixel pitch.
        segments: one row a segment: number, pixels, depth, its standard error and slope, mean contrast and its standard
            error.
        depth_pixel_m: shape (n_y, n_x), depth of each pixel from its own neighbourhood alone, NaN where none is
            claimed; ``depth_m`` holds the depth of its segment.
        contrast_error: shape (n_y, n_x), standard error of each pixel's contrast by photon and read noise, NaN where
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
    segments: tuple[dict[str, float], ...] = ()
    depth_pixel_m: FloatArray | None = None
    contrast_error: FloatArray | None = None
    nmae: float | None = None
    details: dict[str, float | str] = field(default_factory=dict)
