"""Rounds of solving: few sizes, models of the rest, and on until every size is known well enough.

Each round fits two rational models of unlike degrees to all sizes solved so far while the workers solve the next ones
of an even sequence, which those models could not know: a held-out test, whose misses scale the disagreement of the two
up to an error estimate. Where that is above the tolerance, on the ridges of guided modes, the worst sizes are solved
next, and they test the models as well. It ends when the estimate, at every size that was not solved, and the misses are
within the tolerance, at the latest when the grid is exhausted; ``between`` then looks between the sizes.
Decisions are taken between rounds only: any number of workers decides alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from metafab.cell import CellNumerics, CellSolver, PillarCell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress
from metafab.library.fit.certificate import spread
from metafab.library.fit.models import ModelPair, Samples, SizeModel, fit_models
from metafab.library.fit.sampling import IndexArray, SizeGrid, worst_points
from metafab.library.sweep.checkpoint import Checkpoint, SolvedPoint

Result = TypeVar("Result")

#: Sizes of the first round.
FIRST_ROUND = 112
#: Even sizes of a later round, at least so many and at least this share of those solved before.
EVEN_ROUND, EVEN_GROWTH = 16, 0.08
#: The same for the sizes where models disagree most.
WORST_ROUND, WORST_GROWTH = 24, 0.12
#: The latest so many sizes judge the models' degrees.
JUDGES = 48
#: Sizes that a worker solves before it reports: more save messages, fewer lose less to a kill.
CHUNK = 4
#: Chunks in flight: enough to keep the workers of one machine busy.
AHEAD = 32


@dataclass(frozen=True)
class PointSolver:
    """Solves cells by their numbers, except those that the checkpoint holds.

    Attributes:
        cell_of: number -> cell.
        numerics: how each cell is solved.
        solver: solves one cell.
        executor: where.
        record: solved sizes, on disk as they arrive.
        progress: called after every chunk.
    """

    cell_of: Callable[[int], PillarCell]
    numerics: CellNumerics
    solver: CellSolver
    executor: Executor
    record: Checkpoint
    progress: Progress

    def __call__(self, numbers: IndexArray, foreseen: int) -> dict[int, SolvedPoint]:
        """Answers by number; ``foreseen`` is how many sizes the build may need in all."""
        known = {point.number: point for point in self.record.points}
        missing = [int(number) for number in numbers if int(number) not in known]
        cells = [(number, self.cell_of(number)) for number in missing]
        chunks = [tuple(cells[k : k + CHUNK]) for k in range(0, len(cells), CHUNK)]
        # In this process nothing runs ahead, so that a kill loses one chunk.
        ahead = 1 if isinstance(self.executor, SerialExecutor) else AHEAD
        work = partial(_solve_chunk, self.solver, self.numerics)
        for _, points in stream(self.executor, work, chunks, ahead=ahead):
            self.record.add(points)
            known.update({point.number: point for point in points})
            self.progress("library", len(self.record.points), max(foreseen, len(self.record.points)))
        return {int(number): known[int(number)] for number in numbers}

    def beside(
        self, work: Callable[[], Result], numbers: IndexArray, foreseen: int
    ) -> tuple[Result, dict[int, SolvedPoint]]:
        """What ``work`` returns, and answers that other processes find in the meantime."""
        if isinstance(self.executor, SerialExecutor):
            return work(), self(numbers, foreseen)
        with ThreadPoolExecutor(1) as thread:
            result = thread.submit(work)
            answers = self(numbers, foreseen)
            return result.result(), answers


def _solve_chunk(
    solver: CellSolver, numerics: CellNumerics, cells: Sequence[tuple[int, PillarCell]]
) -> list[SolvedPoint]:
    points = []
    for number, cell in cells:
        answer = solver(cell, numerics)
        t_xx, t_yy, r_xx, r_yy = (complex(matrix[axis, axis]) for matrix in (answer.t, answer.r) for axis in (0, 1))
        points.append(SolvedPoint(number, (t_xx, t_yy, r_xx, r_yy), answer.error, answer.seconds))
    return points


@dataclass(frozen=True)
class Outcome:
    """What the rounds have found.

    Attributes:
        solved: number -> answer, in ascending order of the numbers.
        models: the continuous model and its rival; None where the grid is so small that every size was solved at once.
        factor: how far their disagreement fell short of misses at sizes that they could not know, at least 1.
        held_out: the sizes of the last round, each predicted before it was solved.
        held_out_error: the largest miss among them.
        held_out_rms: the rms of these misses: nowhere is the model taken to be better.
        rounds: rounds of solving.
    """

    solved: dict[int, SolvedPoint]
    models: ModelPair | None
    factor: float
    held_out: IndexArray
    held_out_error: float
    held_out_rms: float
    rounds: int


def sample(grid: SizeGrid, solve_sizes: PointSolver, tolerance: float) -> Outcome:
    """Solve sizes until the model's error estimate is within the tolerance at every other size."""
    batch = grid.even_order if grid.diagonal else grid.even_order[:FIRST_ROUND]
    solved = solve_sizes(batch, batch.size)
    judges, left, factor, rounds = batch[-(batch.size // 4) :], 0, 1.0, 1
    while len(solved) < grid.distinct.size:
        rounds += 1
        even = _next_even(grid, solved)
        foreseen = _foreseen(grid, len(solved), even.size, left)
        fit = partial(fit_solved, grid, dict(solved), judges)
        models, new = solve_sizes.beside(fit, even, foreseen)
        disagreement = spread(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)
        miss, certificate = misses(models.best, grid, new)
        # What the worst sizes of the last round have shown of the models before these counts as well.
        factor = max(factor, shortfall(miss, certificate, disagreement.ravel()[even]))
        solved |= new
        open_sizes = _left(grid, factor * disagreement, solved, tolerance)
        held = float(np.max(miss - certificate)) <= tolerance or len(solved) == grid.distinct.size
        if held and open_sizes.size == 0:
            rms = float(np.sqrt(np.mean(miss**2)))
            return Outcome(_sorted(solved), models, factor, even, float(miss.max()), rms, rounds)
        worst = _next_worst(grid, disagreement, open_sizes, solved)
        new = solve_sizes(worst, len(solved) + worst.size)
        factor = shortfall(*misses(models.best, grid, new), disagreement.ravel()[worst]) if new else 1.0
        solved |= new
        judges, left = np.concatenate([judges, even, worst])[-JUDGES:], open_sizes.size
    last = fit_solved(grid, solved, judges) if rounds > 1 else None
    return Outcome(_sorted(solved), last, factor, batch[:0], 0.0, 0.0, rounds)


def fit_solved(
    grid: SizeGrid, solved: dict[int, SolvedPoint], held_out: IndexArray, more: Samples | None = None
) -> ModelPair:
    """Models of solved sizes, and of ``more`` samples off the grid, chosen by those and the sizes ``held_out``."""
    numbers = np.array(sorted(solved), dtype=np.intp)
    samples = Samples(*grid.sizes_nm(numbers), amplitudes_of([solved[int(number)] for number in numbers]))
    judges = np.isin(numbers, held_out)
    if more is not None:
        samples, judges = samples.joined(more), np.append(judges, np.ones(more.width_nm.size, dtype=bool))
    return fit_models(samples, judges, (grid.width_nm, grid.length_nm), grid.exchange)


def misses(model: SizeModel, grid: SizeGrid, new: dict[int, SolvedPoint]) -> tuple[FloatArray, FloatArray]:
    """Largest error of any amplitude that the model predicted for each new size, and the solver's own."""
    predicted = model(*grid.sizes_nm(np.array(list(new), dtype=np.intp)))
    miss = np.abs(predicted - amplitudes_of(list(new.values()))).max(axis=-1)
    return np.asarray(miss, dtype=np.float64), np.array([point.error for point in new.values()])


def shortfall(miss: FloatArray, certificate: FloatArray, disagreement: FloatArray) -> float:
    """The factor by which disagreement falls short of misses, at least 1; the solver's error is not the model's.

    The disagreement is the models' own, before any factor of an earlier round: a factor on top of a factor would
    make the next one look small.
    """
    return max(1.0, float(np.max(miss / (disagreement + certificate))))


def amplitudes_of(points: Sequence[SolvedPoint]) -> ComplexArray:
    """Shape (n, 4): t_xx, t_yy, r_xx, r_yy."""
    return np.array([point.amplitudes for point in points], dtype=np.complex128).reshape(-1, 4)


def _left(grid: SizeGrid, estimate: FloatArray, solved: dict[int, SolvedPoint], tolerance: float) -> IndexArray:
    """Distinct sizes that were not solved and are not known well enough."""
    open_error = np.where(_is_solved(grid, solved), 0.0, estimate).ravel()[grid.distinct]
    return grid.distinct[open_error > tolerance]


def _foreseen(grid: SizeGrid, solved: int, batch: int, left: int) -> int:
    """Sizes that the build may need in all: this round's, and as many again while sizes are left over."""
    return min(solved + batch + min(left, batch), grid.distinct.size)


def _next_even(grid: SizeGrid, solved: dict[int, SolvedPoint]) -> IndexArray:
    """The next sizes of the even sequence."""
    is_solved = _is_solved(grid, solved).ravel()
    count = max(EVEN_ROUND, math.ceil(EVEN_GROWTH * len(solved)))
    return grid.even_order[~is_solved[grid.even_order]][:count]


def _next_worst(
    grid: SizeGrid, disagreement: FloatArray, open_sizes: IndexArray, solved: dict[int, SolvedPoint]
) -> IndexArray:
    """The worst sizes, a few steps from each other, among those that are not known well enough."""
    candidates = np.zeros(grid.size, dtype=bool)
    candidates[open_sizes] = True
    count = max(WORST_ROUND, math.ceil(WORST_GROWTH * len(solved)))
    return worst_points(grid, disagreement, ~candidates, count)


def _is_solved(grid: SizeGrid, solved: dict[int, SolvedPoint]) -> NDArray[np.bool_]:
    """Shape (n_length, n_width): whether a size or, with exchange, its image was solved."""
    mask = np.zeros((grid.length_nm.size, grid.width_nm.size), dtype=bool)
    mask.ravel()[list(solved)] = True
    return mask | mask.T if grid.exchange else mask


def _sorted(solved: dict[int, SolvedPoint]) -> dict[int, SolvedPoint]:
    return {number: solved[number] for number in sorted(solved)}
