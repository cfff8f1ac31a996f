"""Orders of a mask whose pattern repeats: its supercells, found among the written pillars, by full wave.

A deflector, a splitter or a grating repeats after some pillars, exactly or nearly: a phase that turns once in 13.1
pillars has equal sizes after 13, or the next ones of the grid. The repeat is found in the autocorrelation of the
library's t of the pillars. Windows of one repeat, spread over the mask, are solved as periodic supercells; their mean
is the efficiency of each order far from the rim, their spread is part of its error. All windows are solved at a coarse
resolution, and as many of them at a fine one as the mean change between the two needs: it differs little from window to
window, whereas the fine resolution takes four times as long.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from metafab.cell.curved.supercell import count_functions
from metafab.cell.elements.basis import basis_of
from metafab.cell.elements.solve import orders_at
from metafab.cell.pillar import PillarCell
from metafab.cell.supercell import IntArray, Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import OrderFigures, OrdersFigures
from metafab.core.parallel.executor import SerialExecutor, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.fullwave.written import library_responses, site_cell, sizes_at
from metafab.layout import PillarMap
from metafab.library import Library

#: Side of the blocks in which a repeat is looked for, and the longest repeat, sites. Shifts of up to half of a block
#: are compared.
_BLOCK_SITES, _LONGEST_SITES = 128, 40
#: Least correlation of a block with itself, up to a phase, shifted by a repeat or a multiple of it: snapping to sizes
#: takes 0.01 to 0.1. Largest phase after a repeat, turns: the seam of a periodic window loses 1 - sinc^2 = 0.8 % there.
_ALIKE, _TURNED = 0.85, 0.05
#: Most windows along an axis that are compared, and most windows that are solved.
_PLACES, _WINDOWS = 8, 8
#: Windows that are first solved at the fine resolution. More follow in pairs until the standard error of the mean
#: change is at most this share of the bound on the error that follows from the change.
_FINE_WINDOWS, _KNOWN = 3, 0.5
#: Processor time that the solutions may take in a run; seconds per cubed number of functions, measured on a slow core.
_LIMIT_S, _PER_CUBE_S = 60.0, 2.5e-9
#: Ascending polynomial orders of rectangles and of curved outlines.
_RESOLUTIONS, _CURVED_RESOLUTIONS = (2.0, 3.0), (3.0, 4.0)
#: Bound on the error of an efficiency over its last change, of rectangles and of curved outlines. On windows of 13
#: silicon pillars, orders 3 and 4 differed by up to 0.13 of the change from 2 to 3.
_SHARE, _SHARE_CURVED = 0.5, 2.0
#: Least bound on that error, times the squared order.
_FLOOR = 0.01
#: Smallest efficiency of an unwanted order that is listed; share of the brightest from which the library's orders are
#: wanted.
_LISTED, _WANTED = 0.03, 0.5


def measure_orders(
    pillars: PillarMap,
    library: Library,
    *,
    limit_s: float = _LIMIT_S,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> OrdersFigures:
    """Efficiency of the orders of a mask by full wave and by its library, or the reason why they were not solved.

    ``limit_s`` is the processor time that the solutions may take.
    """
    try:
        cell = site_cell(library)
        blocks = [library_responses(Supercell(cell, sizes), library) for sizes in _blocks(pillars)]
        repeat = [repeat_sites(blocks, axis) for axis in (0, 1)]
        if 0 in repeat:
            axes = " and ".join("yx"[axis] for axis in (1, 0) if repeat[axis] == 0)
            return OrdersFigures(reason=f"the pillars do not repeat within {_LONGEST_SITES} sites along {axes}")
        windows = _windows(pillars, (repeat[0], repeat[1]))
        supercells = [Supercell(cell, sizes) for sizes in windows.sizes_nm]
        seconds = _seconds(supercells[0])
    except InputError as error:
        return OrdersFigures(reason=str(error.faults[0]))
    shape = f"{repeat[1]} x {repeat[0]} pillars"
    if (count := min(len(supercells), int(limit_s / seconds))) < min(len(supercells), 2):
        text = f"each repeat of {shape} takes about {seconds / 60.0:.2g} min of processor time"
        return OrdersFigures(reason=f"{text}; `metafab coupling` solves single rows")
    chosen = np.unique(np.linspace(0, len(supercells) - 1, count).round().astype(int))
    supercells, weight = [supercells[i] for i in chosen], windows.weight[chosen]
    found = solve_windows(supercells, weight, executor or SerialExecutor(), progress)
    drift = tuple(_drift(blocks, axis, repeat[axis]) for axis in (1, 0))
    unsolved = 1.0 - (1.0 - windows.unseen) * len(chosen) / len(windows.sizes_nm)
    return _figures(supercells, weight, found, library, drift, unsolved)


def _blocks(pillars: PillarMap) -> Iterator[FloatArray]:
    """Sizes of the middle of the lattice and of the middles of its quarters, nm, shape (n_y, n_x, 2) each."""
    n_y, n_x = pillars.lattice.shape
    side = min(_BLOCK_SITES, n_y), min(_BLOCK_SITES, n_x)
    middles = {(n_y // 2, n_x // 2)}
    if max(n_y, n_x) > _BLOCK_SITES:
        middles |= {(round(n_y * v), round(n_x * u)) for v in (0.3, 0.7) for u in (0.3, 0.7)}
    for y, x in sorted(middles):
        yield sizes_at(pillars, max(y - side[0] // 2, 0), max(x - side[1] // 2, 0), side)


def _correlation(t: ComplexArray, axis: int, shift: int) -> complex:
    """Correlation of the responses of sites, shape (n_y, n_x), with those ``shift`` sites on along an axis."""
    along = np.moveaxis(t, axis, 0)
    here, there = along[: len(along) - shift], along[shift:]
    both = (here != 0.0) & (there != 0.0)  # beyond the aperture there are none
    norm = float(np.linalg.norm(here[both]) * np.linalg.norm(there[both]))
    return complex(np.vdot(here[both], there[both])) / norm if norm else 0.0


def repeat_sites(blocks: Sequence[ComplexArray], axis: int) -> int:
    """Sites after which all blocks, shape (2, n_y, n_x), and both polarisations repeat along an axis; 0 if none do."""
    reach = min(block.shape[1 + axis] for block in blocks) // 2
    shifts = range(reach + 1)
    found = np.array([[_correlation(t, axis, shift) for shift in shifts] for block in blocks for t in block])
    alike, turned = np.abs(found).min(axis=0) >= _ALIKE, np.abs(np.angle(found)).max(axis=0) / (2.0 * math.pi)
    near = alike & (turned <= _TURNED)
    if near.all():
        return 1
    # Equal neighbours of a slow phase are no repeat of it.
    for sites in range(int(np.argmin(near)), min(reach, _LONGEST_SITES) + 1):
        if near[sites] and alike[sites::sites].all() and turned[sites] == turned[sites - 1 : sites + 2].min():
            return sites
    return 0


def _drift(blocks: Sequence[ComplexArray], axis: int, sites: int) -> tuple[float, ...]:
    """Turns of the phase after a repeat, beyond whole ones, of x and of y polarised light."""
    return tuple(
        float(np.angle(sum(_correlation(block[p], axis, sites) for block in blocks))) / (2.0 * math.pi) for p in (0, 1)
    )


@dataclass(frozen=True)
class _Windows:
    """Distinct windows of one repeat."""

    sizes_nm: list[FloatArray]  #: Shape (n_y, n_x, 2) each.
    weight: FloatArray  #: Shape (n,), number of compared windows that are equal up to a shift.
    unseen: float  #: Share of the mask that no compared window covers.


def _windows(pillars: PillarMap, shape: tuple[int, int]) -> _Windows:
    """Windows of one repeat, spread evenly over the mask, of the largest number of pillars; InputError for none."""
    counts = [total // sites for total, sites in zip(pillars.lattice.shape, shape, strict=True)]
    first = [(total - n * sites) // 2 for total, n, sites in zip(pillars.lattice.shape, counts, shape, strict=True)]
    places = [np.unique(np.linspace(0, n - 1, min(n, _PLACES)).round().astype(int)) for n in counts]
    found = np.array(
        [
            [sizes_at(pillars, first[0] + j * shape[0], first[1] + i * shape[1], shape) for i in places[1]]
            for j in places[0]
        ]
    )
    # Share of the sites seen along each axis: all of them if the compared windows do not change along it.
    seen = [
        n * sites / total if n == len(at) else (1.0 if np.all(found == found.take([0], axis)) else len(at) / n)
        for axis, (n, sites, total, at) in enumerate(zip(counts, shape, pillars.lattice.shape, places, strict=True))
    ]
    flat = found.reshape(-1, *shape, 2)
    pillars_of = np.count_nonzero(flat[..., 0], axis=(1, 2))
    alike: dict[bytes, list[FloatArray]] = {}
    for sizes in flat[pillars_of == pillars_of.max()]:
        rolled = (np.roll(sizes, (j, i), axis=(0, 1)) for j in range(shape[0]) for i in range(shape[1]))
        alike.setdefault(min(each.tobytes() for each in rolled), []).append(sizes)
    groups = list(alike.values())
    chosen = np.unique(np.linspace(0, len(groups) - 1, min(len(groups), _WINDOWS)).round().astype(int))
    exact = len(groups) == 1
    unseen = 0.0 if exact else 1.0 - seen[0] * seen[1] * len(chosen) / len(groups)
    return _Windows([groups[i][0] for i in chosen], np.array([len(groups[i]) for i in chosen], float), unseen)


def _resolutions(cell: PillarCell) -> tuple[float, float]:
    return _CURVED_RESOLUTIONS if cell.is_shaped else _RESOLUTIONS


def _seconds(supercell: Supercell) -> float:
    """Estimated processor time of a supercell."""
    turned = supercell.exchanged() if supercell.shape[1] == 1 else supercell
    lights = POLARISATIONS if 1 in supercell.shape else POLARISATIONS[:1]
    cubes = 0.0
    for resolution in _resolutions(supercell.cell):
        for light in lights:
            curved = supercell.cell.is_shaped
            count = count_functions(turned, resolution) if curved else basis_of(turned, light, resolution).sizes[0]
            cubes += float(count) ** 3
    return cubes * _PER_CUBE_S


@dataclass(frozen=True)
class SolvedWindows:
    """Windows at the coarse resolution, and some of them at the fine one."""

    coarse: FloatArray  #: Efficiencies, shape (n_windows, 2, n_orders).
    fine: IntArray  #: Indices of the windows that were solved at the fine resolution, shape (n_fine,).
    t: ComplexArray  #: Their amplitudes, shape (n_fine, n_orders, out, in).
    change: FloatArray  #: Efficiencies of these windows less the coarse ones, shape (n_fine, 2, n_orders).


def solve_windows(
    supercells: Sequence[Supercell], weight: FloatArray, executor: Executor, progress: Progress
) -> SolvedWindows:
    """Solve all windows at the coarse resolution, and at the fine one until the mean change is known.

    ``weight``: shape (n_windows,), weight of each window in the mean.
    """
    (low, high), count, cell = _resolutions(supercells[0].cell), len(supercells), supercells[0].cell
    coarse = []
    for done, (_, efficiency) in enumerate(in_order(executor, solve_window, [(each, low) for each in supercells]), 1):
        coarse.append(efficiency)
        progress("supercells", done, count)
    # Both ends of the mask and its middle come first.
    order = list(dict.fromkeys([0, count - 1, count // 2, *range(count)]))
    t: list[ComplexArray] = []
    change: list[FloatArray] = []
    fine = 0
    while fine < count:
        step = order[fine : (fine + 2 if fine else _FINE_WINDOWS)]
        for i, (amplitude, efficiency) in zip(
            step, in_order(executor, solve_window, [(supercells[i], high) for i in step]), strict=True
        ):
            t.append(amplitude)
            change.append(efficiency - coarse[i])
            fine += 1
            progress("supercells, finer", fine, count)
        solved = SolvedWindows(np.array(coarse), np.array(order[:fine]), np.array(t), np.array(change))
        _, error, truncation = mean_change(solved, weight, cell)
        if np.all(error <= _KNOWN * truncation):
            break
    return solved


def solve_window(work: tuple[Supercell, float]) -> tuple[ComplexArray, FloatArray]:
    """Amplitudes at a resolution, shape (n_orders, out, in), and efficiencies, shape (2, n_orders)."""
    supercell, resolution = work
    t = orders_at(supercell, POLARISATIONS, resolution)
    return t, _efficiency(supercell, supercell.propagating_orders("x"), t)


def _mean(values: FloatArray, weight: FloatArray, unsolved: float) -> tuple[FloatArray, FloatArray]:
    """Weighted mean over windows, axis 0, and its standard error where a share of the windows is not solved."""
    share = weight / weight.sum()
    mean = np.tensordot(share, values, axes=1)
    variance = np.tensordot(share, (values - mean) ** 2, axes=1)
    return mean, np.sqrt(variance * unsolved / max(len(values) - 1, 1))


def mean_change(
    found: SolvedWindows, weight: FloatArray, cell: PillarCell
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean change, its standard error, and the bound on the error of fine efficiencies; shape (2, n_orders) each."""
    of_fine = weight[found.fine]
    mean, error = _mean(found.change, of_fine, 1.0 - len(found.fine) / len(weight))
    size, _ = _mean(np.abs(found.change), of_fine, 0.0)
    part = _SHARE_CURVED if cell.is_shaped else _SHARE
    return mean, error, part * size + _FLOOR / _resolutions(cell)[-1] ** 2


