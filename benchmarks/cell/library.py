"""The paper's library by adaptive sampling, compared with a grid of solved sizes and interpolation.

``error`` is the largest error of t_xx or t_yy at random sizes off every grid, against the certified solver at a tenth
of the target. ``seconds`` is the time of the build on all cores, ``cpu_seconds`` the processor time of all its
processes (the figure to quote on a shared machine), ``points_solved`` the number of unit cells solved. Both methods use
one solver, one target error and the exchange of x and y, and solve every distinct size once.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from metafab import library
from metafab.cell import CellNumerics, pillar_cell, solve_many
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import default_workers, open_executor
from metafab.core.parallel.measure import Cost, measured
from metafab.library import Library
from metafab.spec import UnitCell, load_unit_cell

UNIT_CELL = Path(__file__).parents[2] / "unitcell_lib" / "sos_800nm.toml"
#: Target error of the reference solver over that of the library.
FINER = 0.1
#: Share of the target that the solver may use on the customary grids, as in the build.
SOLVER_SHARE = 0.5
#: Sizes of one timed call of the evaluation, and number of calls.
SIZES, REPEATS = 1_000_000, 5


class Spent(Cost):
    """Cost with the processor time of this process and of the workers that have ended."""

    cpu_seconds = 0.0


def rows(quick: bool) -> list[dict[str, Any]]:
    """Return rows for each target of the adaptive build, for grids of 5 nm (and 2 nm) steps, and for evaluation.

    Args:
        quick: one target and one grid, over the corner of the large pillars, where resonances lie close.
    """
    whole = load_unit_cell(UNIT_CELL)
    cell = replace(whole, sweep=replace(whole.sweep, width_nm=(200.0, 250.0), length_nm=(200.0, 250.0)))
    cell = cell if quick else whole
    sizes_nm = np.random.default_rng(5).uniform(*cell.sweep.width_nm, (2, 40 if quick else 500))
    with open_executor() as executor:
        reference = _transmission(cell, sizes_nm, FINER * cell.sweep.target_error, executor)
    table = []
    for target in (2e-3,) if quick else (1e-2, 2e-3, 5e-4):
        built, row = _adaptive_row(cell, target, sizes_nm, reference)
        table.append(row)
    for step_nm in (5.0,) if quick else (5.0, 2.0):
        table += _grid_rows(cell, step_nm, sizes_nm, reference)
    return [*table, _evaluation_row(built, quick)]


def _adaptive_row(
    cell: UnitCell, target: float, sizes_nm: FloatArray, reference: ComplexArray
) -> tuple[Library, dict[str, Any]]:
    with _measured() as spent, open_executor() as executor:
        built = library.build(cell, target_error=target, executor=executor)
    held = built.surface(*sizes_nm)
    miss = np.abs(np.stack([held.t_xx, held.t_yy], axis=-1) - reference).max(axis=-1)
    points = built.statistics.points_solved
    beyond = int(np.count_nonzero(miss > held.error + FINER * cell.sweep.target_error))
    return built, _row(f"adaptive, target {target:g}", miss, spent, points, misses_beyond_stated_error=beyond)


def _grid_rows(cell: UnitCell, step_nm: float, sizes_nm: FloatArray, reference: ComplexArray) -> list[dict[str, Any]]:
    """One solved grid, interpolated in two ways."""
    axis = np.arange(cell.sweep.width_nm[0], cell.sweep.width_nm[1] + 0.5 * step_nm, step_nm)
    row, column = np.tril_indices(axis.size)
    with _measured() as spent, open_executor() as executor:
        answers = _transmission(
            cell, np.stack([axis[column], axis[row]]), SOLVER_SHARE * cell.sweep.target_error, executor
        )
    t = np.empty((axis.size, axis.size, 2), dtype=np.complex128)
    t[row, column], t[column, row] = answers, answers[:, ::-1]
    methods = {"bilinear in phase and amplitude": _polar, "bilinear in complex t": _bilinear}
    table = []
    for name, method in methods.items():
        miss = np.abs(method(axis, t, sizes_nm) - reference).max(axis=-1)
        table.append(_row(f"{step_nm:g} nm grid, {name}", miss, spent, row.size))
    return table


def _evaluation_row(built: Library, quick: bool) -> dict[str, Any]:
    """Continuous evaluation of random sizes; ``error`` is the library's largest error bound at them."""
    count = SIZES // 10 if quick else SIZES
    axes = (built.width_nm, built.length_nm)
    rng = np.random.default_rng(6)
    sizes_nm = [rng.uniform(axis[0], axis[-1], count) for axis in axes]
    held = built.surface(*sizes_nm)  # builds the table and compiles
    with _measured() as spent:
        for _ in range(REPEATS):
            held = built.surface(*sizes_nm)
    return {
        "name": "evaluation of random sizes",
        "error": float(held.error.max()),
        "seconds": spent.seconds,
        "peak_rss_mb": spent.peak_rss_mb,
        "cpu_seconds": spent.cpu_seconds,
        "sizes_per_second": REPEATS * count / spent.seconds,
        "sizes_per_cpu_second": REPEATS * count / spent.cpu_seconds,
        "table_mb": built.surface.tiles.nbytes / 1e6,
    }


def _transmission(cell: UnitCell, sizes_nm: FloatArray, target: float, executor: Executor) -> ComplexArray:
    """Solve t_xx and t_yy of sizes: shape (2, n) -> (n, 2)."""
    cells = [pillar_cell(cell, width, length) for width, length in sizes_nm.T.tolist()]
    place = {(item.width_nm, item.length_nm): k for k, item in enumerate(cells)}
    t = np.empty((len(cells), 2), dtype=np.complex128)
    for answer in solve_many(cells, CellNumerics(target_error=target), executor):
        t[place[answer.cell.width_nm, answer.cell.length_nm]] = np.diag(answer.t)
    return t


def _polar(axis: FloatArray, t: ComplexArray, sizes_nm: FloatArray) -> ComplexArray:
    phase = np.unwrap(np.unwrap(np.angle(t), axis=0), axis=1)
    return np.asarray(_bilinear(axis, np.abs(t), sizes_nm) * np.exp(1j * _bilinear(axis, phase, sizes_nm)))


def _bilinear(axis: FloatArray, values: Any, sizes_nm: FloatArray) -> Any:
    """Values on the grid [length, width, polarisation] at scattered widths and lengths (2, n): shape (n, 2)."""
    return RegularGridInterpolator((axis, axis), values)(sizes_nm[::-1].T)


@contextmanager
def _measured() -> Iterator[Spent]:
    spent = Spent()
    before = _cpu_seconds()
    with measured() as cost:
        yield spent
    spent.seconds = cost.seconds
    spent.peak_rss_mb = cost.peak_rss_mb
    spent.cpu_seconds = _cpu_seconds() - before


def _cpu_seconds() -> float:
    return sum(os.times()[:4])


def _row(name: str, miss: FloatArray, spent: Spent, points: int, **more: float) -> dict[str, Any]:
    return {
        "name": name,
        "error": float(miss.max()),
        "seconds": spent.seconds,
        "peak_rss_mb": spent.peak_rss_mb,
        "rms_error": float(np.sqrt(np.mean(miss**2))),
        "cpu_seconds": spent.cpu_seconds,
        "points_solved": points,
        "workers": default_workers(),
        **more,
    }
