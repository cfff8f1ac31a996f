"""Adaptive sampling over the grid of sizes: solve a few sizes, model the rest, repeat until the error is small.

Each round fits two rational models of different degrees to the values at all solved sizes and, where the solver gives
them, to their slopes: fewer sizes then suffice. Meanwhile the workers solve the next sizes of a space-filling sequence,
which test the models as held-out samples. The ratio of held-out errors to the models' disagreement scales the
disagreement to an error estimate. The sizes with the largest estimate, on the ridges of guided modes, are solved next
and test the models as well. Sampling ends when the estimate at every unsolved size and the held-out errors are within
the tolerance, or when every size is solved. ``off_grid`` then samples between the sizes.

Decisions are taken between rounds only, so the result does not depend on the number of workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from metafab.cell import CellNumerics, CellSolver, PillarCell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress
from metafab.library.fit.certificate import disagreement_estimate
from metafab.library.fit.models import RankedModels, fit_size_models
from metafab.library.fit.rational import RationalModel, Samples
from metafab.library.fit.size_grid import IndexArray, SizeGrid, worst_points
from metafab.library.sweep.checkpoint import Checkpoint, SolvedPoint

Result = TypeVar("Result")
#: Fits models to the solved sizes of a grid: grid, answers by number, numbers of the held-out sizes, further samples.
FitModels = Callable[[SizeGrid, dict[int, SolvedPoint], IndexArray, Samples | None], RankedModels]

#: Number of sizes of the first round, and where the solver gives slopes as well: from 72 sizes of silicon with their
#: slopes models of some degrees were off by 2e-3, from 88 all of degree 10 and more by less than 5e-4.
FIRST_ROUND, FIRST_WITH_SLOPES = 112, 88
#: Rounds that fit slopes as well. Silicon at 800 nm takes two or three. Where more are needed, resonances are narrow:
#: amorphous silicon at 940 nm and silicon at 1550 nm took fewer sizes with slopes, but more of them on resonances and
#: 1.2 to 1.3 times the processor time, and silicon at 1550 nm had larger errors.
ROUNDS_WITH_SLOPES = 3
#: Space-filling sizes of a later round: least number, and least share of the sizes solved before.
EVEN_ROUND, EVEN_GROWTH = 16, 0.08
#: Sizes with the largest disagreement in a round: least number, and least share of the sizes solved before.
WORST_ROUND, WORST_GROWTH = 24, 0.12
#: Number of the latest sizes that rank the models' degrees.
RANKING = 48
#: Most sizes that a worker solves before it reports: more save messages, fewer lose less to a kill.
CHUNK = 4
#: Chunks in flight: enough to keep the workers of one machine busy.
AHEAD = 32


@dataclass(frozen=True)
class PointSolver:
    """Solve cells by number; cells in the checkpoint are not solved again."""

    cell_of: Callable[[int], PillarCell]  #: Maps a number to its cell.
    numerics: CellNumerics  #: Target error and solver of each cell.
    solver: CellSolver  #: Solves one cell.
    executor: Executor  #: Runs the solver.
    record: Checkpoint  #: Checkpoint of the solved cells.
    progress: Progress  #: Called after every chunk.
    step: str = "library"  #: Name of this sampling for the progress.

    def __call__(self, numbers: IndexArray, expected_total: int) -> dict[int, SolvedPoint]:
        """Solve cells by their numbers, shape (n,); return their answers by number.

        ``expected_total`` is the number of cells that the whole build may need, for the progress.
        """
        known = {point.number: point for point in self.record.points}
        missing = [int(number) for number in numbers if int(number) not in known]
        cells = [(number, self.cell_of(number)) for number in missing]
        # In a small batch, a chunk of several resonant sizes would keep one worker busy alone.
        size = min(CHUNK, max(1, len(cells) // AHEAD))
        chunks = [tuple(cells[k : k + size]) for k in range(0, len(cells), size)]
        # A serial executor solves each chunk when it is submitted: one at a time, so that a kill loses one chunk.
        ahead = 1 if isinstance(self.executor, SerialExecutor) else AHEAD
        work = partial(_solve_chunk, self.solver, self.numerics)
        for _, points in stream(self.executor, work, chunks, ahead=ahead):
            self.record.add(points)
            known.update({point.number: point for point in points})
            self.progress(self.step, len(self.record.points), max(expected_total, len(self.record.points)))
        return {int(number): known[int(number)] for number in numbers}


def _solve_chunk(
    solver: CellSolver, numerics: CellNumerics, cells: Sequence[tuple[int, PillarCell]]
) -> list[SolvedPoint]:
    points = []
    for number, cell in cells:
        answer = solver(cell, numerics)
        values = [*answer.t.diagonal(), *answer.r.diagonal()]
        if answer.slopes is not None:
            values += list(answer.slopes.ravel())
        points.append(SolvedPoint(number, tuple(map(complex, values)), answer.error, answer.seconds))
    return points


def _solve_while(
    work: Callable[[], Result], solve_sizes: PointSolver, numbers: IndexArray, expected_total: int
) -> tuple[Result, dict[int, SolvedPoint]]:
    """Result of ``work``, called in this process while other processes solve sizes, and their answers."""
    if isinstance(solve_sizes.executor, SerialExecutor):
        return work(), solve_sizes(numbers, expected_total)
    with ThreadPoolExecutor(1) as thread:
        result = thread.submit(work)
        answers = solve_sizes(numbers, expected_total)
        return result.result(), answers


@dataclass(frozen=True)
class GridSampling:
    """Result of the sampling over the grid of sizes."""

    solved: dict[int, SolvedPoint]  #: Answers by number, in ascending order.
    models: RankedModels | None  #: Continuous models; None if the grid is so small that every size was solved at once.
    safety_factor: float  #: Ratio of held-out errors to the models' disagreement, at least 1.
    held_out: IndexArray  #: Shape (n,), numbers of the last round's sizes, predicted before they were solved.
    held_out_error: float  #: Largest error of these predictions.
    held_out_rms: float  #: Rms error of these predictions; no error estimate is smaller.
    rounds: int  #: Rounds of solving.


def fit_solved(
    grid: SizeGrid, solved: dict[int, SolvedPoint], held_out: IndexArray, more: Samples | None = None
) -> RankedModels:
    """Fit models to solved sizes, answers by number.

    ``held_out``, shape (n,), are numbers of the sizes that rank the models' degrees; samples off the grid (``more``)
    rank them as well.
    """
    numbers = np.array(sorted(solved), dtype=np.intp)
    samples = samples_at(grid, {int(number): solved[int(number)] for number in numbers})
    ranking = np.isin(numbers, held_out)
    if more is not None:
        samples, ranking = samples.joined(more), np.append(ranking, np.ones(more.width_nm.size, dtype=bool))
    return fit_size_models(samples, ranking, grid.spans_nm, grid.exchange)


def sample_grid(
    grid: SizeGrid,
    solve_sizes: PointSolver,
    tolerance: float,
    fit: FitModels = fit_solved,
    first_round: int = FIRST_ROUND,
) -> GridSampling:
    """Solve sizes until the model's error estimate is within the tolerance at every other size."""
    batch = grid.space_filling if grid.is_narrow else grid.space_filling[:first_round]
    # The solver's first answers show whether it gives slopes.
    part = batch[:FIRST_WITH_SLOPES] if batch.size < grid.distinct.size else batch
    solved = solve_sizes(part, batch.size)
    if part.size < batch.size and np.isfinite(slopes_of(list(solved.values()))).all():
        batch = part
    else:
        solved = solve_sizes(batch, batch.size)
    ranking, left, factor, rounds = batch[-(batch.size // 4) :], 0, 1.0, 1
    while len(solved) < grid.distinct.size:
        rounds += 1
        even = _next_even(grid, solved)
        # The build may need this round's sizes, and as many again while some sizes are not known well enough.
        expected_total = min(len(solved) + even.size + min(left, even.size), grid.distinct.size)
        fit_now = partial(fit, grid, dict(solved), ranking, None)
        models, new = _solve_while(fit_now, solve_sizes, even, expected_total)
        disagreement = disagreement_estimate(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)
        miss, certificate = prediction_errors(models.best, grid, new)
        # The worst sizes of the last round tested the previous models; their factor still counts.
        factor = max(factor, error_ratio(miss, certificate, disagreement.ravel()[even]))
        solved |= new
        open_sizes = _open_sizes(grid, factor * disagreement, solved, tolerance)
        holds = float(np.max(miss - certificate)) <= tolerance or len(solved) == grid.distinct.size
        if holds and open_sizes.size == 0:
            rms = float(np.sqrt(np.mean(miss**2)))
            in_order = dict(sorted(solved.items()))
            return GridSampling(in_order, models, factor, even, float(miss.max()), rms, rounds)
        worst = _next_worst(grid, disagreement, open_sizes, solved)
        new = solve_sizes(worst, len(solved) + worst.size)
        factor = 1.0
        if new:
            factor = error_ratio(*prediction_errors(models.best, grid, new), disagreement.ravel()[worst])
        solved |= new
        ranking, left = np.concatenate([ranking, even, worst])[-RANKING:], open_sizes.size
        if rounds == ROUNDS_WITH_SLOPES:
            solve_sizes = replace(solve_sizes, numerics=replace(solve_sizes.numerics, slopes=False))
            solved = without_slopes(solved)
    last = fit(grid, solved, ranking, None) if rounds > 1 else None
    return GridSampling(dict(sorted(solved.items())), last, factor, batch[:0], 0.0, 0.0, rounds)


def prediction_errors(
    model: RationalModel, grid: SizeGrid, new: dict[int, SolvedPoint]
) -> tuple[FloatArray, FloatArray]:
    """Compare a model that was fitted without some sizes with the answers at them, by number.

    Returns the largest error of any amplitude, and the solver's own error, of each new size: shape (n,) each.
    """
    predicted = model(*grid.sizes_nm(np.array(list(new), dtype=np.intp)))
    miss = np.abs(predicted - amplitudes_of(list(new.values()))).max(axis=-1)
    return np.asarray(miss, dtype=np.float64), np.array([point.error for point in new.values()])


def error_ratio(miss: FloatArray, certificate: FloatArray, disagreement: FloatArray) -> float:
    """Return the largest ratio of prediction errors to the models' disagreement, at least 1; shapes (n,).

    The disagreement must not contain the factor of an earlier round, which would make the next factor too small. The
    model is not to blame for the solver's own errors (``certificate``).
    """
    return max(1.0, float(np.max(miss / (disagreement + certificate))))


def amplitudes_of(points: Sequence[SolvedPoint]) -> ComplexArray:
    """Return t_xx, t_yy, r_xx, r_yy of answers, shape (n, 4)."""
    return np.array([point.amplitudes[:4] for point in points], dtype=np.complex128).reshape(-1, 4)


def slopes_of(points: Sequence[SolvedPoint]) -> ComplexArray:
    """Return the derivatives of the amplitudes by width and length, 1/nm, shape (n, 2, 4); NaN where not known."""
    unknown = (math.nan,) * 8
    return np.array([point.amplitudes[4:] or unknown for point in points], dtype=np.complex128).reshape(-1, 2, 4)


def without_slopes(solved: dict[int, SolvedPoint]) -> dict[int, SolvedPoint]:
    """Return answers by number with their values alone."""
    return {number: replace(point, amplitudes=point.amplitudes[:4]) for number, point in solved.items()}


def samples_at(grid: SizeGrid, solved: dict[int, SolvedPoint]) -> Samples:
    """Return answers by number as samples over sizes alone, in the order of ``solved``."""
    sizes_nm = grid.sizes_nm(np.array(list(solved), dtype=np.intp))
    points = list(solved.values())
    return Samples(*sizes_nm, amplitudes_of(points), np.zeros((len(solved), 0)), slopes_of(points))


def _open_sizes(grid: SizeGrid, estimate: FloatArray, solved: dict[int, SolvedPoint], tolerance: float) -> IndexArray:
    """Distinct unsolved sizes whose error estimate is above the tolerance."""
    open_error = np.where(_is_solved(grid, solved), 0.0, estimate).ravel()[grid.distinct]
    return grid.distinct[open_error > tolerance]


def _next_even(grid: SizeGrid, solved: dict[int, SolvedPoint]) -> IndexArray:
    """Next sizes of the space-filling sequence."""
    is_solved = _is_solved(grid, solved).ravel()
    count = max(EVEN_ROUND, math.ceil(EVEN_GROWTH * len(solved)))
    return grid.space_filling[~is_solved[grid.space_filling]][:count]


def _next_worst(
    grid: SizeGrid, disagreement: FloatArray, open_sizes: IndexArray, solved: dict[int, SolvedPoint]
) -> IndexArray:
    """Open sizes with the largest disagreement, a few steps from each other."""
    excluded = np.ones(grid.size, dtype=bool)
    excluded[open_sizes] = False
    return worst_points(grid, disagreement, excluded, max(WORST_ROUND, math.ceil(WORST_GROWTH * len(solved))))


def _is_solved(grid: SizeGrid, solved: dict[int, SolvedPoint]) -> NDArray[np.bool_]:
    """Mask of sizes that are solved, mirror images included: shape (n_length, n_width)."""
    mask = np.zeros(grid.shape, dtype=bool)
    mask.ravel()[list(solved)] = True
    return mask | mask.T if grid.exchange else mask
