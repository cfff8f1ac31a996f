"""Adaptive sampling between the sizes of the grid.

A resonance may be narrower than a step of the grid. So may a false one, a pole with a zero next to it, which no sample
on the grid contradicts. The models' disagreement is therefore evaluated on a finer grid, and sizes are solved there
until it is small everywhere.

A model may also be right on a resonance where the error bound is too large: the solved sizes around it are less steep,
and :func:`~metafab.library.fit.certificate.solver_errors` scales their certificates by the ratio of slopes. A size
solved at the steepest place has a certificate of its own.

Sizes off the grid are no sizes of the library. They only improve its model and error bounds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter

from metafab.cell import PillarCell
from metafab.core.conventions import FloatArray
from metafab.library.fit.certificate import SUBSTEPS, amplitude_slopes, disagreement_estimate, solver_errors
from metafab.library.fit.models import RankedModels
from metafab.library.fit.size_grid import IndexArray, SizeGrid, worst_points
from metafab.library.sweep.adaptive_sampling import (
    FitModels,
    GridSampling,
    PointSolver,
    error_ratio,
    fit_solved,
    prediction_errors,
    samples_at,
)
from metafab.library.sweep.checkpoint import SolvedPoint
from metafab.spec import UnitCell

#: Steps of the finer grid for each step of the grid of sizes.
PARTS = 8


@dataclass(frozen=True)
class RoundLimits:
    """Limits of the rounds off the grid; errors that remain after them are part of the error bounds.

    Attributes:
        disagreement_sizes: sizes of a round against disagreement.
        disagreement_rounds: rounds against disagreement.
        steep_sizes: sizes of a round at steep places.
        steep_rounds: rounds at steep places.
    """

    disagreement_sizes: int = 12
    disagreement_rounds: int = 8
    steep_sizes: int = 24
    steep_rounds: int = 4


@dataclass(frozen=True)
class OffGridSampling:
    """Result of the sampling between the sizes of the grid.

    Attributes:
        solved: answers by number on the finer grid, in the order of solution.
        models: continuous models; None if every size of the grid was solved.
        model_error: shape (n_length, n_width), estimate of the model's error at each size of the grid.
        between_error: shape (n_length, n_width), estimate of its error up to half a step around each size.
    """

    solved: dict[int, SolvedPoint]
    models: RankedModels | None
    model_error: FloatArray
    between_error: FloatArray


@dataclass(frozen=True)
class FineGrid:
    """The finer grid; in a checkpoint its points have numbers after those of the sizes.

    Attributes:
        grid: points of the finer grid.
        first_number: checkpoint number of its first point.
    """

    grid: SizeGrid
    first_number: int

    @classmethod
    def of(cls, grid: SizeGrid) -> FineGrid:
        """Return the finer grid of a grid of sizes."""
        return cls(grid.refined(PARTS), grid.size)

    @property
    def end_number(self) -> int:
        """The first checkpoint number after its points."""
        return self.first_number + self.grid.size

    def cell(self, unit_cell: UnitCell, number: int) -> PillarCell:
        """Return the cell of a checkpoint number."""
        return self.grid.cell(unit_cell, number - self.first_number)

    def solve(self, solve_points: PointSolver, batch: IndexArray, already_solved: int) -> dict[int, SolvedPoint]:
        """Solve points of the finer grid.

        Args:
            solve_points: solves cells by checkpoint number.
            batch: shape (n,), numbers on the finer grid.
            already_solved: cells that the build solved before.

        Returns:
            Answers by number on the finer grid.
        """
        answers = solve_points(batch + self.first_number, already_solved + batch.size)
        return {number - self.first_number: point for number, point in answers.items()}


def sample_disagreement(
    grid: SizeGrid,
    fine: FineGrid,
    sampling: GridSampling,
    solve_points: PointSolver,
    tolerance: float,
    limits: RoundLimits = RoundLimits(),
    fit: FitModels = fit_solved,
) -> OffGridSampling:
    """Solve sizes off the grid until the models agree between its sizes, too.

    Args:
        grid: sizes.
        fine: finer grid.
        sampling: result on the grid.
        solve_points: solves cells by checkpoint number.
        tolerance: largest error of the model.
        limits: sizes and number of the rounds.
        fit: fits the models.
    """
    models, factor = sampling.models, sampling.safety_factor
    if models is None:
        return OffGridSampling({}, None, np.zeros(grid.shape), np.zeros(grid.shape))
    solved: dict[int, SolvedPoint] = {}
    disagreement = _disagreement(fine.grid, models)
    for _ in range(limits.disagreement_rounds):
        is_solved = np.zeros(fine.grid.size, dtype=bool)
        is_solved[list(solved)] = True
        estimate = factor * disagreement
        batch = worst_points(fine.grid, estimate, is_solved, limits.disagreement_sizes)
        batch = batch[estimate.ravel()[batch] > tolerance]
        if not batch.size:
            break
        new = fine.solve(solve_points, batch, len(sampling.solved) + len(solved))
        factor = max(factor, error_ratio(*prediction_errors(models.best, fine.grid, new), disagreement.ravel()[batch]))
        solved |= new
        models = fit(grid, sampling.solved, sampling.held_out, samples_at(fine.grid, solved))
        disagreement = _disagreement(fine.grid, models)
    estimate = np.maximum(factor * disagreement, sampling.held_out_rms)
    around = _around(np.maximum(estimate, _residual(fine.grid, models, solved)))
    on_grid = factor * _disagreement(grid, models)
    on_grid = np.maximum(on_grid, sampling.held_out_rms)
    around = disagreement_estimate(around, grid.exchange)
    return OffGridSampling(solved, models, on_grid, np.maximum(around, on_grid))


def sample_steep_places(
    grid: SizeGrid,
    fine: FineGrid,
    sampling: GridSampling,
    off_grid: OffGridSampling,
    solve_points: PointSolver,
    target: float,
    limits: RoundLimits = RoundLimits(),
) -> OffGridSampling:
    """Solve the steepest places around sizes whose error bound is above the target.

    Args:
        grid: sizes.
        fine: finer grid.
        sampling: result on the grid.
        off_grid: result of :func:`sample_disagreement`.
        solve_points: solves cells by checkpoint number.
        target: largest error bound of solver and model together.
        limits: sizes and number of the rounds.

    Returns:
        ``off_grid`` with the new answers, and with the model's errors at them.
    """
    if off_grid.models is None:
        return off_grid
    slope = amplitude_slopes(off_grid.models.best, grid.width_nm, grid.length_nm)
    for _ in range(limits.steep_rounds):
        bound = certified_errors(grid, fine, sampling, off_grid)[1] + off_grid.between_error
        worst = worst_points(grid, bound, (bound <= target).ravel(), limits.steep_sizes)
        places = dict.fromkeys(_steepest(fine, slope, *divmod(int(k), grid.width_nm.size)) for k in worst)
        batch = np.array([number for number in places if number not in off_grid.solved], dtype=np.intp)
        if not batch.size:
            break
        new = fine.solve(solve_points, batch, len(sampling.solved) + len(off_grid.solved))
        residual = _around(_residual(fine.grid, off_grid.models, new))
        between_error = np.maximum(off_grid.between_error, residual)
        off_grid = replace(off_grid, solved={**off_grid.solved, **new}, between_error=between_error)
    return off_grid


def certified_errors(
    grid: SizeGrid, fine: FineGrid, sampling: GridSampling, off_grid: OffGridSampling
) -> tuple[FloatArray, FloatArray]:
    """Return the solver's error at every size, and around it: shape (n_length, n_width) each."""
    on_numbers, off_numbers = (np.array(list(each), dtype=np.intp) for each in (sampling.solved, off_grid.solved))
    error = np.array([point.error for point in (*sampling.solved.values(), *off_grid.solved.values())])
    sizes_nm = np.concatenate([grid.sizes_nm(on_numbers), fine.grid.sizes_nm(off_numbers)], axis=1)
    if grid.exchange:
        sizes_nm, error = np.concatenate([sizes_nm, sizes_nm[::-1]], axis=1), np.tile(error, 2)
    return solver_errors(grid, sizes_nm, error, None if off_grid.models is None else off_grid.models.best)


