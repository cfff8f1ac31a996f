"""A unit cell on Meep's grid: whole pixels a period, generic places for every wall, planes in whole pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.cell.meep.protocol import AxisIndex, Block, Job
from metafab.cell.response import PillarCell
from metafab.core.conventions import Polarisation
from metafab.core.errors import SolverError

#: Of the vacuum wavelength: absorber, source to pillar, pillar to the far monitor and absorber.
_ABSORBER = 0.5
_CLEARANCE = 0.3
#: Pixels between source and near monitor, and between any of these planes and an absorber.
_PLANE_NODES = 3


@dataclass(frozen=True)
class Plan:
    """A job and what de-embedding needs to know about it.

    Attributes:
        job: for the worker; its monitors are the near plane (incident and reflected light) and the far one.
        near_um: z of the near monitor, from the plane where the light comes in (negative).
        far_um: z of the far monitor, from the pillar's other plane.
        n_in: index of the polarisation on the near side; ``n_out`` on the far side.
    """

    job: Job
    near_um: float
    far_um: float
    n_in: float
    n_out: float


def pixels_per_period(cell: PillarCell, resolution_per_um: float) -> tuple[int, int]:
    """Even numbers of square pixels that fill both periods, at least as fine as asked.

    Raises:
        SolverError: no pixel up to twice as fine fits both periods.
    """
    x_um, y_um = (period * 1e-3 for period in cell.period_nm)
    first = 2 * math.ceil(x_um * resolution_per_um / 2 - 1e-9)
    for n_x in range(first, 2 * first + 2, 2):
        n_y = n_x * y_um / x_um
        if abs(n_y - round(n_y)) < 1e-6 and round(n_y) % 2 == 0:
            return n_x, round(n_y)
    raise SolverError(
        f"no square pixel between 1/{first / x_um:.0f} and 1/{2 * first / x_um:.0f} um divides both periods, "
        f"{cell.period_nm[0]:g} and {cell.period_nm[1]:g} nm, into even numbers; solve this cell by rcwa"
    )


def plan(
    cell: PillarCell,
    polarisation: Polarisation,
    shape: tuple[int, int],
    *,
    decay: float,
    longest_time: float,
    shift_nodes: int = 0,
) -> Plan:
    """The FDTD run of one polarisation.

    Light runs along +z whatever its side; z = 0 is where the pillar begins for it.

    Args:
        cell: what to solve.
        polarisation: of the incident wave.
        shape: (n_x, n_y) of :func:`pixels_per_period`.
        decay: see :class:`Job`.
        longest_time: see :class:`Job`.
        shift_nodes: moves both monitors outwards; results must not notice.
    """
    pixel = cell.period_nm[0] * 1e-3 / shape[0]
    wavelength, height = cell.wavelength_nm * 1e-3, cell.height_nm * 1e-3
    absorber = math.ceil(_ABSORBER * wavelength / pixel)
    clearance = math.ceil(_CLEARANCE * wavelength / pixel)
    source = absorber + _PLANE_NODES
    near = source + _PLANE_NODES
    foot = near + shift_nodes + clearance
    origin = foot + _generic_offset(height / pixel)
    far = math.ceil(origin + height / pixel) + clearance + shift_nodes
    n_z = far + _PLANE_NODES + absorber
    n_z += n_z % 2
    axis = 0 if polarisation == "x" else 1
    n_in, n_out = _axes(cell.n_in), _axes(cell.n_out)
    job = Job(
        pixel_um=pixel,
        n_x=shape[0],
        n_y=shape[1],
        n_z=n_z,
        origin_node=origin,
        absorber_nodes=absorber,
        source_node=source,
        monitor_nodes=(near, far),
        wavelength_um=wavelength,
        polarisation=polarisation,
        components=(polarisation,),
        orders=((0, 0),),
        n_in=n_in,
        blocks=_blocks(cell, height, n_z * pixel, n_in, n_out),
        mirrors=True,
        decay=decay,
        longest_time=longest_time,
    )
    return Plan(
        job, (near - origin) * pixel, (far - origin) * pixel - height, cell.n_in[axis].real, cell.n_out[axis].real
    )


def _generic_offset(height_px: float) -> float:
    """Part of a pixel by which z = 0 lies off the nodes, so that neither end of the pillar meets a pixel's face.

    Where a face of a pixel and a wall coincide, round-off decides what Meep's smoothing sees at the pillar's
    rim. Modulo half a pixel the ends lie at 1/4 -+ h/2, never nearer to a face than 1/8.
    """
    remainder = height_px % 0.5
    h = remainder - 0.5 if remainder > 0.25 else remainder
    return 0.25 - h / 2.0


def _axes(n: tuple[complex, complex]) -> AxisIndex:
    """Index along x, y and z. The zero order does not see n_z; evanescent orders do, and get the mean."""
    return (_pair(n[0]), _pair(n[1]), _pair((n[0] + n[1]) / 2.0))


def _pair(n: complex) -> tuple[float, float]:
    return complex(n).real, complex(n).imag


def _blocks(cell: PillarCell, height: float, depth: float, n_in: AxisIndex, n_out: AxisIndex) -> tuple[Block, ...]:
    """Half spaces and pillar.

    The pillar's foot goes into the substrate, which then covers it: wherever a wall ends, Meep's smoothing finds
    two materials that meet in one plane, not three.
    """
    ambient = _axes((cell.n_ambient, cell.n_ambient))
    width, length = cell.width_nm * 1e-3, cell.length_nm * 1e-3
    above = Block((0.0, 0.0, depth / 2.0), (None, None, depth), ambient)
    substrate_in = Block((0.0, 0.0, -depth / 2.0), (None, None, depth), n_in)
    substrate_out = Block((0.0, 0.0, height + depth / 2.0), (None, None, depth), n_out)
    blocks = [above]
    if width > 0.0 and length > 0.0:
        foot = height / 2.0
        z = (-foot, height) if cell.side == "substrate" else (0.0, height + foot)
        # A film has no walls; as large as the cell, its seams cannot show.
        size = tuple(
            None if np.isclose(side, period * 1e-3) else side
            for side, period in zip((width, length), cell.period_nm, strict=True)
        )
        index = _axes((cell.n_pillar, cell.n_pillar))
        blocks.append(Block((0.0, 0.0, sum(z) / 2.0), (size[0], size[1], z[1] - z[0]), index))
    blocks.append(substrate_in if cell.side == "substrate" else substrate_out)
    return tuple(blocks)
