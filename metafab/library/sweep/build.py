"""Build a library to a target error, in memory or as a file; a killed build can continue."""

from __future__ import annotations

import math
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from metafab.cell import CellNumerics, CellSolver, solve
from metafab.core.arguments import require_types
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import BuildStatistics
from metafab.core.parallel.executor import SerialExecutor, one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.library.axes import CornerBox, Corners, corner_unit_cell
from metafab.library.fit.size_grid import SizeGrid
from metafab.library.library import BuildTime, Library, inputs_of
from metafab.library.store import is_current, load, save
from metafab.library.sweep.adaptive_sampling import (
    FIRST_ROUND,
    GridSampling,
    PointSolver,
    amplitudes_of,
    sample_grid,
    without_slopes,
)
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.library.sweep.corner_sampling import CornerNumerics, CornerSequence, sample_corners
from metafab.library.sweep.off_grid import OffGridSampler, OffGridSampling, RoundLimits
from metafab.library.use.quality import coverage_rad
from metafab.spec import UnitCell
from metafab.spec.cell import Axes

#: Shares of the target error for solver and model; the remainder is left to the evaluation between the sizes.
SOLVER_SHARE = 0.5
MODEL_SHARE = 0.4
#: Largest target error of RCWA where models are fitted to its answers. Poles follow the noise of looser answers: at a
#: target of 1e-2, silicon at 800 nm takes 368 solves without this limit and 172 with it.
FITTED_SOLVER_ERROR = 2e-3
#: Fewest and most cells of a build over sizes. Measured on the unit cells of the repository: 117 for silicon at 800 nm,
#: 315 at 940 nm, 875 at 1550 nm, 398 for titanium dioxide at 532 nm; the limits leave room for cells not measured.
_FEW_CELLS, _MANY_CELLS = 100, 1100


@dataclass(frozen=True)
class BuildNumerics:
    """Size of the adaptive sampling beyond the grid of sizes."""

    every_size: bool = False  #: Solve every distinct size of the grid, none by a model.
    off_grid: RoundLimits = field(default_factory=RoundLimits)  #: Rounds between the sizes of the grid.
    corners: CornerNumerics = field(default_factory=CornerNumerics)  #: Sampling over the axes of the sweep.


def build(
    unit_cell: UnitCell,
    *,
    target_error: float | None = None,
    executor: Executor | None = None,
    checkpoint: Path | None = None,
    progress: Progress = silent,
    solver: CellSolver = solve,
    numerics: BuildNumerics = BuildNumerics(),
) -> Library:
    """Sweep width and length on the manufacturable grid until every size is known to the target error.

    The library's ``error`` is solver certificate plus interpolation estimate at each size.
    ``statistics.sizes_beyond_target`` counts the sizes whose error is above the target.

    Args:
        target_error: largest error in any complex amplitude; default is ``unit_cell.sweep.target_error``.
        executor: runs the solver; None for this process.
        checkpoint: file that keeps the solved sizes; after a kill, a call with equal arguments continues from it. It is
            not removed at the end. One of another build raises InputError.
        solver: solves one unit cell; must be importable by the workers.
    """
    require_types("library", unit_cell=(unit_cell, UnitCell))
    unit_cell = with_target(unit_cell, target_error)
    with Checkpoint(checkpoint, inputs_of(unit_cell)) as record:
        return _build(unit_cell, record, executor or SerialExecutor(), progress, solver, numerics)


def build_lone(
    unit_cell: UnitCell,
    path: Path,
    executor: Executor | None,
    progress: Progress,
    solver: CellSolver,
    numerics: BuildNumerics,
) -> Library:
    """Build a library of pillars among equal neighbours and save it.

    Its checkpoint is named by the fingerprint of the build's inputs. :func:`metafab.library.build_file` adds the model
    of neighbours.
    """
    inputs = inputs_of(unit_cell)
    with Checkpoint(path.with_name(f"{path.stem}.{inputs[:8]}.partial"), inputs) as record:
        if record.waited and is_current(path, unit_cell):
            built = load(path)
        else:
            built = _build(unit_cell, record, executor or SerialExecutor(), progress, solver, numerics)
            save(built, path)
        record.remove()
    return built


