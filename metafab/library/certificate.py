"""From what models and solver know to the error that is stated at every size, solved or not."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter, median_filter

from metafab.core.conventions import FloatArray
from metafab.library.models import SizeModel

#: The solver's error at a size that was not solved is the largest among this many solved neighbours.
NEIGHBOURS = 4
#: Steps of the grid across the neighbourhood with whose slope a size's own is compared.
STEEPNESS_WINDOW = 9
#: Parts of a step over which slopes are taken: a ridge may be narrower than a step.
SUBSTEPS = 4


def spread(disagreement: FloatArray, exchange: bool) -> FloatArray:
    """Disagreement as an error estimate: two surfaces may cross by chance, so each size takes its worst neighbour.

    Nowhere is it below the median: smooth regions owe their agreement to all samples alike. With exchange, both
    images of a size get the larger value.

    Args:
        disagreement: shape (n_length, n_width).
        exchange: whether width and length can be swapped.
    """
    worst = maximum_filter(disagreement, size=3, mode="nearest")
    worst = np.maximum(worst, np.median(worst))
    return np.maximum(worst, worst.T) if exchange else worst


def steepness(model: SizeModel, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
    """How much steeper the amplitudes are around a size than in its wider neighbourhood, at least 1.

    A solver's error shifts a resonance by a little; on its flank that shows more than at the sizes beside it, whose
    certificates stand for the sizes between. The steepest place up to a step away counts, on the grid or off it.

    Returns:
        Shape (n_length, n_width).
    """
    values = model.on_grid(_finer(width_nm), _finer(length_nm))
    slope = np.zeros(values.shape[1:])
    for axis in (1, 2):
        if values.shape[axis] > 1:
            slope = np.hypot(slope, np.abs(np.gradient(values, axis=axis)).max(axis=0))
    coarse = slope[::SUBSTEPS, ::SUBSTEPS]
    typical = np.maximum(median_filter(coarse, size=STEEPNESS_WINDOW), np.median(coarse))
    steepest = maximum_filter(slope, size=2 * SUBSTEPS + 1)[::SUBSTEPS, ::SUBSTEPS]
    ratio = np.divide(steepest, typical, out=np.ones_like(coarse), where=typical > 0.0)
    return np.asarray(np.maximum(ratio, 1.0), dtype=np.float64)


def _finer(axis_nm: FloatArray) -> FloatArray:
    return np.linspace(axis_nm[0], axis_nm[-1], (axis_nm.size - 1) * SUBSTEPS + 1)
