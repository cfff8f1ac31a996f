"""Unlike pillars in one period by FDTD, and each of them alone on the same grid.

The walls of many pillars fit no stretched grid, so that they lie anywhere between the nodes and Meep averages the
pixels that they cross. The error of the grid is common to the supercell and to the lone pillars: their difference is
the coupling between neighbours.
"""

from __future__ import annotations

import cmath
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from metafab.cell.meep.grid import COURANT, Plan, permittivity, smoothed_plan
from metafab.cell.meep.pool import Pool, own_pool
from metafab.cell.meep.protocol import Block, Job
from metafab.cell.meep.shaped import pillar_blocks
from metafab.cell.meep.solver import refuse_untreated, richardson
from metafab.cell.pillar import PillarCell, Slice
from metafab.cell.supercell import IntArray, Supercell, SupercellOrders, SupercellResponse, relative_rms
from metafab.core.conventions import POLARISATIONS, ComplexArray, Polarisation
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent

#: Measured with Meep 1.25 on one core: pixel updates per second (4e7 on small cells), and bytes per pixel.
_UPDATES_PER_S = 3e7
_BYTES_PER_PIXEL = 200.0
#: Optical periods of a run at a decay of 1e-2 to 1e-3.
_USUAL_PERIODS = 75.0
#: Largest number of pixels of a period that a message recommends.
_MOST_PIXELS = 100


@dataclass(frozen=True)
class SupercellSettings:
    """Numerics of a supercell by FDTD."""

    #: Pixels of a site's x period, even and from 8; the y period must hold an even number too.
    pixels_per_period: int = 16
    #: A run ends when its extrapolated orders change by at most this, relative to the incident wave.
    decay: float = 1e-3
    longest_periods: float = 400.0  #: Longest run, in optical periods.


@dataclass(frozen=True)
class Cost:
    """Expected cost of a run on one core."""

    pixels: int  #: Pixels of the simulated part of the supercell.
    seconds: float  #: Time.
    bytes: float  #: Memory.


def estimate(supercell: Supercell, settings: SupercellSettings = SupercellSettings()) -> Cost:
    """Expected cost of :func:`solve_supercell` for one polarisation, lone pillars included.

    InputError if the grid does not fit.
    """
    whole = plan(supercell, "x", settings).job
    alone = [plan(_lone(cell), "x", settings).job for cell in supercell.periodic_cells().values()]
    pixels = [_pixels(job) for job in (whole, *alone)]
    steps = _USUAL_PERIODS * whole.wavelength_um / (COURANT * whole.pixel_um)
    return Cost(round(pixels[0]), sum(pixels) * steps / _UPDATES_PER_S, pixels[0] * _BYTES_PER_PIXEL)


def memory_bytes(supercell: Supercell, settings: SupercellSettings = SupercellSettings()) -> float:
    """Expected memory of a run for one polarisation; InputError if the grid does not fit."""
    return _pixels(plan(supercell, "x", settings).job) * _BYTES_PER_PIXEL


def _pixels(job: Job) -> float:
    """Pixels of the part of a cell that its mirrors leave to simulate."""
    return float(job.n_x * job.n_y * job.n_z / 2 ** len(job.mirrors))


def solve_supercell(
    supercell: Supercell,
    polarisation: Polarisation,
    settings: SupercellSettings = SupercellSettings(),
    pool: Pool | None = None,
    progress: Progress = silent,
) -> SupercellResponse:
    """Solve a supercell at normal incidence, and each distinct pillar alone on the same grid.

    Args:
        polarisation: of the incident wave.
        pool: workers; by default a pool that lives as long as this process.

    Raises:
        InputError: the solver does not treat the cell, or the grid does not fit.
        MissingToolError: no interpreter has Meep.
        SolverError: a worker failed, or the fields did not decay.
    """
    refuse_untreated(replace(supercell.cell, width_nm=0.0, length_nm=0.0))
    start = time.perf_counter()
    workers = own_pool() if pool is None else pool
    order = supercell.propagating_orders(polarisation)
    amplitude, tail = _run(workers, plan(supercell, polarisation, settings, order), progress)
    axis = POLARISATIONS.index(polarisation)
    responses: dict[tuple[float, float], complex] = {}
    alone = supercell.periodic_cells()
    for done, (size, cell) in enumerate(alone.items(), start=1):
        zero_order, lone_tail = _run(workers, plan(_lone(cell), polarisation, settings))
        responses[size], tail = complex(zero_order[0, axis]), max(tail, lone_tail)
        progress("lone pillars", done, len(alone))
    sizes = supercell.size_nm.reshape(-1, 2)
    return SupercellResponse(
        supercell=supercell,
        polarisation=polarisation,
        order=order,
        amplitude=amplitude,
        responses=np.array([responses[float(w), float(length)] for w, length in sizes]).reshape(supercell.shape),
        error=tail,
        seconds=time.perf_counter() - start,
    )


