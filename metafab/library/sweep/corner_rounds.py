"""Rounds of solving over sizes and axes together, from the nominal library outwards.

The cells to choose from are one long sequence that fills the box of sizes and axes evenly, denser towards its faces.
As over the sizes alone, every round solves the next ones of the sequence and those where the models disagree most,
each predicted before it is solved: the misses scale the disagreement up to an error estimate. Cells of the nominal
library serve too. The rounds end when the estimate is within the tolerance at all but a few cells of the sequence, or
at the largest number of samples; either way each corner states the error that it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from metafab.cell import PillarCell
from metafab.core.conventions import FloatArray
from metafab.library.axes import CornerBox, corner_cell
from metafab.library.corners import Corners
from metafab.library.fit.corner_model import CornerModel, CornerSamples, fit_corner_models
from metafab.library.fit.rational import Range
from metafab.library.fit.sampling import IndexArray, SizeGrid
from metafab.library.sweep.adaptive_sampling import PointSolver
from metafab.library.sweep.checkpoint import SolvedPoint
from metafab.spec import UnitCell

#: Cells to choose from.
SEQUENCE = 8192
#: Cells of the first round for each dimension of the box, and how much all solved ones grow by in each later round.
FIRST_ROUND, GROWTH = 96, 0.3
#: Samples for each dimension of the box after which the rounds end, whatever was reached.
MOST_SAMPLES = 400
#: Cells of the sequence that may stay above the tolerance: right on the sharpest resonances.
OPEN_SHARE = 0.02
#: Cells chosen by disagreement in one round are at least this far apart, in a box of side 2.
APART = 0.1


class CornerSequence:
    """Cells of the box, in an order whose beginnings fill it evenly; the outermost ones come first.

    Attributes:
        width_nm: shape (n,), as made; likewise ``length_nm``.
        length_nm: see ``width_nm``.
        axes: shape (n, n_variables), each in -1..1.
        place: shape (n, 2 + n_variables): sizes and axes, each in -1..1.
    """

    def __init__(self, unit_cell: UnitCell, box: CornerBox, first_number: int) -> None:
        self._unit_cell, self._box, self._first = unit_cell, box, first_number
        dimensions = 2 + len(box.variables)
        corners = np.array(list(product((-1.0, 1.0), repeat=dimensions)))
        # Steps of 1/g, 1/g^2, ... fill the cube evenly, g^(d+1) = g + 1 (Roberts' R_d sequence).
        root = 2.0
        for _ in range(60):
            root = (1.0 + root) ** (1.0 / (dimensions + 1))
        steps = root ** -np.arange(1.0, dimensions + 1.0)
        inner = -np.cos(math.pi * np.mod(0.5 + np.arange(SEQUENCE)[:, None] * steps, 1.0))
        self.place: FloatArray = np.concatenate([corners, inner])
        self.axes: FloatArray = self.place[:, 2:]
        self.width_nm, self.length_nm = (
            0.5 * (low + high) + 0.5 * (high - low) * column
            for column, (low, high) in zip(self.place.T, (box.width_nm, box.length_nm), strict=False)
        )

    def numbers(self, which: IndexArray) -> IndexArray:
        """Numbers under which a checkpoint keeps cells."""
        return which + self._first

    def cell(self, number: int) -> PillarCell:
        """The cell of a number."""
        k = number - self._first
        corner = self._box.corner(self.axes[k])
        return corner_cell(self._unit_cell, float(self.width_nm[k]), float(self.length_nm[k]), corner)


def sample_corners(
    grid: SizeGrid,
    box: CornerBox,
    sequence: CornerSequence,
    nominal: dict[int, SolvedPoint],
    solve_points: PointSolver,
    tolerance: float,
) -> Corners:
    """Solve cells until the model's error estimate is within the tolerance almost everywhere in the box.

    Args:
        grid: the sizes of the nominal library.
        box: the axes and their spans.
        sequence: cells to choose from.
        nominal: solved sizes of the nominal library.
        solve_points: solves cells of the sequence by their numbers.
        tolerance: of the models.
    """
    dimensions = sequence.place.shape[1]
    most, nominal_count = MOST_SAMPLES * dimensions, len(nominal)
    fit = partial(_fit, sequence, (box.width_nm, box.length_nm), grid.exchange and box.exchanges)
    cells = _Solved.of(grid, box, nominal)
    batch = np.arange(FIRST_ROUND * dimensions)
    cells = cells.with_new(sequence, batch, solve_points(sequence.numbers(batch), nominal_count + most // 2))
    models = fit(cells, batch[::4])
    rounds, open_share = 1, 1.0
    while True:
        rounds += 1
        estimate = _estimate(sequence, models)
        even, worst = _next_batch(sequence, cells, estimate, math.ceil(GROWTH * cells.samples.width_nm.size))
        batch = np.concatenate([even, worst])
        left = batch.size if open_share <= 2.0 * OPEN_SHARE else 2 * batch.size
        answers = solve_points(sequence.numbers(batch), nominal_count + min(len(cells.taken) + left, most))
        miss, certificate = _misses(sequence, models[0], batch, answers)
        factor = max(1.0, float(np.max(miss / (estimate[batch] + certificate))))
        cells = cells.with_new(sequence, batch, answers)
        models = fit(cells, batch)
        open_cells = factor * _estimate(sequence, models) > tolerance
        open_cells[cells.taken] = False
        open_share = float(open_cells.mean())
        unforeseen = miss[: even.size]
        holds = float(np.max(unforeseen - certificate[: even.size])) <= tolerance
        reached = holds and open_share <= OPEN_SHARE
        if reached or len(cells.taken) >= most:
            break
    details: dict[str, float | str] = {
        "corner_points_solved": len(cells.taken),
        "corner_rounds": rounds,
        "corner_held_out": even.size,
        "corner_held_out_error": float(unforeseen.max()),
        "corner_held_out_rms": float(np.sqrt(np.mean(unforeseen**2))),
        "corner_open_share": open_share,
        "corner_target": _verdict(reached, len(cells.taken), open_share, tolerance),
        "corner_axis_weight": models[0].shape.weight,
        "corner_numerator_degree": models[0].shape.degrees[0],
        "corner_denominator_degree": models[0].shape.degrees[1],
    }
    samples = cells.samples
    place = box.places(samples.width_nm, samples.length_nm, samples.axes)
    floor = float(details["corner_held_out_rms"])
    return Corners(models, factor, floor, place, cells.certificate, details)


def _verdict(reached: bool, solved: int, open_share: float, tolerance: float) -> str:
    """Whether the rounds ended because the models hold or because they had their share of cells, in words."""
    if reached:
        return "reached"
    return (
        f"not reached in {solved} cells: {100.0 * open_share:.1f} % of the box may miss {tolerance:.1e}; "
        "every corner states its own error, and a narrower span or a larger target_error takes fewer cells"
    )


@dataclass(frozen=True)
class _Solved:
    """All solved cells: those of the nominal library, then those of the sequence.

    Attributes:
        samples: where and what they are.
        certificate: shape (n,), the solver's errors.
        taken: places in the sequence, in the order of solution.
    """

    samples: CornerSamples
    certificate: FloatArray
    taken: IndexArray

    @classmethod
    def of(cls, grid: SizeGrid, box: CornerBox, nominal: dict[int, SolvedPoint]) -> _Solved:
        axes = np.tile(box.variables_of(box.nominal), (len(nominal), 1))
        sizes = grid.sizes_nm(np.array(list(nominal), dtype=np.intp))
        samples = CornerSamples(*sizes, axes, np.array([point.amplitudes for point in nominal.values()]))
        return cls(samples, np.array([point.error for point in nominal.values()]), np.zeros(0, dtype=np.intp))

    def with_new(self, sequence: CornerSequence, batch: IndexArray, answers: dict[int, SolvedPoint]) -> _Solved:
        points = [answers[int(number)] for number in sequence.numbers(batch)]
        old = self.samples
        samples = CornerSamples(
            np.concatenate([old.width_nm, sequence.width_nm[batch]]),
            np.concatenate([old.length_nm, sequence.length_nm[batch]]),
            np.concatenate([old.axes, sequence.axes[batch]]),
            np.concatenate([old.amplitudes, np.array([point.amplitudes for point in points])]),
        )
        certificate = np.concatenate([self.certificate, [point.error for point in points]])
        return _Solved(samples, certificate, np.concatenate([self.taken, batch]))


def _fit(
    sequence: CornerSequence, spans_nm: tuple[Range, Range], exchange: bool, cells: _Solved, held_out: IndexArray
) -> tuple[CornerModel, ...]:
    """The models that predict the cells ``held_out`` of the sequence best, fitted to all."""
    nominal = cells.samples.width_nm.size - cells.taken.size
    judges = np.concatenate([np.zeros(nominal, dtype=bool), np.isin(cells.taken, held_out)])
    return fit_corner_models(cells.samples, judges, spans_nm, exchange)


def _estimate(sequence: CornerSequence, models: tuple[CornerModel, ...]) -> FloatArray:
    """Disagreement of the first model with the others at all cells of the sequence, at least its median."""
    best, *others = (model(sequence.width_nm, sequence.length_nm, sequence.axes) for model in models)
    apart = np.max([np.abs(best - other).max(axis=-1) for other in others], axis=0)
    return np.asarray(np.maximum(apart, np.median(apart)), dtype=np.float64)


def _next_batch(
    sequence: CornerSequence, cells: _Solved, estimate: FloatArray, count: int
) -> tuple[IndexArray, IndexArray]:
    """The next cells of the sequence, and as many of the worst ones that are not near each other."""
    free = np.ones(estimate.size, dtype=bool)
    free[cells.taken] = False
    even = np.flatnonzero(free)[: count - count // 2]
    free[even] = False
    tree = cKDTree(sequence.place)
    worst: list[int] = []
    for k in np.argsort(-estimate, kind="stable"):
        if free[k]:
            worst.append(int(k))
            free[tree.query_ball_point(sequence.place[k], APART)] = False
            if len(worst) == count // 2:
                break
    return even, np.array(worst, dtype=np.intp)


def _misses(
    sequence: CornerSequence, model: CornerModel, batch: IndexArray, answers: dict[int, SolvedPoint]
) -> tuple[FloatArray, FloatArray]:
    """Largest error of any amplitude that the model predicted for each new cell, and the solver's own."""
    points = [answers[int(number)] for number in sequence.numbers(batch)]
    predicted = model(sequence.width_nm[batch], sequence.length_nm[batch], sequence.axes[batch])
    miss = np.abs(predicted - np.array([point.amplitudes for point in points])).max(axis=-1)
    return np.asarray(miss, dtype=np.float64), np.array([point.error for point in points])