def _efficiency(supercell: Supercell, order: IntArray, t: ComplexArray) -> FloatArray:
    """Power of the orders over the incident power, shape (2, n_orders)."""
    return np.array([supercell.relative_power(order, t[:, :, p], light) for p, light in enumerate(POLARISATIONS)])


def _figures(
    supercells: Sequence[Supercell],
    weight: FloatArray,
    found: SolvedWindows,
    library: Library,
    drift: Sequence[Sequence[float]],
    unsolved: float,
) -> OrdersFigures:
    """Weighted means over the windows; ``drift`` are turns after a repeat, along x and y, of both polarisations."""
    one = supercells[0]
    order = one.propagating_orders("x")
    lone = []
    for supercell in supercells:
        t = np.zeros((len(order), 2, 2), dtype=np.complex128)
        for p, responses in enumerate(library_responses(supercell, library)):
            t[:, p, p] = supercell.local_period(order, responses)
        lone.append(t)
    of_fine = np.array(lone)[found.fine]
    field_error = np.linalg.norm(found.t - of_fine) / np.linalg.norm(of_fine)
    # As in the PSFs, a site carries the flux |t|^2 n_out / n_in of its lattice into the direction of the order.
    carried = np.array([n_out.real / n_in.real for n_out, n_in in zip(one.cell.n_out, one.cell.n_in, strict=True)])
    by_library = np.einsum("w,wopp->po", weight / weight.sum(), np.abs(lone) ** 2) * carried[:, None]
    change, change_error, truncation = mean_change(found, weight, one.cell)
    mean, spread = _mean(found.coarse, weight, unsolved)
    mean += change
    seam = 1.0 - np.prod(np.sinc(np.array(drift)) ** 2, axis=0)
    numerical = truncation + change_error
    rows = []
    for p, light in enumerate(POLARISATIONS):
        turns = order + np.array([drift[0][p], drift[1][p]])
        sines = turns * one.cell.wavelength_nm / (1e3 * np.array(one.period_um) * one.cell.n_out[p].real)
        wanted = by_library[p] >= _WANTED * by_library[p].max()
        for i in np.argsort(-mean[p]):
            if max(mean[p, i], by_library[p, i]) < _LISTED and not wanted[i]:
                continue
            along = np.degrees(np.arcsin(np.clip(sines[i], -1.0, 1.0)))
            rows.append(
                OrderFigures(
                    polarisation=light,
                    order=(int(order[i, 0]), int(order[i, 1])),
                    angle_x_deg=float(along[0]),
                    angle_y_deg=float(along[1]),
                    efficiency=float(mean[p, i]),
                    library_efficiency=float(by_library[p, i]),
                    error=float(numerical[p, i] + spread[p, i] + seam[p] * mean[p, i]),
                    wanted=bool(wanted[i]),
                )
            )
    n_y, n_x = one.shape
    return OrdersFigures(
        sites=(n_x, n_y), windows=len(supercells), orders=tuple(rows), coupling_error=float(field_error)
    )
