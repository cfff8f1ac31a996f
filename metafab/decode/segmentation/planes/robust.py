"""A plane through cells that outliers do not move: least median of squares, refined by Tukey's biweight."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.spread import SIGMA_PER_MEDIAN
from metafab.decode.segmentation.planes.cells import Cells
from metafab.decode.segmentation.planes.plane import Plane

#: Fewest cells of a plane.
_FEWEST_CELLS = 8
#: A tilt is significant from this many standard errors, and from this relative change of vergence over the segment.
_SIGNIFICANT, _SMALLEST_RISE = 6.0, 5e-3
#: Distance from the plane, in typical distances, from which Tukey's biweight rejects a cell.
_TUKEY = 4.7
#: Fits, each weighted by the residuals of the one before.
_TUKEY_ROUNDS = 8
#: Random triples of cells that the least median of squares tries.
_TRIPLES = 200
#: Determinant of the normal equations over the product of their diagonal (Hadamard) of cells that lie on one line.
DEGENERATE = 1e-9


def fit_plane(cells: Cells) -> Plane | None:
    """Fit a plane to cells: least median of squares, refined by Tukey's biweight; None without a significant tilt."""
    known = np.isfinite(cells.error_per_m)
    if known.sum() < _FEWEST_CELLS:
        return None
    row, column, vergence = cells.row[known], cells.column[known], cells.vergence_per_m[known]
    weight = 1.0 / cells.error_per_m[known] ** 2
    centre = float(np.average(row, weights=weight)), float(np.average(column, weights=weight))
    design = np.stack([np.ones(row.size), row - centre[0], column - centre[1]], axis=1)
    solution, biweight, scale = _robust_plane(_triples(vergence.size), design, vergence, np.sqrt(weight))
    if not np.isfinite(scale):
        return None
    normal = design.T @ (design * (weight * biweight)[:, None]) / scale**2
    slope = solution[1:]
    slope_information = normal[1:, 1:] - np.outer(normal[1:, 0], normal[0, 1:]) / normal[0, 0]
    rise = float(np.ptp((design[:, 1:] @ slope)[biweight > 0.0])) if (biweight > 0.0).any() else 0.0
    if float(slope @ slope_information @ slope) < _SIGNIFICANT**2 or rise < _SMALLEST_RISE * abs(solution[0]):
        return None
    return Plane(float(solution[0]), (float(slope[0]), float(slope[1])), centre)


@lru_cache(maxsize=256)
def _triples(count: int) -> NDArray[np.int64]:
    """Random triples of ``count`` cells: shape (n_triples, 3), read-only."""
    triples = np.random.default_rng(0).integers(0, count, (_TRIPLES, 3))
    triples.flags.writeable = False
    return triples


