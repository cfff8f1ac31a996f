"""What the uncertainty of the pillar's index does to the library's phases."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np

from metafab.cell import CellNumerics, CellResponse, PillarCell, pillar_cell, solve
from metafab.core.conventions import ComplexArray
from metafab.core.parallel.executor import SerialExecutor, in_order
from metafab.library.library import Library

#: Sizes that are solved twice; the figure is an rms over them, not a maximum.
SAMPLES = 16


def index_phase_error_rad(library: Library, *, executor: Executor | None = None, samples: int = SAMPLES) -> float:
    """Phase error that the standard uncertainty ``n_error`` of the pillar's index causes.

    Sizes spread evenly over the sweep are solved with the index as given and with the index raised by
    ``n_error``. A phase that all sizes share moves nothing but the wave's origin, so it is taken out of each
    polarisation before the rms; sizes count by the light that they let through.

    Args:
        library: its unit cell says which cells, and how certain the index is.
        executor: where the cells are solved; this process when None.
        samples: how many sizes.

    Returns:
        rad rms; 0 where ``n_error`` is 0.
    """
    from scipy.stats import qmc  # Half a second, which a run that finds all up to date does not spend.

    unit_cell = library.unit_cell
    n_error = unit_cell.materials.pillar.n_error
    if n_error == 0.0:
        return 0.0
    sweep = unit_cell.sweep
    low, high = np.array([sweep.width_nm, sweep.length_nm]).T
    sizes = low + (high - low) * qmc.Halton(2, scramble=False).random(samples)
    if not library.known.all():  # circles
        sizes[:, 1] = sizes[:, 0]
    cells = [pillar_cell(unit_cell, float(width), float(length)) for width, length in sizes]
    raised = [replace(cell, n_pillar=cell.n_pillar + n_error) for cell in cells]
    # The library's own target: what the truncation leaves is common to both and drops out of the difference.
    solver = partial(_solve, CellNumerics(sweep.target_error))
    answers = list(in_order(executor or SerialExecutor(), solver, [*cells, *raised]))
    before, after = (np.array([np.diagonal(a.t) for a in part]) for part in (answers[:samples], answers[samples:]))
    return _phase_rms_rad(before, after)


def _solve(numerics: CellNumerics, cell: PillarCell) -> CellResponse:
    return solve(cell, numerics)


def _phase_rms_rad(before: ComplexArray, after: ComplexArray) -> float:
    """Rms of the phase from ``before`` to ``after`` (n, 2), each polarisation's common phase taken out."""
    turn = after * before.conj()
    turn *= np.exp(-1j * np.angle(turn.sum(axis=0)))
    weight = np.abs(before) ** 2
    return float(np.sqrt(np.sum(weight * np.angle(turn) ** 2) / np.sum(weight)))
