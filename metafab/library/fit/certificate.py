"""From what models and solver know to the error that is stated at every size, solved or not."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter, median_filter
from scipy.spatial import cKDTree

from metafab.core.conventions import FloatArray
from metafab.library.fit.models import SizeModel
from metafab.library.fit.sampling import SizeGrid

#: The solver's error at a size that was not solved is the largest among this many solved neighbours.
NEIGHBOURS = 4
#: Sizes nearer than this are the same.
_SAME_NM = 1e-6
#: Steps of the grid across the neighbourhood with whose slope a size's own is compared.
STEEPNESS_WINDOW = 9
#: Parts of a step over which slopes are taken: a ridge may be narrower than a step.
SUBSTEPS = 4
#: Sizes whose amplitudes are e times as steep are as unlike as sizes so far apart.
LIKENESS_NM = 40.0


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


def solver_errors(
    grid: SizeGrid, sizes_nm: FloatArray, error: FloatArray, model: SizeModel | None
) -> tuple[FloatArray, FloatArray]:
    """The solver's error at every size, and around it, from the certificates of the sizes that were solved.

    A truncation shifts resonances by a little, so that its error is large where the amplitudes are steep. A size that
    was not solved therefore takes its certificate from the solved sizes that are most like it, near and as steep, and
    where it is steeper than one of those, so much more of it.

    Args:
        grid: the sizes.
        sizes_nm: shape (2, n), widths and lengths that were solved, mirror images too where the grid has them.
        error: shape (n,), their certificates.
        model: the amplitudes; None where every size was solved.

    Returns:
        Shape (n_length, n_width) each: at the sizes themselves, and the largest up to half a step away from them.
    """
    shape = (grid.length_nm.size, grid.width_nm.size)
    places = np.stack(grid.sizes_nm(np.arange(grid.size)), axis=-1)
    distance, nearest = cKDTree(sizes_nm.T).query(places)
    own = np.where(distance < _SAME_NM, error[nearest], np.nan)
    if model is None:
        return own.reshape(shape), own.reshape(shape)
    slope = slopes(model, grid.width_nm, grid.length_nm)
    slope = np.maximum(slope, np.median(slope))
    column, row = (
        np.rint((size - axis[0]) / max(axis[-1] - axis[0], _SAME_NM) * (count - 1)).astype(np.intp)
        for size, axis, count in zip(sizes_nm, (grid.width_nm, grid.length_nm), slope.shape[::-1], strict=True)
    )
    known = slope[row, column]
    tree = cKDTree(_likeness(sizes_nm.T, known))
    at, around = (
        _alike(tree, places, each[::SUBSTEPS, ::SUBSTEPS].ravel(), known, error)
        for each in (slope, maximum_filter(slope, size=SUBSTEPS + 1))
    )
    return np.where(np.isnan(own), at, own).reshape(shape), around.reshape(shape)


def _alike(tree: cKDTree, places: FloatArray, slope: FloatArray, known: FloatArray, error: FloatArray) -> FloatArray:
    """The largest of what the solved sizes most alike say about ``places`` with these slopes."""
    count = min(NEIGHBOURS, error.size)
    alike = tree.query(_likeness(places, slope), k=count)[1].reshape(-1, count)
    said = error[alike] * np.maximum(1.0, slope[:, None] / known[alike])
    return np.asarray(said.max(axis=-1), dtype=np.float64)


def _likeness(sizes_nm: FloatArray, slope: FloatArray) -> FloatArray:
    """Points whose distance says how unlike sizes are: shape (n, 2) and (n,) -> (n, 3)."""
    return np.concatenate([sizes_nm, LIKENESS_NM * np.log(slope)[:, None]], axis=1)


def steepness(model: SizeModel, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
    """How much steeper the amplitudes are around a size than in its wider neighbourhood, at least 1.

    A solver's error shifts a resonance by a little; on its flank that shows more than at the sizes beside it, whose
    certificates stand for the sizes between. The steepest place up to a step away counts, on the grid or off it.

    Returns:
        Shape (n_length, n_width).
    """
    slope = slopes(model, width_nm, length_nm)
    coarse = slope[::SUBSTEPS, ::SUBSTEPS]
    typical = np.maximum(median_filter(coarse, size=STEEPNESS_WINDOW), np.median(coarse))
    steepest = maximum_filter(slope, size=2 * SUBSTEPS + 1)[::SUBSTEPS, ::SUBSTEPS]
    ratio = np.divide(steepest, typical, out=np.ones_like(coarse), where=typical > 0.0)
    return np.asarray(np.maximum(ratio, 1.0), dtype=np.float64)


def slopes(model: SizeModel, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
    """How fast the amplitude that changes fastest does, on a grid of ``SUBSTEPS`` parts of each step."""
    values = model.on_grid(_finer(width_nm), _finer(length_nm))
    slope = np.zeros(values.shape[1:])
    for axis in (1, 2):
        if values.shape[axis] > 1:
            slope = np.hypot(slope, np.abs(np.gradient(values, axis=axis)).max(axis=0))
    return slope


def _finer(axis_nm: FloatArray) -> FloatArray:
    return np.linspace(axis_nm[0], axis_nm[-1], (axis_nm.size - 1) * SUBSTEPS + 1)
