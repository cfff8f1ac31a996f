"""Errors of a library's light: of oblique incidence, and of the uncertainty of the pillar's index."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.cell import CellNumerics, PillarCell, pillar_cell, solve
from metafab.cell.rcwa import RcwaDetails, zero_order
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.forked import shared
from metafab.library.library import Library

#: Sizes solved for oblique light, each standing for an equal share of the pillars.
_OBLIQUE_SAMPLES = 8
#: Target error of the solution along the axis. The oblique one has the same truncation, whose error is common to both
#: and cancels. The changes of three draws of sizes were within 0.9 % of those at 8 cosines.
_SOLVER_ERROR = 3e-2
#: Sizes solved with both indices; an rms needs fewer than a maximum.
SAMPLES = 16


def oblique_field_error(
    library: Library,
    size_nm: FloatArray,
    pillars: NDArray[np.integer],
    tangent: tuple[float, float],
    workers: int | None = None,
) -> float | None:
    """Return the relative rms change of a mask's zero-order field under oblique light, without the common phase.

    Args:
        library: its unit cell is solved along the axis and from the side.
        size_nm: shape (n, 2), width and length of each size of the mask.
        pillars: shape (n,), number of pillars of each size.
        tangent: direction of the light (x/z, y/z) before the substrate.
        workers: processes that solve; None for all cores.

    Returns:
        The larger of both polarisations'; None where RCWA is slow at an angle (other outlines than rectangles, sloped
        walls, hexagonal lattices, birefringent substrates), where light comes out of an absorbing medium, and without
        pillars.
    """
    count = np.cumsum(pillars)
    if not count.size or count[-1] == 0:
        return None
    places = np.searchsorted(count, (np.arange(_OBLIQUE_SAMPLES) + 0.5) / _OBLIQUE_SAMPLES * count[-1])
    sizes = [(float(width), float(length)) for width, length in size_nm[places]]
    straight = [pillar_cell(library.unit_cell, *size) for size in sizes]
    n_in, n_substrate = complex(straight[0].n_of_angle), straight[0].n_substrate
    is_slow = any(cell.untreated("", treated=("under, over",)) for cell in straight)
    if is_slow or n_in.imag != 0.0 or n_substrate[0] != n_substrate[1]:
        return None
    slope = math.hypot(*tangent)
    angle_deg = math.degrees(math.asin(slope / math.hypot(1.0, slope) / n_in.real))
    azimuth_deg = math.degrees(math.atan2(tangent[1], tangent[0]))
    oblique = [pillar_cell(library.unit_cell, *size, angle_deg=angle_deg, azimuth_deg=azimuth_deg) for size in sizes]
    t = np.array(list(shared(_transmitted, list(zip(straight, oblique, strict=True)), workers)))
    return _largest_change(t[:, 0], t[:, 1])


def _transmitted(cells: tuple[PillarCell, PillarCell]) -> ComplexArray:
    """Zero-order t_xx and t_yy along the axis and from the side, shape (2, 2)."""
    straight, oblique = cells
    along_axis = solve(straight, CellNumerics(target_error=_SOLVER_ERROR))
    assert isinstance(along_axis.details, RcwaDetails)
    from_side = zero_order(oblique, along_axis.details.orders_x)
    return np.array([np.diagonal(along_axis.t), np.diagonal(from_side.t)])


def _largest_change(before: ComplexArray, after: ComplexArray) -> float:
    """Relative rms change, the larger of both polarisations', without the phase that all share; shape (n, 2) each."""
    common = np.exp(1j * np.angle(np.sum(after * before.conj(), axis=0)))
    changed = np.linalg.norm(after - common * before, axis=0)
    return float(np.max(changed / np.linalg.norm(before, axis=0)))


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
