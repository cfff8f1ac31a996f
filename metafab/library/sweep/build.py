"""Unit cell -> Library, to an asked error; in memory, or as a file that a kill does not set back."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from metafab.cell import CellNumerics, CellSolver, solve
from metafab.core.conventions import ComplexArray
from metafab.core.parallel.executor import SerialExecutor
from metafab.core.parallel.progress import Progress, silent
from metafab.library.axes import CornerBox, corner_unit_cell
from metafab.library.corners import Corners
from metafab.library.fit.sampling import SizeGrid
from metafab.library.library import Library, inputs_of
from metafab.library.store import is_current, load, save
from metafab.library.sweep.adaptive_sampling import Outcome, PointSolver, amplitudes_of, sample
from metafab.library.sweep.between import Between, FineGrid, sample_between
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.library.sweep.corner_rounds import CornerSequence, sample_corners
from metafab.library.sweep.steep import sample_steep, stated
from metafab.library.use.quality import coverage_rad
from metafab.spec import UnitCell
from metafab.spec.cell import Axes

BoolArray = NDArray[np.bool_]

#: Parts of the target error that the solver and the model may use; the rest is that of continuous evaluation.
SOLVER_SHARE = 0.5
MODEL_SHARE = 0.4


def build(
    unit_cell: UnitCell,
    *,
    target_error: float | None = None,
    executor: Executor | None = None,
    checkpoint: Path | None = None,
    progress: Progress = silent,
    solver: CellSolver = solve,
) -> Library:
    """Sweep width and length on the manufacturable grid until every size is known to the target error.

    Args:
        unit_cell: what is swept.
        target_error: largest error in any complex amplitude; replaces the one of ``unit_cell.sweep``.
        executor: where sizes are solved; this process when None.
        checkpoint: file that keeps solved sizes across a kill; the same call continues from it. It stays when
            the build has ended (:func:`build_file` removes its own once the library is saved).
        progress: called with the number of solved sizes and how many are foreseen.
        solver: solves one unit cell; must be importable by the workers.

    Returns:
        The library. Its ``error`` is solver certificate plus interpolation estimate at each size; a size that
        could not be had within the target says so there and in ``details["sizes_beyond_target"]``.

    Raises:
        InputError: ``checkpoint`` belongs to another build.
    """
    unit_cell = _asking(unit_cell, target_error)
    with Checkpoint(checkpoint, inputs_of(unit_cell)) as record:
        return _build(unit_cell, record, executor or SerialExecutor(), progress, solver)


def build_file(
    unit_cell: UnitCell,
    path: Path,
    *,
    target_error: float | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
    solver: CellSolver = solve,
) -> Library:
    """Build a library and save it; a killed build goes on where it stopped.

    Solved sizes are kept beside the file, under a name that holds the fingerprint of the build's inputs, until the
    library is saved. Of two processes that build the same library, the later one waits and takes over the
    other's file.

    Args:
        unit_cell: what is swept.
        path: the library file; an earlier one is replaced when the new one is whole.
        target_error: as in :func:`build`; likewise ``executor``, ``progress`` and ``solver``.
        executor: see ``target_error``.
        progress: see ``target_error``.
        solver: see ``target_error``.

    Returns:
        The library, as saved.

    Raises:
        InputError: the checkpoint beside the file is damaged.
    """
    unit_cell = _asking(unit_cell, target_error)
    inputs = inputs_of(unit_cell)
    checkpoint = path.with_name(f"{path.stem}.{inputs[:8]}.partial")
    with Checkpoint(checkpoint, inputs) as record:
        if record.waited and is_current(path, unit_cell):
            built = load(path)
        else:
            built = _build(unit_cell, record, executor or SerialExecutor(), progress, solver)
            save(built, path)
        record.remove()
    return built


def _asking(unit_cell: UnitCell, target_error: float | None) -> UnitCell:
    if target_error is None:
        return unit_cell
    return replace(unit_cell, sweep=replace(unit_cell.sweep, target_error=target_error))


def _build(
    unit_cell: UnitCell, record: Checkpoint, executor: Executor, progress: Progress, solver: CellSolver
) -> Library:
    started = perf_counter()
    grid = SizeGrid.of(unit_cell)
    for wavelength_nm in dict((unit_cell.sweep.axes or Axes()).asked).get("wavelength_nm", ()):
        grid.cell(corner_unit_cell(unit_cell, {"wavelength_nm": wavelength_nm}), 0)  # refused before any work
    asked = unit_cell.sweep.target_error
    numerics = CellNumerics(SOLVER_SHARE * asked, unit_cell.solver.name)
    # One thread for the fits: their rounding, and with it the choice of sizes, must not depend on the machine's.
    fine = FineGrid.of(grid)
    with threadpool_limits(1):
        sizes = PointSolver(partial(grid.cell, unit_cell), numerics, solver, executor, record, progress)
        outcome = sample(grid, sizes, MODEL_SHARE * asked)
        solve_points = replace(sizes, cell_of=partial(fine.cell, unit_cell))
        between = sample_between(grid, fine, outcome, solve_points, MODEL_SHARE * asked)
        target = (SOLVER_SHARE + MODEL_SHARE) * asked
        between = sample_steep(grid, fine, outcome, between, solve_points, target)
        corners = None
        if (box := CornerBox.of(unit_cell)) is not None:
            sequence = CornerSequence(unit_cell, box, first_number=fine.end_number)
            solve_points = replace(sizes, cell_of=sequence.cell)
            corners = sample_corners(grid, box, sequence, outcome.solved, solve_points, MODEL_SHARE * asked)
    progress("library", len(record.points), len(record.points))
    return _library(unit_cell, grid, fine, outcome, between, corners, perf_counter() - started)


def _library(
    unit_cell: UnitCell,
    grid: SizeGrid,
    fine: FineGrid,
    outcome: Outcome,
    between: Between,
    corners: Corners | None,
    seconds: float,
) -> Library:
    """Values of all sizes: the solver's where it was asked, the model's elsewhere; NaN where there is neither."""
    model = None if between.models is None else between.models.best
    values, is_solved = _on_grid(grid, outcome)
    certificate, around = stated(grid, fine, outcome, between)
    if model is not None:
        values = np.where(is_solved, values, model.on_grid(grid.width_nm, grid.length_nm))
    values[:, np.isnan(certificate)] = np.nan
    error = certificate + np.where(is_solved, 0.0, between.model_error)
    t_xx, t_yy, r_xx, r_yy = values[:, None]
    around = around + between.between_error
    points = [*outcome.solved.values(), *between.solved.values()]
    spent = np.array([point.seconds for point in points])
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
        model_error=None if model is None else around,
        corners=corners,
    )
    library.spent.update(seconds=seconds, solver_ms_per_point=float(1e3 * spent.mean()))
    degrees = model.x.degrees if model is not None else (0, 0)
    library.details.update(
        points_solved=len(points),
        points_between=len(between.solved),
        points_total=int(np.count_nonzero(np.isfinite(error))),
        max_error=float(np.nanmax(error)),
        sizes_beyond_target=int(np.count_nonzero(error > unit_cell.sweep.target_error)),
        max_solver_error=float(np.nanmax(certificate)),
        max_model_error=float(np.max(between.model_error, where=~is_solved, initial=0.0)),
        **_between_sizes(library),
        held_out_error=outcome.held_out_error,
        held_out=outcome.held_out.size,
        rounds=outcome.rounds,
        numerator_degree=degrees[0],
        denominator_degree=degrees[1],
        coverage_rad=coverage_rad(library),
        **({} if corners is None else corners.details),
    )
    return library


def _between_sizes(library: Library) -> dict[str, float]:
    """The largest error stated between the sizes: of the model, or of the spline through sizes that were all solved.

    Nothing where a library is not continuous: of circles, or of fewer than four sizes a side.
    """
    if library.model_error is not None:
        return {"max_between_error": float(library.model_error.max())}
    if not library.is_continuous:
        return {}
    middle = (0.5 * (axis[1:] + axis[:-1]) for axis in (library.width_nm, library.length_nm))
    return {"max_between_error": float(library.surface(*np.meshgrid(*middle)).error.max())}


def _on_grid(grid: SizeGrid, outcome: Outcome) -> tuple[ComplexArray, BoolArray]:
    """Solved amplitudes (4, n_length, n_width), zero elsewhere, and which were solved."""
    number = np.array(list(outcome.solved), dtype=np.intp)
    amplitudes = amplitudes_of(list(outcome.solved.values()))
    if grid.exchange:
        number = np.concatenate([number, grid.exchanged(number)])
        amplitudes = np.concatenate([amplitudes, amplitudes[:, [1, 0, 3, 2]]])
    shape = (grid.length_nm.size, grid.width_nm.size)
    values = np.zeros((4, grid.size), dtype=np.complex128)
    values[:, number] = amplitudes.T
    is_solved = np.zeros(grid.size, dtype=bool)
    is_solved[number] = True
    return values.reshape(4, *shape), is_solved.reshape(shape)
