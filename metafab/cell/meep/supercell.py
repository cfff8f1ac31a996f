"""A row of unlike pillars, as on the lens: what the library cannot see, by FDTD.

The library solves every pillar among copies of itself (local-period approximation). Here M pillars stand in one
period of M cells along x; its diffraction orders are compared with those that the pillars' own responses predict.
Both are computed on one grid, with every wall in the same place on it, so that what differs is the coupling.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.meep.deembedding import grid_wavenumber
from metafab.cell.meep.grid import ABSORBER, CLEARANCE, PLANE_NODES, permittivity
from metafab.cell.meep.pool import Pool, own_pool
from metafab.cell.meep.protocol import Block, Job
from metafab.cell.meep.solver import refuse_untreated
from metafab.cell.response import PillarCell
from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError

#: z = 0 lies off the nodes by this part of a pixel, where no face of a pixel meets it.
_OFFSET = 0.25
_COURANT = 0.5
_LONGEST_PERIODS = 1000.0


@dataclass(frozen=True)
class RowResponse:
    """Transmitted orders of a row of pillars, for one polarisation.

    Attributes:
        order: shape (n_orders,), those that propagate behind the pillars, ascending; k_x = 2 pi order / (M period).
        amplitude: shape (n_orders,), E of the polarisation over incident E, planes of the conventions, phases
            from the middle of the row.
        efficiency: shape (n_orders,), transmitted over incident power.
        local_period: shape (n_orders,), the amplitude that the pillars' own responses predict, one sample a pillar.
        tail: largest change of the last extrapolated amplitudes.
    """

    order: FloatArray
    amplitude: ComplexArray
    efficiency: FloatArray
    local_period: ComplexArray
    tail: float

    @property
    def coupling_error(self) -> float:
        """Largest difference in any order between the row and the local-period approximation."""
        return float(np.max(np.abs(self.amplitude - self.local_period)))


def solve_row(
    cell: PillarCell,
    size_nm: Sequence[tuple[float, float]],
    polarisation: Polarisation,
    *,
    pixels_per_period: int = 24,
    decay: float = 1e-3,
    pool: Pool | None = None,
) -> RowResponse:
    """Solve a row of pillars along x, and each distinct one alone.

    Rows along y follow by exchanging x and y: swap each size, the periods and the polarisation.

    Args:
        cell: materials, period and illumination; its own pillar size is not looked at.
        size_nm: (width, length) of each pillar, left to right; (0, 0) for none.
        polarisation: of the incident wave.
        pixels_per_period: even; the pixel is the x period over it, and the y period must hold an even number.
        decay: see :class:`metafab.cell.meep.protocol.Job`.
        pool: workers to use; by default one that lives as long as this process.

    Raises:
        InputError: the cell lies outside what this solver treats, or the grid does not fit.
        MissingToolError: no interpreter has Meep.
        SolverError: a worker failed.
    """
    refuse_untreated(replace(cell, width_nm=0.0, length_nm=0.0))
    n_y = pixels_per_period * cell.period_nm[1] / cell.period_nm[0]
    if pixels_per_period < 8 or pixels_per_period % 2 or abs(n_y - round(n_y)) > 1e-6 or round(n_y) % 2:
        raise InputError.single(
            "meep", "pixels_per_period", "an even number from 8 that also divides the y period", f"{pixels_per_period}"
        )
    if not size_nm:
        raise InputError.single("meep", "size_nm", "at least one pillar", "none")
    workers = own_pool() if pool is None else pool
    orders = _propagating(cell, len(size_nm), polarisation)
    shape = (pixels_per_period, round(n_y))
    amplitude, tail = _orders(workers, cell, size_nm, polarisation, orders, shape, decay)
    alone = {size: _orders(workers, cell, [size], polarisation, [0], shape, decay) for size in dict.fromkeys(size_nm)}
    responses = np.array([alone[size][0][0] for size in size_nm])
    place = (np.arange(len(size_nm)) + 0.5) / len(size_nm) - 0.5
    predicted = np.array([np.mean(responses * np.exp(-2j * np.pi * m * place)) for m in orders])
    return RowResponse(
        order=np.array(orders, dtype=np.float64),
        amplitude=amplitude,
        efficiency=np.abs(amplitude) ** 2 * _flux(cell, len(size_nm), polarisation, orders),
        local_period=predicted,
        tail=max(tail, *(own_tail for _, own_tail in alone.values())),
    )


def _across(cell: PillarCell, count: int, order: int) -> float:
    """k_x of an order, rad/um."""
    return 2.0 * math.pi * order / (count * cell.period_nm[0] * 1e-3)


def _propagating(cell: PillarCell, count: int, polarisation: Polarisation) -> list[int]:
    n_out = cell.n_out[0 if polarisation == "x" else 1].real
    reach = n_out * count * cell.period_nm[0] / cell.wavelength_nm
    highest = math.ceil(reach) - 1
    return list(range(-highest, highest + 1))


def _flux(cell: PillarCell, count: int, polarisation: Polarisation, orders: Sequence[int]) -> FloatArray:
    """Power of each order along z per |E|^2 of the polarisation, over that of the incident wave.

    Orders lie in the xz plane: y polarised ones carry k_z |E_y|^2, x polarised ones k^2 / k_z |E_x|^2, as E_z
    belongs to them.
    """
    axis = 0 if polarisation == "x" else 1
    vacuum = 2.0 * math.pi / (cell.wavelength_nm * 1e-3)
    k_in, k_out = vacuum * cell.n_in[axis].real, vacuum * cell.n_out[axis].real
    k_z = np.array([math.sqrt(k_out**2 - _across(cell, count, m) ** 2) for m in orders])
    return np.asarray((k_out**2 / k_z if polarisation == "x" else k_z) / k_in, dtype=np.float64)


def _orders(
    pool: Pool,
    cell: PillarCell,
    size_nm: Sequence[tuple[float, float]],
    polarisation: Polarisation,
    orders: Sequence[int],
    shape: tuple[int, int],
    decay: float,
) -> tuple[ComplexArray, float]:
    """Amplitudes of transmitted orders in our planes, and the tail."""
    pixel = cell.period_nm[0] * 1e-3 / shape[0]
    wavelength, height = cell.wavelength_nm * 1e-3, cell.height_nm * 1e-3
    absorber, clearance = (math.ceil(part * wavelength / pixel) for part in (ABSORBER, CLEARANCE))
    near = absorber + 2 * PLANE_NODES
    begin = near + clearance + _OFFSET
    far = math.ceil(begin + height / pixel) + clearance
    n_z = far + PLANE_NODES + absorber
    n_z += n_z % 2
    n_x = len(size_nm) * shape[0]
    axis = 0 if polarisation == "x" else 1
    job = Job(
        pixel_um=pixel,
        n_x=n_x,
        n_y=shape[1],
        n_z=n_z,
        absorber_nodes=absorber,
        source_node=absorber + PLANE_NODES,
        monitor_nodes=(near, far),
        wavelength_um=wavelength,
        polarisation=polarisation,
        components=(polarisation,),
        orders=tuple((m, 0) for m in orders),
        weight=(1.0,) * (shape[1] if polarisation == "x" else n_x),
        epsilon_in=permittivity(cell.n_in),
        blocks=_blocks(cell, size_nm, pixel, n_z, begin),
        smooth=True,
        mirrors=("x", "y") if list(size_nm) == list(size_nm)[::-1] else ("y",),
        decay=decay,
        longest_time=_LONGEST_PERIODS * wavelength,
        courant=_COURANT,
    )
    reply = pool.run(job)
    k_in = grid_wavenumber(cell.n_in[axis].real, wavelength, pixel, _COURANT)
    arriving = complex(reply["incident"][0]) * cmath.exp(-1j * k_in * (near - begin) * pixel)
    way = (far - begin) * pixel - height
    back = [
        cmath.exp(
            -1j
            * way
            * grid_wavenumber(cell.n_out[axis].real, wavelength, pixel, _COURANT, _across(cell, len(size_nm), m))
        )
        for m in orders
    ]
    return reply["limit"][1, 0] * np.array(back) / arriving, float(reply["tail"])


def _blocks(
    cell: PillarCell, size_nm: Sequence[tuple[float, float]], pixel: float, n_z: int, begin: float
) -> tuple[Block, ...]:
    """Half spaces and pillars.

    Feet go into the substrate, which then covers them: at their rims Meep's smoothing finds two materials that
    meet in a plane, not three.
    """
    start, height = (begin - n_z / 2) * pixel, cell.height_nm * 1e-3
    end, beyond = start + height, n_z * pixel
    wide = len(size_nm) * cell.period_nm[0] * 1e-3
    deep = cell.period_nm[1] * 1e-3

    def slab(low: float, high: float, n: tuple[complex, complex]) -> Block:
        return Block((-wide, -deep, low), (wide, deep, high), permittivity(n))

    ambient, pillar = (cell.n_ambient, cell.n_ambient), permittivity((cell.n_pillar, cell.n_pillar))
    low, high = (start - height / 2, end) if cell.side == "substrate" else (start, end + height / 2)
    blocks = [slab(start, beyond, ambient)]
    for i, (width, length) in enumerate(size_nm):
        if width > 0.0 and length > 0.0:
            x, half_x, half_y = (i + 0.5 - len(size_nm) / 2) * cell.period_nm[0] * 1e-3, width * 5e-4, length * 5e-4
            blocks.append(Block((x - half_x, -half_y, low), (x + half_x, half_y, high), pillar))
    blocks.append(slab(-beyond, start, cell.n_in) if cell.side == "substrate" else slab(end, beyond, cell.n_out))
    return tuple(blocks)
