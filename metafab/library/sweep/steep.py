"""Steep places: solved until what is stated around every size is within the target, at the steepest places, too.

A model may be right on a resonance where no certificate of the solver says so: the solved sizes around it are less
steep, and :func:`metafab.library.fit.certificate.solver_errors` states so much more than they do. A size solved at the
steepest place has a certificate of its own. It is also one more size that the model could not know.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter

from metafab.core.conventions import FloatArray
from metafab.library.fit.certificate import SUBSTEPS, slopes, solver_errors
from metafab.library.fit.sampling import IndexArray, SizeGrid, worst_points
from metafab.library.sweep.adaptive_sampling import Outcome, PointSolver
from metafab.library.sweep.between import PARTS, Between, FineGrid, left_over

#: Sizes of one round, and rounds at most: what is above the target after them is stated.
ROUND, MOST_ROUNDS = 24, 4


def sample_steep(
    grid: SizeGrid, fine: FineGrid, outcome: Outcome, between: Between, solve_points: PointSolver, target: float
) -> Between:
    """Solve the steepest places around sizes that are not known to the target, at most ``MOST_ROUNDS`` times.

    Args:
        grid: the sizes.
        fine: where to solve between them.
        outcome: what was found at the sizes.
        between: what was found between them.
        solve_points: solves cells by their numbers in the checkpoint.
        target: largest error that is to be stated.

    Returns:
        ``between`` with the new answers, and with what the models missed at them.
    """
    if between.models is None:
        return between
    slope = slopes(between.models.best, grid.width_nm, grid.length_nm)
    for _ in range(MOST_ROUNDS):
        around = stated(grid, fine, outcome, between)[1] + between.between_error
        batch = _steepest(grid, fine, around, slope, between, target)
        if not batch.size:
            break
        answers = solve_points(batch + fine.first_number, len(outcome.solved) + len(between.solved) + batch.size)
        new = {number - fine.first_number: point for number, point in answers.items()}
        missed = _around(left_over(fine.grid, between.models, new))
        between = replace(
            between,
            solved={**between.solved, **new},
            between_error=np.maximum(between.between_error, missed),
        )
    return between


def stated(grid: SizeGrid, fine: FineGrid, outcome: Outcome, between: Between) -> tuple[FloatArray, FloatArray]:
    """The solver's error at every size and around it: shape (n_length, n_width) each."""
    solved, off_grid = (np.array(list(each), dtype=np.intp) for each in (outcome.solved, between.solved))
    error = np.array([point.error for point in (*outcome.solved.values(), *between.solved.values())])
    sizes_nm = np.concatenate([grid.sizes_nm(solved), fine.grid.sizes_nm(off_grid)], axis=1)
    if grid.exchange:
        sizes_nm, error = np.concatenate([sizes_nm, sizes_nm[::-1]], axis=1), np.tile(error, 2)
    return solver_errors(grid, sizes_nm, error, None if between.models is None else between.models.best)


def _around(fine_error: FloatArray) -> FloatArray:
    """The largest value up to half a step away from each size of the grid."""
    return np.asarray(maximum_filter(fine_error, size=PARTS + 1, mode="nearest")[::PARTS, ::PARTS], dtype=np.float64)


def _steepest(
    grid: SizeGrid, fine: FineGrid, around: FloatArray, slope: FloatArray, between: Between, target: float
) -> IndexArray:
    """Numbers on the finer grid of the steepest places around the worst sizes above the target."""
    worst = worst_points(grid, around, (around <= target).ravel(), ROUND)
    half, found = SUBSTEPS // 2, []
    for row, column in zip(*np.divmod(worst, grid.width_nm.size), strict=True):
        top, left = max(row * SUBSTEPS - half, 0), max(column * SUBSTEPS - half, 0)
        window = slope[top : row * SUBSTEPS + half + 1, left : column * SUBSTEPS + half + 1]
        down, right = np.unravel_index(int(np.argmax(window)), window.shape)
        scale = PARTS // SUBSTEPS
        found.append((top + int(down)) * scale * fine.grid.width_nm.size + (left + int(right)) * scale)
    return np.array([number for number in dict.fromkeys(found) if number not in between.solved], dtype=np.intp)
