"""Rounds of solving over the grid of sizes: the error estimate keeps the factor of the largest held-out errors."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.library.fit.models import RankedModels
from metafab.library.fit.rational import RationalModel
from metafab.library.fit.size_grid import SizeGrid
from metafab.library.sweep.adaptive_sampling import FIRST_ROUND, ROUNDS_WITH_SLOPES, error_ratio, sample_grid
from metafab.library.sweep.checkpoint import SolvedPoint
from metafab.spec import UnitCell
from tests import library_ridges as ridges
from tests.unit.library.sweep.conftest import Solving


def test_a_shortfall_is_that_of_the_worst_miss() -> None:
    """Misses of 6 and 1 where 2 and 3 were foreseen, the solver's own error of 1 included: 6 / 3."""
    miss, certificate, disagreement = np.array([6.0, 1.0]), np.array([1.0, 1.0]), np.array([2.0, 3.0])
    assert error_ratio(miss, certificate, disagreement) == 2.0
    assert error_ratio(0.1 * miss, certificate, disagreement) == 1.0


def test_the_factor_is_not_forgotten_in_the_next_round(cell: UnitCell, grid: SizeGrid, solving: Solving) -> None:
    """Models that are 5 times farther from the truth than from each other: no round may take them at their word.

    A factor measured on estimates that the last one had scaled already would be 5 in every second round and 1 in the
    others, where the build would end although every unsolved size misses the tolerance.
    """
    near = RankedModels(cast(RationalModel, ridges.Shifted(5e-4)), (cast(RationalModel, ridges.Shifted(4e-4)),))
    sampling = sample_grid(grid, solving(partial(grid.cell, cell)), 2e-4, fit=lambda *_: near)
    assert len(sampling.solved) == grid.distinct.size
    # The solver's certificate of 1e-6 stands beside the disagreement of 1e-4.
    assert sampling.safety_factor == pytest.approx(5e-4 / 1.01e-4)


def test_progress_foresees_no_more_than_it_can_know(cell: UnitCell) -> None:
    """The first round is all that is foreseen until it has shown how much is left; the end is the number solved."""
    seen: list[tuple[int, int]] = []
    built = library.build(cell, solver=ridges.solve, progress=lambda _, done, total: seen.append((done, total)))
    assert seen[0][1] == FIRST_ROUND
    assert all(done <= total for done, total in seen)
    assert seen[-1] == (built.statistics.points_solved,) * 2


def test_slopes_take_the_place_of_sizes(cell: UnitCell) -> None:
    values, slopes = (library.build(cell, solver=solver) for solver in (ridges.solve, ridges.solve_with_slopes))
    true = np.vectorize(ridges.amplitude)(*np.meshgrid(slopes.width_nm, slopes.length_nm))
    for built in (values, slopes):
        assert np.all(np.abs(built.t_xx[0] - true) <= built.error_of_sizes)
    assert slopes.statistics.points_solved < 0.8 * values.statistics.points_solved


def test_slopes_serve_the_first_rounds_alone(cell: UnitCell, grid: SizeGrid, solving: Solving) -> None:
    """Models that never agree: after the last round with slopes neither solver nor fit is asked for them."""
    asked, fitted = [], []
    never = RankedModels(cast(RationalModel, ridges.Shifted(5e-3)), (cast(RationalModel, ridges.Shifted(0.0)),))

    def solver(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        asked.append(numerics.slopes)
        return ridges.solve_with_slopes(cell, numerics)

    def fit(_: SizeGrid, solved: dict[int, SolvedPoint], *__: object) -> RankedModels:
        fitted.append(max(len(point.amplitudes) for point in solved.values()))
        return never

    points = solving(partial(grid.cell, cell), solver)
    sample_grid(grid, replace(points, numerics=replace(points.numerics, slopes=True)), 2e-4, fit=fit)
    assert fitted[:ROUNDS_WITH_SLOPES] == [12] * (ROUNDS_WITH_SLOPES - 1) + [4]
    assert asked[0]
    assert not asked[-1]


@pytest.mark.parametrize("lengths", [1, 2, 3])
def test_a_few_lengths_are_solved_without_a_model_or_sizes_between(unit_cell: UnitCell, lengths: int) -> None:
    """Models over two lengths missed up to 1.8 times their stated error, and sizes between serve no surface."""
    sweep = replace(unit_cell.sweep, length_nm=(150.0, 150.0 + (lengths - 1) * unit_cell.sweep.size_grid_nm))
    found = library.build(replace(unit_cell, sweep=sweep), solver=ridges.solve)
    assert found.statistics.points_solved == found.t_xx.size > 75
    assert found.model is None
    assert found.statistics.sizes_beyond_target == 0


def test_a_small_batch_is_shared_size_by_size(cell: UnitCell, grid: SizeGrid, solving: Solving) -> None:
    """Four resonant sizes in one chunk would keep one worker busy alone."""
    reported: list[int] = []

    def solve(each: PillarCell, numerics: CellNumerics) -> CellResponse:
        reported.append(len(points.record.points))
        return ridges.solve(each, numerics)

    points = solving(partial(grid.cell, cell), solve)
    points(grid.space_filling[:6], 6)
    assert reported == [0, 1, 2, 3, 4, 5]
