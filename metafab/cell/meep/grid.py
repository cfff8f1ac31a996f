"""A unit cell on Meep's grid: a family of resolutions that share their coordinates, and one run of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

from metafab.cell.meep.coordinates import Axis, cuboids, lateral_axis
from metafab.cell.meep.protocol import Block, Job
from metafab.cell.response import PillarCell
from metafab.core.conventions import Polarisation

#: Of the vacuum wavelength: absorber, and clearance between source, monitors and pillar.
ABSORBER = 0.5
CLEARANCE = 0.3
#: Pixels between source and near monitor, and between any of these planes and an absorber.
PLANE_NODES = 3
#: Half periods that the coarsest member of a family may have, in pixels.
_FAMILY = range(5, 10)
#: Part of the stability limit that the time step takes.
_STABILITY = 0.95


@dataclass(frozen=True)
class Family:
    """Grids that differ by a whole factor only: member j has 2 j times these numbers of pixels.

    Attributes:
        period: half the pixels a period along (x, y), at j = 1.
        inside: half those of the pillar.
        height: half those of the pillar's height.
    """

    period: tuple[int, int]
    inside: tuple[int, int]
    height: int


@dataclass(frozen=True)
class Plan:
    """A job and what de-embedding needs to know about it.

    Attributes:
        job: for the worker; its monitors are the near plane (incident and reflected light) and the far one.
        near_um: z of the near monitor, from the plane where the light comes in (negative).
        far_um: z of the far monitor, from the pillar's other plane.
        n_in: index of the polarisation on the near side.
        n_out: index of the polarisation on the far side.
    """

    job: Job
    near_um: float
    far_um: float
    n_in: float
    n_out: float


def family(cell: PillarCell) -> Family:
    """The family of grids that must be stretched least.

    The pixel is that of the x period; the y period gets the number of pixels that comes nearest.
    """

    def stretch(count: int, length: float, pixel: float) -> float:
        return abs(math.log(length / (count * pixel))) if length > 0.0 and count > 0 else 0.0

    best: tuple[float, Family] | None = None
    sizes = (cell.width_nm, cell.length_nm)
    for p_x in _FAMILY:
        pixel = cell.period_nm[0] / p_x
        period = (p_x, max(1, round(cell.period_nm[1] / pixel)))
        inside = tuple(
            _split(size, whole, count) for size, whole, count in zip(sizes, cell.period_nm, period, strict=True)
        )
        height = max(1, round(cell.height_nm / pixel))
        worst = max(
            stretch(height, cell.height_nm, pixel),
            *(stretch(i, size, pixel) for i, size in zip(inside, sizes, strict=True)),
            *(
                stretch(p - i, whole - size, pixel)
                for p, i, whole, size in zip(period, inside, cell.period_nm, sizes, strict=True)
            ),
        )
        if best is None or worst < best[0]:
            best = worst, Family(period, (inside[0], inside[1]), height)
    assert best is not None
    return best[1]


def _split(size: float, period: float, count: int) -> int:
    """Pixels of the pillar, of ``count`` a period; a pillar and a gap keep one each."""
    if size <= 0.0:
        return 0
    if size >= period:
        return count
    return min(max(1, round(size / period * count)), count - 1)


def plan(
    cell: PillarCell,
    polarisation: Polarisation,
    grids: Family,
    member: int,
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
        grids: of :func:`family`.
        member: resolution, in multiples of the coarsest.
        decay: see :class:`Job`.
        longest_time: see :class:`Job`.
        shift_nodes: moves both monitors outwards; results must not notice.
    """
    n_x, n_y = (2 * member * count for count in grids.period)
    pixel = cell.period_nm[0] * 1e-3 / n_x
    wavelength, height = cell.wavelength_nm * 1e-3, cell.height_nm * 1e-3
    absorber = math.ceil(ABSORBER * wavelength / pixel)
    clearance = math.ceil(CLEARANCE * wavelength / pixel)
    source = absorber + PLANE_NODES
    near = source + PLANE_NODES
    begin = near + shift_nodes + clearance
    end = begin + 2 * member * grids.height
    far = end + clearance + shift_nodes
    n_z = far + PLANE_NODES + absorber
    n_z += n_z % 2
    sizes = zip(grids.inside, (cell.width_nm, cell.length_nm), cell.period_nm, (n_x, n_y), strict=True)
    x, y = (
        lateral_axis(count, 2 * member * inside, size * 1e-3, period * 1e-3, pixel)
        for inside, size, period, count in sizes
    )
    z = Axis((0, begin, end, n_z), (1.0, height / ((end - begin) * pixel), 1.0), (0, 1, 2))
    axis = 0 if polarisation == "x" else 1
    job = Job(
        pixel_um=pixel,
        n_x=n_x,
        n_y=n_y,
        n_z=n_z,
        absorber_nodes=absorber,
        source_node=source,
        monitor_nodes=(near, far),
        wavelength_um=wavelength,
        polarisation=polarisation,
        components=(polarisation,),
        orders=((0, 0),),
        # Where E_x is stretched by x alone, the wave's flux varies along y, and the other way round.
        weight=tuple((y if polarisation == "x" else x).node_stretch()),
        epsilon_in=permittivity(cell.n_in),
        blocks=_blocks(cell, (x, y, z), pixel, n_z),
        smooth=False,
        mirrors=("x", "y"),
        decay=decay,
        longest_time=longest_time,
        courant=_courant(cell, (x, y, z)),
    )
    return Plan(job, (near - begin) * pixel, (far - end) * pixel, cell.n_in[axis].real, cell.n_out[axis].real)


def _courant(cell: PillarCell, axes: tuple[Axis, Axis, Axis]) -> float:
    """Time step over pixel, at the fastest place of the stretched grid (Taflove and Hagness 2005, Eq. 4.60)."""
    slowest_n = min(n.real for n in (*cell.n_in, *cell.n_out, complex(cell.n_ambient)))
    inverse = sum(1.0 / min(axis.stretch) ** 2 for axis in axes)
    return min(0.5, _STABILITY * slowest_n / math.sqrt(inverse))


def permittivity(n: tuple[complex, complex]) -> tuple[complex, complex, complex]:
    """Permittivity along x, y, z. The zero order does not see eps_z; evanescent orders do, and get the mean."""
    x, y = complex(n[0]) ** 2, complex(n[1]) ** 2
    return x, y, (x + y) / 2.0


def _blocks(cell: PillarCell, axes: tuple[Axis, Axis, Axis], pixel: float, n_z: int) -> tuple[Block, ...]:
    ambient = permittivity((cell.n_ambient, cell.n_ambient))
    pillar = permittivity((cell.n_pillar, cell.n_pillar))
    epsilon: dict[tuple[int, int, int], tuple[complex, ...]] = {}
    for in_x, in_y in product((0, 1), repeat=2):
        epsilon[in_x, in_y, 0] = permittivity(cell.n_in)
        epsilon[in_x, in_y, 1] = pillar if in_x and in_y else ambient
        epsilon[in_x, in_y, 2] = permittivity(cell.n_out)
    return tuple(
        Block(
            (box.low[0] * pixel, box.low[1] * pixel, (box.low[2] - n_z / 2) * pixel),
            (box.high[0] * pixel, box.high[1] * pixel, (box.high[2] - n_z / 2) * pixel),
            box.epsilon,
            box.mu,
        )
        for box in cuboids(axes, epsilon)
    )
