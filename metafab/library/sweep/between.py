"""Between the sizes of the grid: where models that agree on the grid still disagree, on the sharpest resonances.

A resonance may be narrower than a step of the grid, and so may a false one: a pole with a zero beside it, which no
sample on the grid contradicts. The disagreement is therefore taken on a finer grid, and sizes where it is too large
are solved there until none is left. They are no sizes of the library; they only tell its model apart from false ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from metafab.cell import PillarCell
from metafab.core.conventions import FloatArray
from metafab.library.fit.certificate import spread
from metafab.library.fit.models import ModelPair, Samples
from metafab.library.fit.sampling import IndexArray, SizeGrid, worst_points
from metafab.library.sweep.adaptive_sampling import Outcome, PointSolver, amplitudes_of, fit_solved, misses, shortfall
from metafab.library.sweep.checkpoint import SolvedPoint
from metafab.spec import UnitCell

#: Steps of the finer grid for each of the sizes' own.
PARTS = 8
#: Sizes of one round, and rounds at most: what disagrees after them is stated, not chased.
ROUND, MOST_ROUNDS = 12, 8


@dataclass(frozen=True)
class Between:
    """What is known between the sizes of the grid, and of the models in the end.

    Attributes:
        solved: number on the finer grid -> answer, in the order of solution.
        models: the continuous model and its rival; None as in :class:`Outcome`.
        model_error: shape (n_length, n_width), estimate of the model's error at each size of the grid.
        between_error: the same shape, estimate of its error around each size, up to half a step away.
    """

    solved: dict[int, SolvedPoint]
    models: ModelPair | None
    model_error: FloatArray
    between_error: FloatArray


@dataclass(frozen=True)
class FineGrid:
    """The finer grid, whose points a checkpoint keeps under numbers that follow those of the sizes.

    Attributes:
        grid: its points.
        first_number: of its first point.
    """

    grid: SizeGrid
    first_number: int

    @classmethod
    def of(cls, grid: SizeGrid) -> FineGrid:
        """The grid between the points of another."""
        return cls(grid.refined(PARTS), grid.size)

    @property
    def end_number(self) -> int:
        """The first number that is no longer its own."""
        return self.first_number + self.grid.size

    def cell(self, unit_cell: UnitCell, number: int) -> PillarCell:
        """The cell of a number."""
        return self.grid.cell(unit_cell, number - self.first_number)


def sample_between(
    grid: SizeGrid, fine: FineGrid, outcome: Outcome, solve_points: PointSolver, tolerance: float
) -> Between:
    """Solve sizes off the grid until the models agree between its sizes, too, at most ``MOST_ROUNDS`` times.

    Args:
        grid: the sizes.
        fine: where to look between them.
        outcome: what was found at the sizes.
        solve_points: solves cells by their numbers in the checkpoint.
        tolerance: of the models.
    """
    models, factor = outcome.models, outcome.factor
    if models is None:
        zeros = np.zeros((grid.length_nm.size, grid.width_nm.size))
        return Between({}, None, zeros, zeros)
    solved: dict[int, SolvedPoint] = {}
    disagreement = _disagreement(fine.grid, models)
    for _ in range(MOST_ROUNDS):
        batch = _open(fine.grid, factor * disagreement, solved, tolerance)
        if not batch.size:
            break
        foreseen = len(outcome.solved) + len(solved) + batch.size
        answers = solve_points(batch + fine.first_number, foreseen)
        new = {number - fine.first_number: point for number, point in answers.items()}
        factor = max(factor, shortfall(*misses(models.best, fine.grid, new), disagreement.ravel()[batch]))
        solved |= new
        off_grid = Samples(*fine.grid.sizes_nm(np.array(list(solved))), amplitudes_of(list(solved.values())))
        models = fit_solved(grid, outcome.solved, outcome.held_out, off_grid)
        disagreement = _disagreement(fine.grid, models)
    estimate = np.maximum(np.maximum(factor * disagreement, outcome.held_out_rms), left_over(fine.grid, models, solved))
    around = spread(maximum_filter(estimate, size=PARTS + 1, mode="nearest")[::PARTS, ::PARTS], grid.exchange)
    on_grid = factor * spread(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)
    on_grid = np.maximum(on_grid, outcome.held_out_rms)
    return Between(solved, models, on_grid, np.maximum(around, on_grid))


def _disagreement(fine: SizeGrid, models: ModelPair) -> FloatArray:
    return spread(models.disagreement(fine.width_nm, fine.length_nm), fine.exchange)


def left_over(fine: SizeGrid, models: ModelPair, solved: dict[int, SolvedPoint]) -> FloatArray:
    """What the model misses at solved points beyond the solver's error; 0 elsewhere."""
    left = np.zeros(fine.size)
    if solved:
        miss, certificate = misses(models.best, fine, solved)
        left[list(solved)] = np.maximum(miss - certificate, 0.0)
    on_grid = left.reshape(fine.length_nm.size, fine.width_nm.size)
    return np.maximum(on_grid, on_grid.T) if fine.exchange else on_grid


def _open(fine: SizeGrid, estimate: FloatArray, solved: dict[int, SolvedPoint], tolerance: float) -> IndexArray:
    """The worst points above the tolerance, a few steps from each other."""
    is_solved = np.zeros(fine.size, dtype=bool)
    is_solved[list(solved)] = True
    worst = worst_points(fine, estimate, is_solved, ROUND)
    return worst[estimate.ravel()[worst] > tolerance]
