"""Rounds of solving: few sizes, models of the rest, and on until every size is known well enough.

Each round fits two rational models of unlike degrees to all sizes solved so far, and solves two kinds of new
sizes: those where the two disagree most (the ridges of guided modes), and the next ones of an even sequence.
Both kinds are predicted before they are solved, so every round is also a held-out test; its misses scale the
disagreement up to an error estimate. It ends when that estimate, at every size that was not solved, and the
misses are within the tolerance, at the latest when the grid is exhausted. Decisions are taken between rounds
only: any number of workers decides alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from metafab.cell.response import CellNumerics, CellSolver, PillarCell
from metafab.core.conventions import FloatArray
from metafab.core.executor import SerialExecutor, stream
from metafab.core.progress import Progress
from metafab.library.certificate import spread
from metafab.library.checkpoint import Checkpoint, SolvedPoint
from metafab.library.models import ModelPair, Samples, SizeModel, fit_models
from metafab.library.sampling import IndexArray, SizeGrid, worst_points

#: Sizes of the first round, and of each later one (half of them even, half where models disagree).
FIRST_ROUND = 128
LATER_ROUND = 48
#: When no more than these stay above the tolerance, they are solved outright.
LAST_ROUND = 96
#: Sizes that a library usually takes: what is foreseen before the first round shows how fast errors fall.
USUAL_POINTS = 400
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
        model: the continuous model; None where the grid is so small that every size was solved at once.
        model_error: shape (n_length, n_width), estimate of the model's error at each size.
        between_error: the same shape, estimate of its error around each size, up to half a step away.
        held_out_error: the largest miss among the sizes of the last round, each predicted before it was solved.
        held_out: how many these were.
        rounds: rounds of solving.
    """

    solved: dict[int, SolvedPoint]
    model: SizeModel | None
    model_error: FloatArray
    between_error: FloatArray
    held_out_error: float
    held_out: int
    rounds: int


def sample(grid: SizeGrid, solve_sizes: PointSolver, tolerance: float) -> Outcome:
    """Solve sizes until the model's error estimate is within the tolerance at every other size."""
    batch = grid.even_order[:FIRST_ROUND]
    solved = solve_sizes(batch, min(USUAL_POINTS, grid.distinct.size))
    if len(solved) == grid.distinct.size:
        zeros = np.zeros((grid.length_nm.size, grid.width_nm.size))
        return Outcome(_sorted(solved), None, zeros, zeros, 0.0, 0, 1)
    models = _fit(grid, solved, batch[-(batch.size // 4) :])
    estimate = spread(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)
    left = _left(grid, estimate, solved, tolerance)
    foreseen, rounds = min(USUAL_POINTS, grid.distinct.size), 1
    while True:
        rounds += 1
        before = left.size
        batch = _next_batch(grid, estimate, solved)
        new = solve_sizes(batch, foreseen)
        miss = _misses(grid, models.best, new)
        certificate = np.array([point.error for point in new.values()])
        # How far the estimate fell short at sizes that it could not know; the solver's own error is not the model's.
        factor = max(1.0, float(np.max(miss / (estimate.ravel()[batch] + certificate))))
        solved |= new
        models = _fit(grid, solved, batch)
        estimate = factor * spread(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)
        left = _left(grid, estimate, solved, tolerance)
        foreseen = _foreseen(grid, len(solved), before, left.size)
        held = float(np.max(miss - certificate)) <= tolerance or len(solved) == grid.distinct.size
        if held and 0 < left.size <= LAST_ROUND:
            solved |= solve_sizes(left, len(solved) + left.size)
            models = _fit(grid, solved, batch)
            estimate = factor * spread(models.disagreement(grid.width_nm, grid.length_nm), grid.exchange)
            left = _left(grid, estimate, solved, tolerance)
        if held and left.size == 0:
            between = factor * spread(models.disagreement_around(grid.width_nm, grid.length_nm), grid.exchange)
            return Outcome(_sorted(solved), models.best, estimate, between, float(miss.max()), batch.size, rounds)


def _left(grid: SizeGrid, estimate: FloatArray, solved: dict[int, SolvedPoint], tolerance: float) -> IndexArray:
    """Distinct sizes that were not solved and are not known well enough."""
    open_error = np.where(_is_solved(grid, solved), 0.0, estimate).ravel()[grid.distinct]
    return grid.distinct[open_error > tolerance]


def _foreseen(grid: SizeGrid, solved: int, before: int, left: int) -> int:
    """Sizes that the build may need in all, if those left above the tolerance go on falling as in this round."""
    ratio = min(max(left / max(before, 1), 0.3), 0.9)
    rounds = math.ceil(math.log(max(left, 1) / LAST_ROUND) / -math.log(ratio)) if left > LAST_ROUND else 0
    return min(solved + rounds * LATER_ROUND + min(left, LAST_ROUND), grid.distinct.size)


def _fit(grid: SizeGrid, solved: dict[int, SolvedPoint], held_out: IndexArray) -> ModelPair:
    numbers = np.array(sorted(solved), dtype=np.intp)
    amplitudes = np.array([solved[int(number)].amplitudes for number in numbers], dtype=np.complex128)
    samples = Samples(*grid.sizes_nm(numbers), amplitudes)
    return fit_models(samples, np.isin(numbers, held_out), (grid.width_nm, grid.length_nm), grid.exchange)


def _next_batch(grid: SizeGrid, estimate: FloatArray, solved: dict[int, SolvedPoint]) -> IndexArray:
    """The worst sizes, and as many of the even sequence."""
    is_solved = _is_solved(grid, solved).ravel()
    worst = worst_points(grid, estimate, is_solved, LATER_ROUND // 2)
    taken = is_solved.copy()
    taken[worst] = True
    even = grid.even_order[~taken[grid.even_order]][: LATER_ROUND - worst.size]
    return np.concatenate([worst, even])


def _misses(grid: SizeGrid, model: SizeModel, new: dict[int, SolvedPoint]) -> FloatArray:
    """Largest error of any amplitude that the model predicted for each new size."""
    predicted = model(*grid.sizes_nm(np.array(list(new), dtype=np.intp)))
    answers = np.array([point.amplitudes for point in new.values()])
    return np.asarray(np.abs(predicted - answers).max(axis=-1), dtype=np.float64)


def _is_solved(grid: SizeGrid, solved: dict[int, SolvedPoint]) -> NDArray[np.bool_]:
    """Shape (n_length, n_width): whether a size or, with exchange, its image was solved."""
    mask = np.zeros((grid.length_nm.size, grid.width_nm.size), dtype=bool)
    mask.ravel()[list(solved)] = True
    return mask | mask.T if grid.exchange else mask


def _sorted(solved: dict[int, SolvedPoint]) -> dict[int, SolvedPoint]:
    return {number: solved[number] for number in sorted(solved)}