def refined_orders(
    supercell: Supercell,
    pixels_per_period: Sequence[int] = (16, 24),
    decay: float = 1e-3,
    pool: Pool | None = None,
    progress: Progress = silent,
) -> SupercellOrders:
    """Orders of a supercell for both incident polarisations on several grids.

    Where all walls lie on nodes of all grids the result is the limit of the coarsest and the finest grid in h^2.
    Elsewhere it is that of the finest grid: the error then changes with the places of the walls within their pixels,
    and limits are worse (0.11 to 0.43 on a row of three pillars, whose finest grid of 24 pixels was off by 0.09). The
    error is the step from the finest grid to that limit, plus that of the fields' remaining decay.

    ``pixels_per_period`` are two or more grids, ascending, ``decay`` that of :class:`SupercellSettings`. ``pool`` and
    errors as in :func:`solve_supercell`.
    """
    if len(pixels_per_period) < 2 or any(fine <= coarse for coarse, fine in pairwise(pixels_per_period)):
        expected, got = "two or more numbers, ascending", f"{tuple(pixels_per_period)}"
        raise InputError.single("meep", "pixels_per_period", expected, got)
    refuse_untreated(replace(supercell.cell, width_nm=0.0, length_nm=0.0))
    start = time.perf_counter()
    workers = own_pool() if pool is None else pool
    order, tail = supercell.propagating_orders("x"), 0.0
    grids = []
    for pixels in pixels_per_period:
        settings = SupercellSettings(pixels, decay)
        t = np.zeros((len(order), 2, 2), dtype=np.complex128)
        for axis, light in enumerate(POLARISATIONS):
            t[:, :, axis], left = _run(workers, plan(supercell, light, settings, order), progress)
            tail = max(tail, left)
        grids.append(t)
    ends = 1.0 / pixels_per_period[0], 1.0 / pixels_per_period[-1]
    limit = richardson(ends, [grids[0].ravel(), t.ravel()])
    step = relative_rms(limit.value.reshape(t.shape) - t, t)
    on_nodes = all(_walls_on_nodes(supercell, pixels) for pixels in pixels_per_period)
    value = limit.value.reshape(t.shape) if on_nodes else t
    return SupercellOrders(supercell, order, value, step + limit.gain * tail, time.perf_counter() - start)


def _walls_on_nodes(supercell: Supercell, pixels_per_period: int) -> bool:
    """Whether every wall of every pillar lies on a node of the grid; walls of curved outlines do not."""
    if supercell.cell.is_shaped and supercell.cell.shape != "cross":
        return False
    half_pixels = supercell.size_nm * pixels_per_period / (2.0 * supercell.cell.period_nm[0])
    return bool(np.all(np.abs(half_pixels - np.rint(half_pixels)) < 1e-6))


def _lone(cell: PillarCell) -> Supercell:
    return Supercell(cell, np.array([[[cell.width_nm, cell.length_nm]]]))


def _run(pool: Pool, run: Plan, progress: Progress = silent) -> tuple[ComplexArray, float]:
    """Amplitudes of the transmitted orders in the planes of the conventions, shape (n_orders, 2), and the tail."""
    job = run.job
    longest = job.longest_time / job.wavelength_um
    reply = pool.run_to_decay(job, lambda done: progress("supercell by FDTD", done / job.wavelength_um, longest))
    back = np.array([cmath.exp(-1j * k * run.far_um) for k in run.k_out])
    return np.asarray(reply["limit"][1].T * back[:, None] / run.incident_at_pillar(reply["incident"])), float(
        reply["tail"]
    )


