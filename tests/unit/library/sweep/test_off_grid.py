"""Sampling between the sizes: false resonances are found, steep places are solved, and the rest is stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias, cast

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import SerialExecutor
from metafab.core.parallel.progress import silent
from metafab.library.fit.models import RankedModels
from metafab.library.fit.rational import RationalModel
from metafab.library.fit.size_grid import SizeGrid
from metafab.library.sweep.adaptive_sampling import GridSampling, PointSolver, sample_grid
from metafab.library.sweep.build import BuildNumerics
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.library.sweep.off_grid import PARTS, OffGridSampler, OffGridSampling, RoundLimits
from metafab.spec import UnitCell
from tests import library_ridges as ridges
from tests.unit.library.sweep.conftest import Solving

TOLERANCE = 8e-4
Refined: TypeAlias = Callable[..., OffGridSampling]


@dataclass(frozen=True)
class Spiked:
    """A model with a false pole and a zero beside it: half a nanometre off every size, invisible on the grid."""

    true: RationalModel
    at_nm: tuple[float, float]
    half_width_nm: float = 0.2

    def __call__(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        return np.asarray(self.true(width_nm, length_nm) + self._spike(width_nm, length_nm)[:, None])

    def on_grid(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        width, length = np.meshgrid(width_nm, length_nm)
        return np.asarray(self.true.on_grid(width_nm, length_nm) + self._spike(width, length))

    def _spike(self, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
        away_nm = np.hypot(width_nm - self.at_nm[0], length_nm - self.at_nm[1])
        return np.asarray(0.05 * np.exp(-((away_nm / self.half_width_nm) ** 2)), dtype=np.float64)


@pytest.fixture(scope="module")
def sampling(cell: UnitCell, grid: SizeGrid, solving: Solving) -> GridSampling:
    return sample_grid(grid, solving(partial(grid.cell, cell)), TOLERANCE)


@pytest.fixture(scope="module")
def refined(cell: UnitCell, grid: SizeGrid, solving: Solving) -> Refined:
    """Samples the disagreement of models off the grid by the closed form."""

    def refined(sampling: GridSampling, **options: Any) -> OffGridSampling:
        sampler = OffGridSampler(cell, sampling, solving(partial(grid.cell, cell)), **options)
        return sampler.sample_disagreement(TOLERANCE)

    return refined


def test_a_false_resonance_between_the_sizes_is_solved_away(
    grid: SizeGrid, sampling: GridSampling, refined: Refined
) -> None:
    """Planted half-way between sizes of 5 nm steps; without a look between them it is stated, with one it is gone."""
    assert sampling.models is not None
    at_nm = (122.5, 227.5)
    best = cast(RationalModel, Spiked(sampling.models.best, at_nm))
    planted = replace(sampling, models=replace(sampling.models, best=best))
    place = np.array([at_nm[0]]), np.array([at_nm[1]])
    row, column = (int(np.argmin(np.abs(axis - at))) for axis, at in ((grid.length_nm, 227.5), (grid.width_nm, 122.5)))
    after = refined(planted)
    assert after.models is not None
    true = ridges.amplitude(*at_nm)
    assert abs(best(*place)[0, 0] - true) > 0.04
    assert abs(after.models.best(*place)[0, 0] - true) < TOLERANCE
    assert after.between_error[row, column] <= TOLERANCE
    sizes_nm = np.stack(grid.refined(PARTS).sizes_nm(np.array(list(after.solved))), axis=-1)
    sizes_nm = np.concatenate([sizes_nm, sizes_nm[:, ::-1]])  # a square cell: its mirror image serves as well
    assert np.hypot(*(sizes_nm - at_nm).T).min() < 1.0
    before = refined(planted, limits=RoundLimits(disagreement_rounds=0))
    assert not before.solved
    assert before.between_error[row, column] > 0.04


def test_what_cannot_be_had_between_the_sizes_is_stated_after_few_rounds(
    grid: SizeGrid, sampling: GridSampling, refined: Refined
) -> None:
    """Every fit brings the false resonance back: the rounds end all the same, and the error says what is left."""
    assert sampling.models is not None
    spiked = replace(sampling.models, best=cast(RationalModel, Spiked(sampling.models.best, (122.5, 227.5), 3.0)))
    after = refined(replace(sampling, models=spiked), fit=lambda *_: spiked)
    limits = RoundLimits()
    assert 0 < len(after.solved) <= limits.disagreement_sizes * limits.disagreement_rounds
    assert after.between_error.max() > 0.04


def test_what_the_fit_misses_at_solved_sizes_is_stated(
    grid: SizeGrid, sampling: GridSampling, refined: Refined
) -> None:
    """Both models off by the same 0.01: their disagreement knows nothing of it, the solved sizes between do."""
    assert sampling.models is not None
    off = cast(RationalModel, ridges.Shifted(0.01))
    spiked = replace(sampling.models, best=cast(RationalModel, Spiked(sampling.models.best, (122.5, 227.5))))
    after = refined(replace(sampling, models=spiked), fit=lambda *_: RankedModels(off, (off,)))
    row, column = np.searchsorted(grid.length_nm, 227.0), np.searchsorted(grid.width_nm, 122.0)
    assert after.between_error[row, column] == pytest.approx(0.01, abs=1e-5)


def test_the_finer_grid_holds_the_sizes_and_numbers_of_its_own(cell: UnitCell, sampling: GridSampling) -> None:
    """Two rows and columns off the first size; the checkpoint's numbers follow those of the sizes."""
    asked: list[PillarCell] = []

    def solve(pillar: PillarCell, numerics: CellNumerics) -> CellResponse:
        asked.append(pillar)
        return ridges.solve(pillar, numerics)

    record = Checkpoint(None, "")
    points = PointSolver(
        lambda _: pytest.fail("not a size"), CellNumerics(target_error=1e-3), solve, SerialExecutor(), record, silent
    )
    assert sampling.models is not None
    spiked = replace(sampling.models, best=cast(RationalModel, Spiked(sampling.models.best, (122.5, 227.5))))
    sampler = OffGridSampler(cell, replace(sampling, models=spiked), points)
    grid, fine = sampler.grid, sampler.fine
    assert np.allclose(fine.width_nm[::PARTS], grid.width_nm, rtol=0.0, atol=1e-12)
    assert fine.exchange == grid.exchange
    after = sampler.sample_disagreement(TOLERANCE)
    assert [point.number for point in record.points] == [number + grid.size for number in after.solved]
    assert all(grid.size <= point.number < sampler.end_number for point in record.points)
    sizes_nm = np.stack(fine.sizes_nm(np.array(list(after.solved))), axis=-1)
    np.testing.assert_allclose([(pillar.width_nm, pillar.length_nm) for pillar in asked], sizes_nm)


