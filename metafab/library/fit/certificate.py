"""Error bounds of all sizes, solved or not, from model disagreement and the solver's errors."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter, median_filter
from scipy.spatial import cKDTree

from metafab.core.conventions import FloatArray
from metafab.library.fit.rational import RationalModel
from metafab.library.fit.size_grid import IndexArray, SizeGrid, refined_axis

#: The solver's error at an unsolved size is the largest among this number of nearest solved sizes.
NEIGHBOURS = 4
#: Sizes closer than this are equal (nm).
_SAME_NM = 1e-6
#: Side of the window (grid steps) with whose median slope a size's own slope is compared.
STEEPNESS_WINDOW = 9
#: Parts of a grid step over which slopes are taken: a ridge may be narrower than a step.
SUBSTEPS = 4
#: Distance (nm) that counts as much as a factor e between slopes, in the search for the most similar solved sizes.
SLOPE_SCALE_NM = 40.0


def disagreement_estimate(disagreement: FloatArray, exchange: bool) -> FloatArray:
    """Turn the disagreement of two models, shape (n_length, n_width), into an error estimate of the same shape.

    Two surfaces may cross by chance, so each size takes the largest disagreement of its neighbours. No size gets
    less than the median, because smooth regions depend on all samples. With ``exchange`` (width and length can be
    swapped), both sizes of a swapped pair get the larger value.
    """
    worst = maximum_filter(disagreement, size=3, mode="nearest")
    worst = np.maximum(worst, np.median(worst))
    return np.maximum(worst, worst.T) if exchange else worst


def solver_errors(
    grid: SizeGrid, sizes_nm: FloatArray, error: FloatArray, model: RationalModel | None
) -> tuple[FloatArray, FloatArray]:
    """Bound the solver's error at and around every size by the certificates of the solved sizes.

    A truncation of the solver shifts resonances slightly, so its error is large where the amplitudes are steep. An
    unsolved size takes the largest certificate of the solved sizes nearest in position and slope, multiplied by the
    ratio of slopes where it is steeper than they are.

    Args:
        sizes_nm: shape (2, n), solved widths and lengths, their mirror images included where the grid has exchange.
        error: shape (n,), certificates of the solved sizes.
        model: amplitudes; None if every size was solved.

    Returns:
        Error at the sizes, and largest error up to half a step around them: shape (n_length, n_width) each.
    """
    places = np.stack(grid.sizes_nm(np.arange(grid.size)), axis=-1)
    distance, nearest = cKDTree(sizes_nm.T).query(places)
    certified = np.where(distance < _SAME_NM, error[nearest], np.nan)
    if model is None:
        return certified.reshape(grid.shape), certified.reshape(grid.shape)
    slope = amplitude_slopes(model, grid.width_nm, grid.length_nm)
    slope = np.maximum(slope, np.median(slope))
    column = _nearest(grid.width_nm, slope.shape[1], sizes_nm[0])
    row = _nearest(grid.length_nm, slope.shape[0], sizes_nm[1])
    solved_slope = slope[row, column]
    tree = cKDTree(_features(sizes_nm.T, solved_slope))

    def bound(slopes: FloatArray) -> FloatArray:
        """Largest certificate of the most similar solved sizes, scaled by the ratio of slopes."""
        at = slopes[::SUBSTEPS, ::SUBSTEPS].ravel()
        count = min(NEIGHBOURS, error.size)
        similar = tree.query(_features(places, at), k=count)[1].reshape(-1, count)
        scaled = error[similar] * np.maximum(1.0, at[:, None] / solved_slope[similar])
        return np.asarray(scaled.max(axis=-1), dtype=np.float64)

    around = bound(maximum_filter(slope, size=SUBSTEPS + 1))
    return np.where(np.isnan(certified), bound(slope), certified).reshape(grid.shape), around.reshape(grid.shape)


def steepness(model: RationalModel, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
    """Return the slope of the amplitudes around each size over the median slope of its neighbourhood, at least 1.

    It scales certificates of neighbouring solved sizes: a shifted resonance shows most on its flank. The steepest place
    up to one step away counts, on the grid or off it. Its shape is (n_length, n_width).
    """
    slope = amplitude_slopes(model, width_nm, length_nm)
    coarse = slope[::SUBSTEPS, ::SUBSTEPS]
    typical = np.maximum(median_filter(coarse, size=STEEPNESS_WINDOW), np.median(coarse))
    steepest = maximum_filter(slope, size=2 * SUBSTEPS + 1)[::SUBSTEPS, ::SUBSTEPS]
    ratio = np.divide(steepest, typical, out=np.ones_like(coarse), where=typical > 0.0)
    return np.asarray(np.maximum(ratio, 1.0), dtype=np.float64)


def amplitude_slopes(model: RationalModel, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
    """Return the slope of the steepest amplitude, per part of a step, on a grid with ``SUBSTEPS`` parts for each step.

    Its shape is ((n_length - 1) SUBSTEPS + 1, (n_width - 1) SUBSTEPS + 1).
    """
    values = model.on_grid(refined_axis(width_nm, SUBSTEPS), refined_axis(length_nm, SUBSTEPS))
    slope = np.zeros(values.shape[1:])
    for axis in (1, 2):
        if values.shape[axis] > 1:
            slope = np.hypot(slope, np.abs(np.gradient(values, axis=axis)).max(axis=0))
    return slope


def _nearest(axis_nm: FloatArray, count: int, size_nm: FloatArray) -> IndexArray:
    """Index of the nearest of ``count`` nodes at equal distances over an axis."""
    return np.asarray(np.rint((size_nm - axis_nm[0]) / max(axis_nm[-1] - axis_nm[0], _SAME_NM) * (count - 1)), np.intp)


def _features(sizes_nm: FloatArray, slope: FloatArray) -> FloatArray:
    """Points whose distance measures how different sizes are: sizes (n, 2) and slopes (n,) -> shape (n, 3)."""
    return np.concatenate([sizes_nm, SLOPE_SCALE_NM * np.log(slope)[:, None]], axis=1)
