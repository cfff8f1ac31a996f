"""Adaptive sampling between the sizes of the grid.

A resonance may be narrower than a step of the grid. So may a false one, a pole with a zero next to it, which no sample
on the grid contradicts. The models' disagreement is therefore evaluated on a finer grid, and sizes are solved there
until it is small everywhere.

A model may also be right on a resonance where the error bound is too large: the solved sizes around it are less steep,
and :func:`~metafab.library.fit.certificate.solver_errors` scales their certificates by the ratio of slopes. A size
solved at the steepest place has a certificate of its own; if that is not enough, the size of the grid itself is solved.

Sizes off the grid are no sizes of the library. They only improve its model and error bounds.

Sizes of the grid whose own bound is still above the target are solved last: no model has to know them then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter

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
    """Limits of the rounds off the grid; errors that remain after them are part of the error bounds."""

    disagreement_sizes: int = 12  #: Sizes of a round against disagreement.
    disagreement_rounds: int = 8  #: Rounds against disagreement.
    steep_sizes: int = 12  #: Sizes of a round at steep places: one answer counts for its neighbours as well.
    steep_rounds: int = 8  #: Rounds at steep places.

    @property
    def most_sizes(self) -> int:
        """Number of sizes that all rounds together may solve."""
        return self.disagreement_sizes * self.disagreement_rounds + self.steep_sizes * self.steep_rounds


@dataclass(frozen=True)
class OffGridSampling:
    """Result of the sampling between the sizes of the grid."""

    solved: dict[int, SolvedPoint]  #: Answers by number on the finer grid, in the order of solution.
    models: RankedModels | None  #: Continuous models; None if every size of the grid was solved.
    model_error: FloatArray  #: Shape (n_length, n_width), estimate of the model's error at each size of the grid.
    between_error: FloatArray  #: Shape (n_length, n_width), estimate of its error up to half a step around each size.


class OffGridSampler:
    """Adaptive sampling on a finer grid; in a checkpoint its points have numbers after those of the sizes.

    Args:
        unit_cell: unit cell with its sweep.
        sampling: result on the grid of sizes.
        solve_points: solves cells by checkpoint number; its ``cell_of`` gives the sizes of the grid.
        limits: sizes and number of the rounds.
        fit: fits the models.

    Attributes:
        grid: sizes.
        fine: finer grid.
        sampling: result on the grid of sizes, with those that :meth:`sample_open_sizes` solved.
        end_number: first checkpoint number after the points of the finer grid.
    """

    def __init__(
        self,
        unit_cell: UnitCell,
        sampling: GridSampling,
        solve_points: PointSolver,
        limits: RoundLimits = RoundLimits(),
        fit: FitModels = fit_solved,
    ) -> None:
        self.grid = SizeGrid.of(unit_cell)
        self.fine = self.grid.refined(PARTS)
        self.end_number = self.grid.size + self.fine.size
        self.sampling, self._limits, self._fit = sampling, limits, fit
        self._cell_of_size = solve_points.cell_of
        slopes = any(len(point.amplitudes) > 4 for point in sampling.solved.values())
        self._solve_points = replace(
            solve_points,
            cell_of=lambda number: self.fine.cell(unit_cell, number - self.grid.size),
            numerics=replace(solve_points.numerics, slopes=slopes),
        )

    def sample_disagreement(self, tolerance: float) -> OffGridSampling:
        """Solve sizes off the grid until the models agree to ``tolerance`` between the grid's sizes, too."""
        grid, fine, sampling = self.grid, self.fine, self.sampling
        models, factor = sampling.models, sampling.safety_factor
        if models is None:
            return OffGridSampling({}, None, np.zeros(grid.shape), np.zeros(grid.shape))
        solved: dict[int, SolvedPoint] = {}
        disagreement = _disagreement(fine, models)
        for _ in range(self._limits.disagreement_rounds):
            is_solved = np.zeros(fine.size, dtype=bool)
            is_solved[list(solved)] = True
            estimate = factor * disagreement
            batch = worst_points(fine, estimate, is_solved, self._limits.disagreement_sizes)
            batch = batch[estimate.ravel()[batch] > tolerance]
            if not batch.size:
                break
            new = self._solve(batch, len(solved))
            ratio = error_ratio(*prediction_errors(models.best, fine, new), disagreement.ravel()[batch])
            factor = max(factor, ratio)
            solved |= new
            models = self._fit(grid, sampling.solved, sampling.held_out, samples_at(fine, solved))
            disagreement = _disagreement(fine, models)
        estimate = np.maximum(factor * disagreement, sampling.held_out_rms)
        around = _around(np.maximum(estimate, _residual(fine, models, solved)))
        on_grid = np.maximum(factor * _disagreement(grid, models), sampling.held_out_rms)
        between = np.maximum(disagreement_estimate(around, grid.exchange), on_grid)
        return OffGridSampling(solved, models, on_grid, between)

    def sample_steep_places(self, off_grid: OffGridSampling, target: float) -> OffGridSampling:
        """Solve the steepest places around sizes whose error bound, solver and model together, is above ``target``.

        Returns ``off_grid`` with the new answers, and with the model's errors at them.
        """
        if off_grid.models is None:
            return off_grid
        slope = amplitude_slopes(off_grid.models.best, self.grid.width_nm, self.grid.length_nm)
        on_grid = {self._fine_number(*divmod(number, self.grid.width_nm.size)) for number in self.sampling.solved}
        for _ in range(self._limits.steep_rounds):
            bound = self.certified_errors(off_grid)[1] + off_grid.between_error
            batch = self._open_places(bound, target, slope, on_grid | off_grid.solved.keys())
            if not batch.size:
                break
            new = self._solve(batch, len(off_grid.solved), slopes=False)
            residual = _around(_residual(self.fine, off_grid.models, new))
            between_error = np.maximum(off_grid.between_error, residual)
            off_grid = replace(off_grid, solved={**off_grid.solved, **new}, between_error=between_error)
        return off_grid

    def sample_open_sizes(self, off_grid: OffGridSampling, target: float) -> OffGridSampling:
        """Solve the sizes of the grid whose own error bound, solver and model together, is above ``target``.

        Their answers go to ``sampling``. Models are not fitted again: a size that is solved needs none, and another fit
        could open other sizes. A solver that misses its own target at most sizes is not asked. Returns ``off_grid``
        with the model's errors at the new sizes.
        """
        grid, numerics = self.grid, replace(self._solve_points.numerics, slopes=False)
        stated = [point.error for point in self.sampling.solved.values()]
        if off_grid.models is None or np.median(stated) > numerics.target_error:
            return off_grid
        solve_sizes = replace(self._solve_points, cell_of=self._cell_of_size, numerics=numerics)
        while True:
            solved = self.sampling.solved
            unsolved = np.setdiff1d(grid.distinct, list(solved))
            bound = self.certified_errors(off_grid)[0] + off_grid.model_error
            open_sizes = unsolved[(np.maximum(bound, bound.T) if grid.exchange else bound).ravel()[unsolved] > target]
            if not open_sizes.size:
                return off_grid
            new = solve_sizes(open_sizes, len(solved) + len(off_grid.solved) + open_sizes.size)
            self.sampling = replace(self.sampling, solved=dict(sorted({**solved, **new}.items())))
            residual = _residual(grid, off_grid.models, new)
            off_grid = replace(off_grid, between_error=np.maximum(off_grid.between_error, residual))

    def certified_errors(self, off_grid: OffGridSampling) -> tuple[FloatArray, FloatArray]:
        """Return the solver's error at every size, and around it: shape (n_length, n_width) each."""
        solved = self.sampling.solved
        on_numbers, off_numbers = (np.array(list(each), dtype=np.intp) for each in (solved, off_grid.solved))
        error = np.array([point.error for point in (*solved.values(), *off_grid.solved.values())])
        sizes_nm = np.concatenate([self.grid.sizes_nm(on_numbers), self.fine.sizes_nm(off_numbers)], axis=1)
        if self.grid.exchange:
            sizes_nm, error = np.concatenate([sizes_nm, sizes_nm[::-1]], axis=1), np.tile(error, 2)
        return solver_errors(self.grid, sizes_nm, error, None if off_grid.models is None else off_grid.models.best)

    def _solve(self, batch: IndexArray, already_solved: int, *, slopes: bool = True) -> dict[int, SolvedPoint]:
        """Answers by number on the finer grid; without slopes where no model is fitted to them."""
        first, numerics = self.grid.size, self._solve_points.numerics
        solve_points = replace(self._solve_points, numerics=replace(numerics, slopes=numerics.slopes and slopes))
        answers = solve_points(batch + first, len(self.sampling.solved) + already_solved + batch.size)
        return {number - first: point for number, point in answers.items()}

    def _open_places(self, bound: FloatArray, target: float, slope: FloatArray, known: set[int]) -> IndexArray:
        """Numbers on the finer grid of a place, not ``known``, for each of the sizes with the largest bounds.

        A size whose places are all known is passed over: it would keep its neighbours from their turn. ``bound`` has
        the shape (n_length, n_width); sizes of at most ``target`` need no place. ``slope`` as in :meth:`_places`.
        """
        passed = (bound <= target).ravel()
        while True:
            worst = worst_points(self.grid, bound, passed, self._limits.steep_sizes).tolist()
            places = [self._places(slope, *divmod(size, self.grid.width_nm.size)) for size in worst]
            unknown = [next((place for place in each if place not in known), None) for each in places]
            if None not in unknown:
                return np.array(list(dict.fromkeys(unknown)), dtype=np.intp)
            passed[[size for size, place in zip(worst, unknown, strict=True) if place is None]] = True

    def _places(self, slope: FloatArray, row: int, column: int) -> tuple[int, int]:
        """Numbers on the finer grid of the steepest place up to half a step around a size, and of the size itself.

        ``slope`` has shape ((n_length - 1) SUBSTEPS + 1, (n_width - 1) SUBSTEPS + 1).
        """
        half, scale = SUBSTEPS // 2, PARTS // SUBSTEPS
        top, left = max(row * SUBSTEPS - half, 0), max(column * SUBSTEPS - half, 0)
        window = slope[top : row * SUBSTEPS + half + 1, left : column * SUBSTEPS + half + 1]
        down, right = np.unravel_index(int(np.argmax(window)), window.shape)
        steepest = (top + int(down)) * scale * self.fine.width_nm.size + (left + int(right)) * scale
        return steepest, self._fine_number(row, column)

    def _fine_number(self, row: int, column: int) -> int:
        """Number on the finer grid of a size."""
        return row * PARTS * self.fine.width_nm.size + column * PARTS


def _disagreement(grid: SizeGrid, models: RankedModels) -> FloatArray:
    return disagreement_estimate(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)


def _residual(grid: SizeGrid, models: RankedModels, solved: dict[int, SolvedPoint]) -> FloatArray:
    """Error of the model at solved points of a grid beyond the solver's error, 0 elsewhere: the grid's shape."""
    residual = np.zeros(grid.size)
    if solved:
        miss, certificate = prediction_errors(models.best, grid, solved)
        residual[list(solved)] = np.maximum(miss - certificate, 0.0)
    on_grid = residual.reshape(grid.shape)
    return np.maximum(on_grid, on_grid.T) if grid.exchange else on_grid


def _around(fine_error: FloatArray) -> FloatArray:
    """Largest value up to half a step around each size of the grid."""
    return np.asarray(maximum_filter(fine_error, size=PARTS + 1, mode="nearest")[::PARTS, ::PARTS], dtype=np.float64)
