"""Doubt of segments by the depths of single pixels: what lies away from outlines and is seen elsewhere.

A plane that stands for a curved surface has a small error, because it averages many pixels, and in little light its
misfit hides in the noise. The depths of the pixels themselves then differ from it over whole parts of it. Away from
outlines no mixture of depths explains that. Of such pixels, 0 to 5 % of a right segment's differ clearly, of one in
thirty 15 %; of planes that took the place of hills, rooms and blobs in 300 to 500 electrons, 10 to 95 %. Pixels about
which the sharp images show no texture do not count: their own depth is that of what stands nearby, by its blur.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.decode.confidence import RIGHT_WITHIN, beside_outlines
from metafab.decode.images.contrast_outlines import block_sums
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.objects.plain_behind import PlainPixels
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame

#: Standard errors beyond which a pixel's own depth differs clearly, and distance from outlines, frame pixels.
_CLEARLY, _AWAY_PX = 3.0, 20.0
#: Side of the window about a pixel, frame pixels, and least share of it that must be judged.
_WINDOW_PX, _LEAST_JUDGED = 40.0, 0.1
#: Share of the judged pixels about a place that differ up to which nothing is doubted, and from which all is.
_FEW_ABOUT, _MANY_ABOUT = 0.3, 0.7
#: Share of a segment's judged pixels that differ in right segments, and probability of a wrong depth for each share
#: beyond: noise hides two in three of the pixels that are elsewhere.
_USUAL, _HIDDEN = 0.06, 3.0


def plain_pixels(prepared: PreparedFrame, sharp: SharpImages) -> PlainPixels:
    """Pixels of a frame, or of a part of it, whose sharp images show no texture."""
    step = prepared.downsampling.step
    light = block_sums(np.ascontiguousarray(sharp.images), step, prepared.lit.shape)
    return PlainPixels.of(light, prepared.lit, step)


def seen_elsewhere(
    pixels: PixelDepth,
    label: NDArray[np.int32],
    vergence_per_m: FloatArray,
    step: int,
    plain_of: Callable[[], PlainPixels] | None = None,
) -> FloatArray:
    """Probability that a pixel's segment is wrong, from the own depths of the pixels about it: shape (n_y, n_x).

    Args:
        pixels: own depths.
        label: shape (n_y, n_x), number of each pixel's segment, 0 for none.
        vergence_per_m: shape (n_y, n_x), 1/depth of each pixel's segment; NaN for none.
        step: frame pixels from one downsampled pixel to the next.
        plain_of: returns the plain pixels; called where some pixels are seen elsewhere. Without, all pixels count.
    """
    outlines = beside_outlines(vergence_per_m)
    judged = pixels.claimed & (label > 0) & (distance(outlines) * step > _AWAY_PX)
    off_per_m = np.abs(pixels.vergence_per_m - vergence_per_m)
    error_per_m = pixels.relative_error * pixels.vergence_per_m
    differs = judged & (off_per_m > np.maximum(RIGHT_WITHIN * vergence_per_m, _CLEARLY * error_per_m))
    doubt = _doubt(differs, judged, label, step)
    if plain_of is None or not doubt.any():
        return doubt
    shows = ~plain_of().smoothed
    return _doubt(differs & shows, judged & shows, label, step)


def _doubt(differs: NDArray[np.bool_], judged: NDArray[np.bool_], label: NDArray[np.int32], step: int) -> FloatArray:
    """Probability that a pixel's segment is wrong, by pixels whose own depth differs from their segment's.

    It, the pixels that differ, those judged and the segments have the shape (n_y, n_x).
    """
    nearby = window_means(np.stack([differs, judged]).astype(np.float32), round(_WINDOW_PX / step) | 1)
    about = np.where(nearby[1] > _LEAST_JUDGED, nearby[0] / np.maximum(nearby[1], _LEAST_JUDGED), 0.0)
    of_place = np.clip((about - _FEW_ABOUT) / (_MANY_ABOUT - _FEW_ABOUT), 0.0, 1.0)
    counts = [np.bincount(label[which], minlength=int(label.max(initial=0)) + 1) for which in (differs, judged)]
    # The windows of neighbours overlap: what one window judges is one sample, and so is what is known beforehand.
    window = WINDOW_PX**2 / step**2
    share = (counts[0] + _USUAL * window) / (counts[1] + window)
    of_segment = np.clip(_HIDDEN * (share - _USUAL), 0.0, 1.0)
    return np.maximum(of_place, of_segment[label]).astype(np.float64)