def _disagreement(grid: SizeGrid, models: RankedModels) -> FloatArray:
    return disagreement_estimate(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)


def _residual(fine: SizeGrid, models: RankedModels, solved: dict[int, SolvedPoint]) -> FloatArray:
    """Error of the model at solved points beyond the solver's error, 0 elsewhere: shape (n_length, n_width)."""
    residual = np.zeros(fine.size)
    if solved:
        miss, certificate = prediction_errors(models.best, fine, solved)
        residual[list(solved)] = np.maximum(miss - certificate, 0.0)
    on_grid = residual.reshape(fine.shape)
    return np.maximum(on_grid, on_grid.T) if fine.exchange else on_grid


def _around(fine_error: FloatArray) -> FloatArray:
    """Largest value up to half a step around each size of the grid."""
    return np.asarray(maximum_filter(fine_error, size=PARTS + 1, mode="nearest")[::PARTS, ::PARTS], dtype=np.float64)


def _steepest(fine: FineGrid, slope: FloatArray, row: int, column: int) -> int:
    """Number on the finer grid of the steepest place up to half a step around a size.

    Args:
        fine: finer grid.
        slope: shape ((n_length - 1) SUBSTEPS + 1, (n_width - 1) SUBSTEPS + 1).
        row: of the size on the grid.
        column: of the size on the grid.
    """
    half, scale = SUBSTEPS // 2, PARTS // SUBSTEPS
    top, left = max(row * SUBSTEPS - half, 0), max(column * SUBSTEPS - half, 0)
    window = slope[top : row * SUBSTEPS + half + 1, left : column * SUBSTEPS + half + 1]
    down, right = np.unravel_index(int(np.argmax(window)), window.shape)
    return (top + int(down)) * scale * fine.grid.width_nm.size + (left + int(right)) * scale
