"""Response of pillars of any size: stored on the grid, interpolated between, solved beyond the sweep.

A library of circles, or of one width or length, is not continuous: between its sizes, pillars are solved too.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from metafab.cell import PillarCell, curved, is_square
from metafab.cell.rcwa import zero_order
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import SerialExecutor, in_order, one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.library.axes import incidence
from metafab.library.library import Library
from metafab.library.surface import SizeResponse

#: RCWA: cosines along each axis.
_ORDERS = 5
#: Spectral elements: polynomial order.
_ELEMENT_ORDER = 5
#: Error of upright rectangles at these cosines; no smaller error is stated for any cell.
SOLVER_ERROR = 1e-3
#: Cells that are solved once more, finer, to estimate the error of all.
_JUDGED = 3
#: RCWA: cosines and fewest slices of the finer solution. A circle of 200 nm with walls of 87 degrees changes by 0.10.
_JUDGE_ORDERS, _JUDGE_SLICES = 9, 16
#: RCWA: error over the change to the finer solution.
_MARGIN = 1.5
#: Spectral elements: cells that are compared with the next lower order to find those that change most.
_COMPARED = 24
#: Spectral elements: error over the change to the next higher order. It was 0.4 to 1.9 on random circles, ellipses and
#: rings of indices of 3.3 to 3.8, against order 8. Errors of order 5 were up to 6.8e-3 there, and 0.1 beside a sharp
#: resonance of a ring.
_ELEMENT_MARGIN = 2.5
#: Most sizes that are solved at once: about a minute. Circles take ten minutes in one process.
MOST_SOLVED = 4000
#: Difference up to which two sizes count as equal (nm).
_SAME_NM = 1e-6


def solved_amplitudes(
    tasks: Sequence[tuple[PillarCell, int]], executor: Executor | None = None, progress: Progress = silent
) -> ComplexArray:
    """Return (t_xx, t_yy) of cells, each with a number of slices of its sidewall; shape (n, 2).

    All are solved at one truncation of one solver, so that its error is nearly the same with and without a small
    change: by spectral elements where all cells have them, and otherwise by RCWA. The result does not depend on the
    executor (None for this process).
    """
    has_elements = all(curved.is_treated(cell) for cell, _ in tasks)
    amplitudes = np.empty((len(tasks), 2), dtype=np.complex128)
    # One thread of linear algebra here as in worker processes, so that results are bit-identical.
    with one_blas_thread():
        solve = partial(_solve, has_elements=has_elements)
        for done, t in enumerate(in_order(executor or SerialExecutor(), solve, list(tasks))):
            amplitudes[done] = t
            progress("corners", done + 1, len(tasks))
    return amplitudes


def _solve(task: tuple[PillarCell, int], *, has_elements: bool) -> ComplexArray:
    cell, slices = task
    if has_elements:
        return np.diagonal(curved.zero_order(cell, _ELEMENT_ORDER).t).copy()
    return np.diagonal(zero_order(cell, _ORDERS, "adaptive", slices).t).copy()


def solver_error(tasks: Sequence[tuple[PillarCell, int]], amplitudes: ComplexArray) -> float:
    """Return the error of :func:`solved_amplitudes`, which gave the amplitudes of shape (n, 2).

    The error of upright rectangles is known. Otherwise three cells are solved once more, finer: with RCWA, three of
    those with sloped walls or crosses, spread evenly; with spectral elements, the three that change most from the next
    lower order.
    """
    by_elements = all(curved.is_treated(cell) for cell, _ in tasks)
    if by_elements:
        judged = _least_converged(tasks, amplitudes)
    else:
        doubtful = [number for number, (cell, _) in enumerate(tasks) if cell.is_sloped or cell.is_shaped]
        judged = doubtful[:: max(1, len(doubtful) // _JUDGED)][:_JUDGED]
    error = SOLVER_ERROR
    with one_blas_thread():
        for number in judged:
            cell, slices = tasks[number]
            if by_elements:
                margin, finer = _ELEMENT_MARGIN, curved.zero_order(cell, _ELEMENT_ORDER + 1)
            else:
                margin, finer = _MARGIN, zero_order(cell, _JUDGE_ORDERS, "adaptive", max(2 * slices, _JUDGE_SLICES))
            error = max(error, margin * float(np.abs(np.diagonal(finer.t) - amplitudes[number]).max()))
    return error


def _least_converged(tasks: Sequence[tuple[PillarCell, int]], amplitudes: ComplexArray) -> list[int]:
    """Numbers of the cells whose amplitudes change most from the next lower order of the elements."""
    spread = range(0, len(tasks), -(-len(tasks) // _COMPARED) or 1)
    with one_blas_thread():
        coarse = [np.diagonal(curved.zero_order(tasks[number][0], _ELEMENT_ORDER - 1).t) for number in spread]
    change = [float(np.abs(t - amplitudes[number]).max()) for number, t in zip(spread, coarse, strict=True)]
    return [spread[place] for place in np.argsort(change)[-_JUDGED:]]


def swaps_polarisations(library: Library) -> bool:
    """Whether swapping width and length swaps the polarisations and nothing else: a square cell, light along z."""
    return is_square(library.unit_cell) and not incidence(library.corner)["angle_deg"]


def response_of_sizes(library: Library, size_nm: FloatArray, executor: Executor | None = None) -> SizeResponse:
    """Return the transmission of any sizes: positive widths and lengths, shape (n, 2).

    The result does not depend on the executor (None for this process). More than :data:`MOST_SOLVED` sizes that must be
    solved raise InputError.
    """
    t, error = np.empty((len(size_nm), 2), dtype=np.complex128), np.empty(len(size_nm))
    stored = _on_grid(library, size_nm)
    outside = ~stored & must_be_solved(library, size_nm)
    between = ~(stored | outside)
    if stored.any():
        found = library.at_sizes(*size_nm[stored].T)
        t[stored], error[stored] = np.stack([found.t_xx, found.t_yy], axis=1), found.error
    if between.any():
        found = library.surface(*size_nm[between].T)
        t[between], error[between] = np.stack([found.t_xx, found.t_yy], axis=1), found.error
    if outside.any():
        t[outside], error[outside] = _solved(library, size_nm[outside], executor)
    return SizeResponse(t[:, 0], t[:, 1], error)


def _on_grid(library: Library, size_nm: FloatArray) -> NDArray[np.bool_]:
    """Whether the library stores each size, shape (n,)."""
    place = []
    for grid, size in zip((library.width_nm, library.length_nm), size_nm.T, strict=True):
        nearest = np.clip(np.searchsorted(grid, size - _SAME_NM), 0, grid.size - 1)
        place.append(np.where(np.abs(grid[nearest] - size) <= _SAME_NM, nearest, -1))
    column, row = place
    return np.asarray((column >= 0) & (row >= 0) & library.known[row, column])


def must_be_solved(library: Library, size_nm: FloatArray) -> NDArray[np.bool_]:
    """Whether each size must be solved, shape (n,): the library cannot interpolate there. Sizes have shape (n, 2)."""
    if not library.is_continuous:
        return ~_on_grid(library, size_nm)
    low = np.array([library.width_nm[0], library.length_nm[0]]) - _SAME_NM
    high = np.array([library.width_nm[-1], library.length_nm[-1]]) + _SAME_NM
    return np.asarray(np.any((size_nm < low) | (size_nm > high), axis=1))


def _solved(library: Library, beyond: FloatArray, executor: Executor | None) -> tuple[ComplexArray, float]:
    """Amplitudes of solved sizes, shape (n, 2), and their error."""
    # A square cell's response is that of its mirror image, x and y exchanged.
    swapped = (beyond[:, 0] < beyond[:, 1]) & swaps_polarisations(library)
    solved, number = np.unique(np.where(swapped[:, None], beyond[:, ::-1], beyond), axis=0, return_inverse=True)
    if len(solved) > MOST_SOLVED:
        sweep = f"{library.width_nm[0]:g} to {library.width_nm[-1]:g} nm"
        got = f"{len(solved)} sizes beyond it, {beyond.min():g} to {beyond.max():g} nm"
        remedy = "build a library of a wider sweep"
        if not library.is_continuous:
            got, remedy = (
                f"{len(solved)} sizes between, that would be solved one by one",
                "round them to a coarser step",
            )
        raise InputError.single("library", "sweep", f"sizes within {sweep}", got, remedy)
    tasks = [(library.pillar(width_nm, length_nm), 8) for width_nm, length_nm in solved.tolist()]
    amplitudes = solved_amplitudes(tasks, executor)
    one_each = amplitudes[number.ravel()]
    return np.where(swapped[:, None], one_each[:, ::-1], one_each), solver_error(tasks, amplitudes)