def plan(
    supercell: Supercell, polarisation: Polarisation, settings: SupercellSettings, order: IntArray | None = None
) -> Plan:
    """The FDTD run of one polarisation, which records the orders (m, n), shape (n_orders, 2), or only the zero order.

    InputError if the grid does not fit.
    """
    cell = supercell.cell
    per_x = settings.pixels_per_period
    per_y = _pixels_along_y(cell, per_x)
    if per_y is None:
        expected = "an even number from 8 whose pixels also divide the y period, into an even number"
        fitting = [f"{count}" for count in range(8, _MOST_PIXELS + 1, 2) if _pixels_along_y(cell, count)]
        remedy = f"take {', '.join(fitting[:3])}" if fitting else f"none up to {_MOST_PIXELS} does: change a period"
        raise InputError.single("meep", "pixels_per_period", expected, f"{per_x}", remedy)
    order = np.zeros((1, 2), dtype=np.intp) if order is None else order
    pixel = cell.period_nm[0] * 1e-3 / per_x
    return smoothed_plan(
        cell,
        polarisation,
        (supercell.shape[1] * per_x, supercell.shape[0] * per_y),
        pixel,
        cell.height_nm * 1e-3,
        lambda start, beyond: _blocks(supercell, start, beyond),
        components=POLARISATIONS,
        orders=tuple((int(m), int(n)) for m, n in order),
        across=[(float(x), float(y)) for x, y in supercell.wavevectors_per_um(order)],
        mirrors=_mirrors(supercell),
        decay=settings.decay,
        longest_time=settings.longest_periods * cell.wavelength_nm * 1e-3,
    )


def _pixels_along_y(cell: PillarCell, per_x: int) -> int | None:
    """Square pixels of the y period, with ``per_x`` in the x period; None unless both numbers are whole and even."""
    per_y = per_x * cell.period_nm[1] / cell.period_nm[0]
    fits = per_x >= 8 and per_x % 2 == 0 and abs(per_y - round(per_y)) <= 1e-6 and round(per_y) % 2 == 0
    return round(per_y) if fits else None


def _mirrors(supercell: Supercell) -> tuple[Polarisation, ...]:
    """Axes along which the supercell equals its mirror image."""
    sizes = supercell.size_nm
    flipped = (sizes[:, ::-1], sizes[::-1])
    return tuple(name for name, other in zip(POLARISATIONS, flipped, strict=True) if np.array_equal(sizes, other))


def _blocks(supercell: Supercell, start: float, beyond: float) -> tuple[Block, ...]:
    """Half spaces and pillars, which begin at z = ``start``; ``beyond`` lies outside of the cell.

    Pillars continue into the substrate, which then covers their feet: at the rims Meep's smoothing then meets two
    materials and one plane, not three materials.
    """
    cell = supercell.cell
    height = cell.height_nm * 1e-3
    end = start + height
    wide, deep = supercell.period_um

    def slab(low: float, high: float, n: tuple[complex, complex]) -> Block:
        return Block((-wide, -deep, low), (wide, deep, high), permittivity(n))

    span = (start - height / 2, end) if cell.side == "substrate" else (start, end + height / 2)
    blocks = [slab(start, beyond, (cell.n_ambient, cell.n_ambient))]
    rows, columns = supercell.shape
    for row, column in np.argwhere(np.all(supercell.size_nm > 0.0, axis=-1)):
        layer = Slice(cell.height_nm, cell.n_pillar, cell.n_ambient, *supercell.size_nm[row, column].tolist())
        x = (column + 0.5 - columns / 2) * cell.period_nm[0] * 1e-3
        y = (row + 0.5 - rows / 2) * cell.period_nm[1] * 1e-3
        blocks += pillar_blocks(cell, layer, span, (float(x), float(y)))
    blocks.append(slab(-beyond, start, cell.n_in) if cell.side == "substrate" else slab(end, beyond, cell.n_out))
    return tuple(blocks)