def test_a_size_that_is_solved_on_the_grid_is_not_solved_off_it(
    cell: UnitCell, grid: SizeGrid, sampling: GridSampling, solving: Solving
) -> None:
    limits = RoundLimits(steep_rounds=3, steep_sizes=grid.size)
    sampler = OffGridSampler(cell, sampling, solving(partial(grid.cell, cell)), limits)
    start = OffGridSampling({}, sampling.models, np.zeros(grid.shape), np.zeros(grid.shape))
    after = sampler.sample_steep_places(start, 0.0)
    on, off = (
        {tuple(size) for size in np.stack(its_grid.sizes_nm(np.array(list(solved))), axis=-1).round(6).tolist()}
        for its_grid, solved in ((grid, sampling.solved), (sampler.fine, after.solved))
    )
    assert off
    assert not on & off


@pytest.mark.parametrize("solver_error", [1e-4, 3e-3])
def test_sizes_that_the_model_does_not_know_are_solved_where_the_solver_can(
    cell: UnitCell, grid: SizeGrid, sampling: GridSampling, solving: Solving, solver_error: float
) -> None:
    """A model is off by 0.05 at one size, and 25 sizes say that it may be: each is solved, its mirror image is not."""
    solved = {number: replace(point, error=solver_error) for number, point in sampling.solved.items()}
    sampler = OffGridSampler(cell, replace(sampling, solved=solved), solving(partial(grid.cell, cell)))
    stated = np.full(grid.shape, 1e-4)
    stated[20:25, 12:17] = stated[12:17, 20:25] = 5e-3
    assert sampling.models is not None
    best = cast(RationalModel, Spiked(sampling.models.best, (grid.width_nm[14], grid.length_nm[22])))
    start = OffGridSampling({}, replace(sampling.models, best=best), stated, np.zeros(grid.shape))
    after = sampler.sample_open_sizes(start, 2e-3)
    square = {row * grid.width_nm.size + column for row in range(20, 25) for column in range(12, 17)}
    expected = square - solved.keys() if solver_error < 2e-3 else set()
    assert sampler.sampling.solved.keys() - solved.keys() == expected
    assert after.between_error[22, 14] == pytest.approx(0.05 if expected else 0.0, rel=0.01)


def test_steep_places_are_solved_until_the_target_holds_between_the_sizes(
    unit_cell: UnitCell,
) -> None:
    """Resonances shifted by 0.5 pm: 7e-4 is certified at the steepest sizes, which few of the others are."""

    def shifted(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        true = ridges.solve(cell, numerics)
        off = ridges.solve(replace(cell, width_nm=cell.width_nm + 5e-4, length_nm=cell.length_nm + 5e-4), numerics)
        return replace(off, cell=cell, error=1.4 * float(np.abs(off.t - true.t).max()) + 1e-6)

    target = unit_cell.sweep.target_error
    built = library.build(unit_cell, solver=shifted)
    assert built.model_error is not None
    assert built.model_error.max() <= target
    width_nm, length_nm = np.random.default_rng(14).uniform(100.0, 250.0, (2, 2000))
    true = np.array([ridges.amplitude(w, h) for w, h in zip(width_nm, length_nm, strict=True)])
    held = built.surface(width_nm, length_nm)
    assert np.all(np.abs(held.t_xx - true) <= held.error)
    without = library.build(unit_cell, solver=shifted, numerics=BuildNumerics(off_grid=RoundLimits(steep_rounds=0)))
    assert without.statistics.max_between_error >= built.statistics.max_between_error