@compiled
def _robust_plane(
    triples: NDArray[np.int64], design: FloatArray, vergence: FloatArray, root: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """The plane of least median residual, refined by Tukey's biweight.

    Args:
        triples: shape (n_triples, 3), cells through which planes are tried.
        design: shape (n, 3), 1 and the place of each cell along y and x.
        vergence: shape (n,), 1/depth of each cell.
        root: shape (n,), inverse standard error of each.

    Returns:
        Factors of the design's columns, biweight of each cell and scale of the residuals in standard errors; inf if the
        cells that count lie on one line.
    """
    solution = _least_median_of_squares(triples, design, vergence, root)
    biweight, scale, count = np.ones(vergence.size), 1.0, vergence.size
    for _ in range(_TUKEY_ROUNDS):
        residual = np.empty(count)
        for k in range(count):
            fitted = solution[0] * design[k, 0] + solution[1] * design[k, 1] + solution[2] * design[k, 2]
            residual[k] = abs(vergence[k] - fitted) * root[k]
        scale = max(1.0, SIGMA_PER_MEDIAN * _median(residual))
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for k in range(count):
            kept = max(1.0 - (residual[k] / (_TUKEY * scale)) ** 2, 0.0)
            biweight[k] = kept * kept
            weight = root[k] * root[k] * biweight[k]
            for i in range(3):
                right[i] += weight * vergence[k] * design[k, i]
                for j in range(3):
                    normal[i, j] += weight * design[k, i] * design[k, j]
        if not _determinant(normal) > DEGENERATE * normal[0, 0] * normal[1, 1] * normal[2, 2]:
            return solution, biweight, np.inf
        before, solution = solution, _solved(normal, right)
        change = 0.0
        for k in range(count):
            moved = 0.0
            for i in range(3):
                moved += design[k, i] * (solution[i] - before[i])
            change = max(change, abs(moved))
        if change < 1e-9 * abs(solution[0]):
            break
    return solution, biweight, scale


@compiled
def _least_median_of_squares(
    triples: NDArray[np.int64], design: FloatArray, vergence: FloatArray, root: FloatArray
) -> FloatArray:
    """Of planes through triples of cells, the one of least median residual: a third of the cells may be outliers."""
    best, least = np.array([_median(vergence), 0.0, 0.0]), np.inf
    middle, corners, at, residual = vergence.size // 2, np.empty((3, 3)), np.empty(3), np.empty(vergence.size)
    lowest, highest = design[0].copy(), design[0].copy()
    for k in range(1, vergence.size):
        for i in range(3):
            lowest[i], highest[i] = min(lowest[i], design[k, i]), max(highest[i], design[k, i])
    narrow = 0.1 * (highest[1] - lowest[1]) * (highest[2] - lowest[2])
    for triple in range(triples.shape[0]):
        for i in range(3):
            at[i] = vergence[triples[triple, i]]
            for j in range(3):
                corners[i, j] = design[triples[triple, i], j]
        # A cell that is picked twice gives no area.
        if not abs(_determinant(corners)) > narrow:
            continue
        plane, smaller = _solved(corners, at), 0
        for k in range(vergence.size):
            fitted = plane[0] * design[k, 0] + plane[1] * design[k, 1] + plane[2] * design[k, 2]
            residual[k] = abs(vergence[k] - fitted) * root[k]
            smaller += residual[k] < least
        # The median is sought only where it is less.
        if smaller > middle:
            best, least = plane, _kth_smallest(residual, middle)
    return best


@compiled
def _determinant(a: FloatArray) -> float:
    """Determinant of a matrix of shape (3, 3)."""
    return float(
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@compiled
def _solved(a: FloatArray, b: FloatArray) -> FloatArray:
    """Solution of a linear system, shapes (3, 3) and (3,), by Cramer's rule: shape (3,)."""
    determinant, out, replaced = _determinant(a), np.empty(3), a.copy()
    for column in range(3):
        for row in range(3):
            replaced[row, column] = b[row]
        out[column] = _determinant(replaced) / determinant
        for row in range(3):
            replaced[row, column] = a[row, column]
    return out


@compiled
def _median(values: FloatArray) -> float:
    """Median of values, shape (n,), as ``numpy.median``, which takes a second to compile."""
    return 0.5 * (_kth_smallest(values, (values.size - 1) // 2) + _kth_smallest(values, values.size // 2))


@compiled
def _kth_smallest(values: FloatArray, k: int) -> float:
    """``numpy.partition(values, k)[k]`` of finite values, shape (n,), by Hoare's quickselect.

    That of numba takes five seconds to compile.
    """
    parted, first, last = values.copy(), 0, values.size - 1
    while first < last:
        pivot, i, j = parted[(first + last) // 2], first, last
        while i <= j:
            while parted[i] < pivot:
                i += 1
            while parted[j] > pivot:
                j -= 1
            if i <= j:
                parted[i], parted[j] = parted[j], parted[i]
                i += 1
                j -= 1
        first, last = (first if k <= j else i if k >= i else k), (j if k <= j else last if k >= i else k)
    return float(parted[k])
