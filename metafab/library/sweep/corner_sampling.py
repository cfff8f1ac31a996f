"""Adaptive sampling over sizes and axes together.

Cells come from a space-filling sequence in the box of sizes and axes, denser towards its faces. Every round solves the
next cells of the sequence and the cells with the largest disagreement of the models. Each cell is predicted before it
is solved. The largest ratio of prediction error to disagreement is the safety factor of the error estimate. Cells of
the nominal library are samples too. Sampling ends when the estimate is within the tolerance at all but a few cells of
the sequence, or at the largest number of cells. The error bound of each corner holds in both cases.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metafab.cell import PillarCell
from metafab.core.conventions import FloatArray
from metafab.core.figures import CornerStatistics
from metafab.library.axes import CornerBox, Corners, corner_cell
from metafab.library.fit.models import RankedModels, fit_corner_models
from metafab.library.fit.rational import Range, RationalModel, Samples
from metafab.library.fit.size_grid import IndexArray, SizeGrid
from metafab.library.sweep.adaptive_sampling import PointSolver, amplitudes_of, samples_at, slopes_of
from metafab.library.sweep.checkpoint import SolvedPoint
from metafab.spec import UnitCell

#: Growth of the number of solved cells in each round after the first.
GROWTH = 0.3
#: Fraction of the sequence that may stay above the tolerance: cells on the sharpest resonances.
OPEN_SHARE = 0.02
#: Smallest distance between the cells of largest disagreement chosen in one round, in a box of side 2.
APART = 0.1


@dataclass(frozen=True)
class CornerNumerics:
    """Size of the sampling over sizes and axes."""

    sequence: int = 8192  #: Candidate cells, besides the corners of the box.
    first_round: int = 96  #: Cells of the first round per dimension of the box.
    most_cells: int = 400  #: Largest number of solved cells per dimension of the box.


class CornerSequence:
    """Space-filling sequence of cells in the box of sizes and axes, starting with the corners of the box.

    Args:
        unit_cell: unit cell with ``sweep.axes``.
        box: axes of the sweep.
        first_number: checkpoint number of the first cell.
        count: length of the sequence, besides the corners of the box.

    Attributes:
        width_nm: shape (n,), as made.
        length_nm: shape (n,), as made.
        axes: shape (n, n_variables), each in -1..1.
        place: shape (n, 2 + n_variables), sizes and axes, each in -1..1.
    """

    def __init__(self, unit_cell: UnitCell, box: CornerBox, first_number: int, count: int) -> None:
        self._unit_cell, self._box, self._first = unit_cell, box, first_number
        dimensions = box.dimensions
        corners = np.array(list(product((-1.0, 1.0), repeat=dimensions)))
        # Steps of 1/g, 1/g^2, ... fill the cube evenly, g^(d+1) = g + 1 (Roberts' R_d sequence).
        root = 2.0
        for _ in range(60):
            root = (1.0 + root) ** (1.0 / (dimensions + 1))
        steps = root ** -np.arange(1.0, dimensions + 1.0)
        inner = -np.cos(math.pi * np.mod(0.5 + np.arange(count)[:, None] * steps, 1.0))
        place = np.concatenate([corners, inner])
        # Width and length of circles are one coordinate.
        self.place: FloatArray = np.insert(place, 1, place[:, 0], axis=1) if box.is_round else place
        self.axes: FloatArray = self.place[:, 2:]
        self.width_nm = _unscaled(self.place[:, 0], box.width_nm)
        self.length_nm = _unscaled(self.place[:, 1], box.length_nm)

    def cell(self, number: int) -> PillarCell:
        """Return the cell of a checkpoint number."""
        k = number - self._first
        corner = self._box.from_variables(self.axes[k])
        return corner_cell(self._unit_cell, float(self.width_nm[k]), float(self.length_nm[k]), corner)

    def solve(self, solve_points: PointSolver, batch: IndexArray, expected_total: int) -> list[SolvedPoint]:
        """Solve cells of the sequence, shape (n,) indices; return their answers in this order.

        ``solve_points`` solves cells by checkpoint number; the whole build may need ``expected_total`` cells.
        """
        numbers = batch + self._first
        answers = solve_points(numbers, expected_total)
        return [answers[int(number)] for number in numbers]

    def predicted(self, model: RationalModel, batch: IndexArray | slice = slice(None)) -> NDArray[np.complex128]:
        """Return a model's t_xx, t_yy, r_xx, r_yy at n cells of the sequence, shape (n, 4).

        ``batch``, shape (n,), holds indices into the sequence; all by default.
        """
        return model(self.width_nm[batch], self.length_nm[batch], self.axes[batch])


def sample_corners(
    grid: SizeGrid,
    box: CornerBox,
    sequence: CornerSequence,
    nominal: dict[int, SolvedPoint],
    solve_points: PointSolver,
    tolerance: float,
    numerics: CornerNumerics = CornerNumerics(),
) -> Corners:
    """Solve cells of the sequence until the model's estimated error is within the tolerance almost all over the box.

    ``grid`` holds the sizes of the nominal library and ``nominal`` its answers by number; ``solve_points`` solves by
    checkpoint number.
    """
    dimensions = box.dimensions
    most, nominal_count = numerics.most_cells * dimensions, len(nominal)
    exchange = grid.exchange and box.keeps_xy_symmetry
    cells = _SolvedCells.of(grid, box, nominal)
    batch = np.arange(numerics.first_round * dimensions)
    cells = cells.with_new(sequence, batch, sequence.solve(solve_points, batch, nominal_count + most // 2))
    models = cells.fit(box, batch[::4], exchange)
    rounds, open_share = 1, 1.0
    while True:
        rounds += 1
        estimate = _estimate(sequence, models)
        even, worst = _next_batch(sequence, cells, estimate, math.ceil(GROWTH * cells.samples.width_nm.size))
        batch = np.concatenate([even, worst])
        left = batch.size if open_share <= 2.0 * OPEN_SHARE else 2 * batch.size
        expected_total = nominal_count + min(len(cells.taken) + left, most)
        answers = sequence.solve(solve_points, batch, expected_total)
        miss = np.abs(sequence.predicted(models.best, batch) - amplitudes_of(answers)).max(axis=-1)
        certificate = np.array([point.error for point in answers])
        safety_factor = max(1.0, float(np.max(miss / (estimate[batch] + certificate))))
        cells = cells.with_new(sequence, batch, answers)
        models = cells.fit(box, batch, exchange)
        is_open = safety_factor * _estimate(sequence, models) > tolerance
        is_open[cells.taken] = False
        open_share = float(is_open.mean())
        held_out = miss[: even.size]
        holds = float(np.max(held_out - certificate[: even.size])) <= tolerance
        reached = holds and open_share <= OPEN_SHARE
        if reached or len(cells.taken) >= most:
            break
    shape, target = models.best.shape, "reached"
    if not reached:
        target = (
            f"not reached in {len(cells.taken)} cells: {100.0 * open_share:.1f} % of the box may miss {tolerance:.1e}; "
            "every corner has its own error bound; a narrower span or a larger target_error needs fewer cells"
        )
    statistics = CornerStatistics(
        points_solved=len(cells.taken),
        rounds=rounds,
        held_out=even.size,
        held_out_error=float(held_out.max()),
        held_out_rms=float(np.sqrt(np.mean(held_out**2))),
        open_share=open_share,
        target=target,
        axis_weight=shape.weight,
        numerator_degree=shape.degrees[0],
        denominator_degree=shape.degrees[1],
    )
    place = box.points(cells.samples.width_nm, cells.samples.length_nm, cells.samples.axes)
    return Corners(models, safety_factor, statistics.held_out_rms, place, cells.certificate, statistics)


@dataclass(frozen=True)
class _SolvedCells:
    """All solved cells: those of the nominal library, then those of the sequence."""

    samples: Samples  #: n cells.
    certificate: FloatArray  #: Shape (n,), the solver's errors.
    taken: IndexArray  #: Shape (n_taken,), indices into the sequence, in the order of solution.

    @classmethod
    def of(cls, grid: SizeGrid, box: CornerBox, nominal: dict[int, SolvedPoint]) -> _SolvedCells:
        axes = np.tile(box.to_variables(box.nominal), (len(nominal), 1))
        samples = replace(samples_at(grid, nominal), axes=axes)
        return cls(samples, np.array([point.error for point in nominal.values()]), np.zeros(0, dtype=np.intp))

    def with_new(self, sequence: CornerSequence, batch: IndexArray, answers: list[SolvedPoint]) -> _SolvedCells:
        sizes_nm = sequence.width_nm[batch], sequence.length_nm[batch]
        new = Samples(*sizes_nm, amplitudes_of(answers), sequence.axes[batch], slopes_of(answers))
        certificate = np.concatenate([self.certificate, [point.error for point in answers]])
        return _SolvedCells(self.samples.joined(new), certificate, np.concatenate([self.taken, batch]))

    def fit(self, box: CornerBox, held_out: IndexArray, exchange: bool) -> RankedModels:
        """Fit models to all cells; the cells ``held_out`` of the sequence rank their shapes."""
        nominal = self.samples.width_nm.size - self.taken.size
        ranking = np.concatenate([np.zeros(nominal, dtype=bool), np.isin(self.taken, held_out)])
        return fit_corner_models(self.samples, ranking, (box.width_nm, box.length_nm), exchange)


def _unscaled(place: FloatArray, span_nm: Range) -> FloatArray:
    """Map -1..1 linearly to a span of sizes; inverse of :func:`scaled`."""
    low, high = span_nm
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * place, dtype=np.float64)


def _estimate(sequence: CornerSequence, models: RankedModels) -> FloatArray:
    """Disagreement of the best model with its rivals at all cells of the sequence, at least its median."""
    best = sequence.predicted(models.best)
    difference = np.max([np.abs(best - sequence.predicted(rival)).max(axis=-1) for rival in models.rivals], axis=0)
    return np.asarray(np.maximum(difference, np.median(difference)), dtype=np.float64)


def _next_batch(
    sequence: CornerSequence, cells: _SolvedCells, estimate: FloatArray, count: int
) -> tuple[IndexArray, IndexArray]:
    """The next cells of the sequence, and equally many of largest estimate, at least ``APART`` from each other."""
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
