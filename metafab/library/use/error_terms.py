"""Error of a library's light by the uncertainty of the pillar's index."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.forked import shared
from metafab.library.library import Library

#: Sizes solved with both indices; an rms needs fewer than a maximum.
SAMPLES = 16


def index_phase_error_rad(library: Library, *, samples: int = SAMPLES, workers: int | None = None) -> float | None:
    """Return the rms phase error (rad) by the standard uncertainty ``n_error`` of the pillar's index.

    None where ``n_error`` is 0, which means that it is not stated.

    ``samples`` sizes, spread evenly over the sweep, are solved with the index as given and with the index raised by
    ``n_error``, by ``workers`` processes, None for all cores; see :func:`phase_rms_rad`.
    """
    unit_cell = library.unit_cell
    n_error = unit_cell.materials.pillar.n_error
    if n_error == 0.0:
        return None
    sweep = unit_cell.sweep
    low, high = np.array([sweep.width_nm, sweep.length_nm]).T
    sizes = low + (high - low) * halton(samples)
    if not library.known.all():  # circles
        sizes[:, 1] = sizes[:, 0]
    cells = [pillar_cell(unit_cell, float(width), float(length)) for width, length in sizes]
    raised = [replace(cell, n_pillar=cell.n_pillar + n_error) for cell in cells]
    # The library's target suffices: the truncation error is common to both solutions and cancels.
    numerics = CellNumerics(target_error=sweep.target_error)
    t = np.array(list(shared(lambda cell: np.diagonal(solve(cell, numerics).t), [*cells, *raised], workers)))
    return phase_rms_rad(t[:samples], t[samples:])


def halton(count: int) -> FloatArray:
    """First points of the Halton sequence of bases 2 and 3 in the unit square, shape (count, 2); the first is 0."""
    points = np.zeros((count, 2))
    for axis, base in enumerate((2, 3)):
        left, digit = np.arange(count), 1.0 / base
        while left.any():
            left, digits = np.divmod(left, base)
            points[:, axis] += digit * digits
            digit /= base
    return points


def phase_rms_rad(before: ComplexArray, after: ComplexArray) -> float:
    """Return the rms phase change of amplitudes, without the common phase of each polarisation; shape (n, 2) each.

    A phase that all sizes share only moves the wave's origin. Sizes are weighted by their transmission ``|before|^2``.
    """
    turn = after * before.conj()
    turn *= np.exp(-1j * np.angle(turn.sum(axis=0)))
    weight = np.abs(before) ** 2
    return float(np.sqrt(np.sum(weight * np.angle(turn) ** 2) / np.sum(weight)))
