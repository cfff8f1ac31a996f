"""Maxima between samples."""

from __future__ import annotations

import math

import numpy as np

from metafab.core.conventions import FloatArray


def parabolic_maximum(values: FloatArray) -> float:
    """Return the index of the maximum of ``values``, shape (n,), by a parabola through the three highest samples.

    NaN if the largest sample is the first or the last one.
    """
    top = int(np.argmax(values))
    if top in {0, values.size - 1}:
        return math.nan
    below, at, above = values[top - 1 : top + 2]
    return float(top + 0.5 * (above - below) / (2.0 * at - below - above))
