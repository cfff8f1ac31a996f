"""Confidence of a decoded depth: the one place that defines it.

The confidence of a pixel falls with the relative error e of its depth as 1 / (1 + (e / e_half)^2). The error is the
smaller one of the pixel's and its segment's standard error, plus (in quadrature) the disagreement between the two
depths, as far as the pixel's own noise does not explain it.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray

#: Relative standard error of depth at which the confidence is one half.
HALF_CONFIDENCE = 0.01
#: Relative standard error from which no depth is claimed.
LARGEST_ERROR = 4.0 * HALF_CONFIDENCE
#: Standard errors of the pixel's depth that explain a disagreement with the segment's depth.
_EXPLAINED_ERRORS = 2.0


def confidence(
    pixel_error: FloatArray, segment_error: FloatArray, disagreement: FloatArray, claimed: np.ndarray
) -> FloatArray:
    """Confidence of each pixel's depth, 0 to 1.

    Args:
        pixel_error: shape (n_y, n_x), relative standard error of the depth from the window about the pixel.
        segment_error: shape (n_y, n_x), relative standard error of the depth of the pixel's segment.
        disagreement: shape (n_y, n_x), relative difference of the two depths, not negative.
        claimed: shape (n_y, n_x), whether the pixel has a depth of its own.

    Returns:
        Shape (n_y, n_x).
    """
    error = np.minimum(np.where(claimed, pixel_error, np.inf), segment_error)
    unexplained = np.maximum(disagreement - _EXPLAINED_ERRORS * pixel_error, 0.0)
    error = np.hypot(error, np.where(claimed, unexplained, 0.0))
    return np.asarray(1.0 / (1.0 + (error / HALF_CONFIDENCE) ** 2))