def expected_cells(unit_cell: UnitCell) -> tuple[int, int]:
    """Least and largest number of unit cells that a build solves; equal where it solves every size.

    In between, the number of resonances decides. What a cell takes is measured on the first ones of a build.
    """
    grid, box = SizeGrid.of(unit_cell), CornerBox.of(unit_cell)
    distinct = grid.distinct.size
    few = many = distinct
    if not _solves_all(grid):
        few, many = min(_FEW_CELLS, distinct), min(_MANY_CELLS, distinct + RoundLimits().most_sizes)
    dimensions = 0 if box is None else box.dimensions
    return few + CornerNumerics.first_round * dimensions, many + CornerNumerics.most_cells * dimensions


def _solves_all(grid: SizeGrid) -> bool:
    """Whether the first round of :func:`sample_grid` solves every size."""
    return grid.is_narrow or grid.distinct.size <= FIRST_ROUND


def solver_target(unit_cell: UnitCell, *, every_size: bool = False) -> float:
    """Target error of the solver at the sizes of the grid; smaller where RCWA's answers are fitted by models.

    Round pillars, a few widths or lengths, and grids of no more sizes than the first round need no model: the solver
    gets its share as well, unless models of corners are fitted. ``every_size`` is :attr:`BuildNumerics.every_size`, a
    reference for models.
    """
    target = unit_cell.sweep.target_error
    share = SOLVER_SHARE * target
    if every_size:
        return share
    if _solves_all(SizeGrid.of(unit_cell)):
        return share if CornerBox.of(unit_cell) is not None else share + MODEL_SHARE * target
    return min(share, FITTED_SOLVER_ERROR) if unit_cell.solver.name == "rcwa" else share


def with_target(unit_cell: UnitCell, target_error: float | None) -> UnitCell:
    """The unit cell with another target error; None keeps its own."""
    if target_error is None:
        return unit_cell
    return replace(unit_cell, sweep=replace(unit_cell.sweep, target_error=target_error))


def _build(
    unit_cell: UnitCell,
    record: Checkpoint,
    executor: Executor,
    progress: Progress,
    solver: CellSolver,
    numerics: BuildNumerics,
) -> Library:
    started = perf_counter()
    grid = SizeGrid.of(unit_cell)
    # A material unknown at a wavelength is refused before any work.
    for wavelength_nm in (unit_cell.sweep.axes or Axes()).spans.get("wavelength_nm", ()):
        grid.cell(corner_unit_cell(unit_cell, {"wavelength_nm": wavelength_nm}), 0)
    target = unit_cell.sweep.target_error
    tolerance, corners = MODEL_SHARE * target, None
    # One thread for the fits: their rounding decides which sizes are solved and must not depend on the machine.
    with one_blas_thread():
        cell_numerics = CellNumerics(target_error=SOLVER_SHARE * target, solver=unit_cell.solver.name)
        first_round = grid.size if numerics.every_size else FIRST_ROUND
        size_target = solver_target(unit_cell, every_size=numerics.every_size)
        size_numerics = replace(cell_numerics, target_error=size_target, slopes=not numerics.every_size)
        sizes = PointSolver(partial(grid.cell, unit_cell), size_numerics, solver, executor, record, progress)
        sampling = sample_grid(grid, sizes, tolerance, first_round=first_round)
        sampler = OffGridSampler(unit_cell, sampling, sizes, numerics.off_grid)
        off_grid = sampler.sample_disagreement(tolerance)
        off_grid = sampler.sample_steep_places(off_grid, (SOLVER_SHARE + MODEL_SHARE) * target)
        off_grid = sampler.sample_open_sizes(off_grid, target)
        sampling = sampler.sampling
        if (box := CornerBox.of(unit_cell)) is not None:
            sequence = CornerSequence(unit_cell, box, sampler.end_number, numerics.corners.sequence)
            points = replace(sizes, cell_of=sequence.cell, numerics=cell_numerics, step="library over its axes")
            nominal = without_slopes(sampling.solved)
            corners = sample_corners(grid, box, sequence, nominal, points, tolerance, numerics.corners)
    progress("library", len(record.points), len(record.points))
    library = _library(unit_cell, sampling, off_grid, sampler.certified_errors(off_grid), corners)
    solver_seconds = [point.seconds for point in (*sampling.solved.values(), *off_grid.solved.values())]
    return replace(library, time=BuildTime(perf_counter() - started, float(1e3 * np.mean(solver_seconds))))


