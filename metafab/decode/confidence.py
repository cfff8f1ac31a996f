"""Confidence of a decoded depth: the one place that defines it.

The confidence of a pixel is the probability that its depth is within 5 % of the truth: the probability that its segment
is the right one, times that of noise staying within 5 %. Along an outline it is lowered by the share of a downsampled
pixel that lies across it. Outlines between depths within 5 % of each other do not lower it.

A segment is doubted where the twins do not fit at its depth (misfit > 1), and near an outline, more so where they fit
the depth across it no worse. The log odds of a wrong segment are linear in these measures. Their weights were fitted
by maximum likelihood to the pixels of twelve frames, each with the same weight: edges, fences, small objects, six
objects with fractal textures and with photographs, and the small lens. Of the pixels above 0.9, those of fractal
textures and edges are wrong in 0 to 0.03 %, of photographs in 1.5 to 2.1 %: plain parts at an object's outline, which
fit the depth behind it as well. At outlines moved by contrast, and across them, 0.5 and 0.8 % are wrong in
two of the frames.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, expit

from metafab.core.conventions import FloatArray

Reals = NDArray[np.floating[Any]]

#: Relative error up to which a depth is right.
RIGHT_WITHIN = 0.05
#: Relative standard error from which no depth is claimed.
LARGEST_ERROR = 0.04
#: Scatter of segments' depths over their standard errors: 1.45 in 98 fits of small objects, 1.3 in windows of planes.
#: The errors of small segments reach 2 to 3 %, and those are wrong the most often.
SEGMENTS_SCATTER = 1.45
#: Probability of the right segment below which no depth is claimed: it is more likely wrong.
LEAST_RIGHT = 0.5
#: Weights of the log odds of a wrong segment: 1, log misfit, nearness of an outline within 8 and within 20 pixels, the
#: first times log misfit across the outline over the pixel's own, the second times log misfit.
_WEIGHTS = (-5.56, 1.50, 2.23, 3.60, -0.55, -1.55)
_NEAR_PX, _FAR_PX = 8.0, 20.0
#: Range to which the misfit is clipped.
_MISFITS = (0.3, 100.0)


def right_segment(misfit: Reals, misfit_across: Reals, outline_px: Reals) -> FloatArray:
    """Probability that each pixel's segment is the right one, shape (n_y, n_x), 0 to 1.

    Args:
        misfit: shape (n_y, n_x), null energy of the twins at the segment's depth over what noise explains.
        misfit_across: shape (n_y, n_x), the same at the depth across the nearest outline.
        outline_px: shape (n_y, n_x), distance of that outline, frame pixels; inf without one.
    """
    own, across = (np.log(np.clip(one, *_MISFITS)) for one in (misfit, misfit_across))
    near, far = (np.exp(-np.minimum(outline_px, 1e3) / px) for px in (_NEAR_PX, _FAR_PX))
    misfits = np.maximum(own, 0.0)
    measures = (1.0, misfits, near, far, near * np.clip(across - own, -2.0, 3.0), far * misfits)
    wrong = sum(weight * measure for weight, measure in zip(_WEIGHTS, measures, strict=True))
    return np.asarray(expit(-wrong))


def differs(vergence_per_m: FloatArray, other_per_m: FloatArray) -> NDArray[np.bool_]:
    """Whether a depth would be wrong where the other is right, for 1/depths of any one shape; False for NaN."""
    return np.asarray(np.abs(vergence_per_m - other_per_m) > RIGHT_WITHIN * vergence_per_m)


def beside_outlines(vergence_per_m: FloatArray) -> NDArray[np.bool_]:
    """Pixels next to one whose depth differs by more than 5 %, for 1/depths of shape (n_y, n_x): the same shape."""
    beside = np.zeros(vergence_per_m.shape, dtype=bool)
    for one, other in (((slice(1, None),), (slice(None, -1),)), ((..., slice(1, None)), (..., slice(None, -1)))):
        unlike = differs(vergence_per_m[one], vergence_per_m[other])
        beside[one] |= unlike
        beside[other] |= unlike
    return beside


def same_side(vergence_per_m: FloatArray, step: int) -> FloatArray:
    """Probability that a frame pixel lies on its downsampled pixel's side of an outline: shape (n_y, n_x).

    A downsampled pixel belongs to the side of most of its frame pixels, so that the outline lies anywhere within half a
    downsampled pixel of the border between two. The mean share across it is 1/8, or (1 - 1 / step^2) / 8 for an odd
    ``step``, where a pixel lies in the middle. Outlines on the frame's pixels run between downsampled ones
    (:mod:`metafab.decode.images.pixel_outlines`), which leaves four fifths of it in scenes of six objects.

    Args:
        vergence_per_m: shape (n_y, n_x), 1/depth of each downsampled pixel's segment; NaN for none.
        step: frame pixels from one downsampled pixel to the next.
    """
    across = (1.0 - step % 2 / step**2) / 8.0
    return np.where(beside_outlines(vergence_per_m), 1.0 - across, 1.0)


def confidence(pixel_error: FloatArray, segment_error: FloatArray, right: FloatArray | float) -> FloatArray:
    """Confidence of each pixel's depth, 0 to 1, shape (n_y, n_x).

    ``pixel_error`` and ``segment_error`` are relative standard errors of the depth, from the window about the pixel and
    of its segment; ``right`` is the probability that the segment is the right one. All have the shape (n_y, n_x).
    """
    error = np.maximum(np.minimum(pixel_error, segment_error), 1e-12)
    return np.asarray(right * erf(RIGHT_WITHIN / (np.sqrt(2.0) * error)))