def _library(
    unit_cell: UnitCell,
    sampling: GridSampling,
    off_grid: OffGridSampling,
    certified: tuple[FloatArray, FloatArray],
    corners: Corners | None,
) -> Library:
    """Amplitudes of all sizes: the solver's where solved, the model's elsewhere; NaN where there is neither.

    ``certified`` is the solver's error at the sizes and around them, shape (n_length, n_width) each.
    """
    grid, (certificate, certificate_around) = SizeGrid.of(unit_cell), certified
    model = None if off_grid.models is None else off_grid.models.best
    amplitudes, is_solved = _on_grid(grid, sampling)
    if model is not None:
        amplitudes = np.where(is_solved, amplitudes, model.on_grid(grid.width_nm, grid.length_nm))
    amplitudes = np.where(np.isnan(certificate), np.nan, amplitudes)
    error = certificate + np.where(is_solved, 0.0, off_grid.model_error)
    t_xx, t_yy, r_xx, r_yy = amplitudes[:, None]
    library = Library(
        unit_cell=unit_cell,
        wavelength_nm=np.array([unit_cell.illumination.wavelength_nm]),
        width_nm=grid.width_nm,
        length_nm=grid.length_nm,
        t_xx=t_xx,
        t_yy=t_yy,
        r_xx=r_xx,
        r_yy=r_yy,
        error=error[None],
        inputs_sha256=inputs_of(unit_cell),
        model=model,
        model_error=None if model is None else certificate_around + off_grid.between_error,
        corners=corners,
    )
    numerator_degree, denominator_degree = model.shape.degrees if model is not None else (0, 0)
    statistics = BuildStatistics(
        points_solved=len(sampling.solved) + len(off_grid.solved),
        points_between=len(off_grid.solved),
        points_total=int(np.count_nonzero(np.isfinite(error))),
        max_error=float(np.nanmax(error)),
        sizes_beyond_target=int(np.count_nonzero(error > unit_cell.sweep.target_error)),
        max_solver_error=float(np.nanmax(certificate)),
        max_model_error=float(np.max(off_grid.model_error, where=~is_solved, initial=0.0)),
        max_between_error=_max_between_error(library),
        held_out_error=sampling.held_out_error,
        held_out=sampling.held_out.size,
        rounds=sampling.rounds,
        numerator_degree=numerator_degree,
        denominator_degree=denominator_degree,
        coverage_rad=coverage_rad(library),
    )
    return replace(library, statistics=statistics)


def _max_between_error(library: Library) -> float:
    """Largest error bound between the sizes; NaN if the library is not continuous.

    The model gives it, or the spline if every size was solved.
    """
    if library.model_error is not None:
        return float(library.model_error.max())
    if not library.is_continuous:
        return math.nan
    middle = (0.5 * (axis[1:] + axis[:-1]) for axis in (library.width_nm, library.length_nm))
    return float(library.surface(*np.meshgrid(*middle)).error.max())


def _on_grid(grid: SizeGrid, sampling: GridSampling) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Solved amplitudes (4, n_length, n_width), zero elsewhere, and the mask of solved sizes (n_length, n_width)."""
    number = np.array(list(sampling.solved), dtype=np.intp)
    solved = amplitudes_of(list(sampling.solved.values()))
    if grid.exchange:
        number = np.concatenate([number, grid.exchanged(number)])
        solved = np.concatenate([solved, solved[:, [1, 0, 3, 2]]])
    amplitudes = np.zeros((4, grid.size), dtype=np.complex128)
    amplitudes[:, number] = solved.T
    is_solved = np.zeros(grid.size, dtype=bool)
    is_solved[number] = True
    return amplitudes.reshape(4, *grid.shape), is_solved.reshape(grid.shape)
