"""A unit cell on Meep's grid: grids of several resolutions on common coordinates, one FDTD run, and its t and r."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from numpy.typing import NDArray

from metafab.cell.meep.protocol import Block, Job
from metafab.cell.meep.stretched_axes import Axis, lateral_axis, stretched_blocks
from metafab.cell.pillar import PillarCell
from metafab.core.conventions import POLARISATIONS, Polarisation

#: Thickness of an absorber, and clearance between source, monitors and pillar, in vacuum wavelengths.
ABSORBER = 0.5
CLEARANCE = 0.3
#: Pixels between source and near monitor, and between any of these planes and an absorber.
PLANE_NODES = 3
#: Tried numbers of pixels in half a period of the coarsest grid.
_HALF_PERIODS = range(5, 10)
#: Time step as a fraction of the Courant limit.
_STABILITY = 0.95
#: Time step over pixel on plain grids, and distance there from a node to where the structure begins, in pixels: the Yee
#: grid has no point at a quarter of a pixel.
COURANT, _OFFSET = 0.5, 0.25


@dataclass(frozen=True)
class Family:
    """Grids whose resolutions are multiples of the coarsest: member j has 2 j times these numbers of pixels."""

    period: tuple[int, int]  #: Half the pixels of a period along (x, y), at j = 1.
    inside: tuple[int, int]  #: Half the pixels of the pillar along (x, y).
    height: int  #: Half the pixels of the pillar's height.


@dataclass(frozen=True)
class Plan:
    """A job, with the distances and wave numbers that de-embedding needs."""

    job: Job  #: FDTD run; its monitors are the near plane (incident and reflected light) and the far one.
    near_um: float  #: z of the near monitor relative to the plane where the pillar begins (negative).
    far_um: float  #: z of the far monitor relative to the plane where the pillar ends.
    k_in: complex  #: Wave number along z of the incident wave on the grid, rad/um.
    k_out: tuple[complex, ...]  #: Wave number along z of each recorded order on the grid, rad/um.

    def incident_at_pillar(self, incident: NDArray[Any]) -> complex:
        """Incident amplitude where the pillar begins; ``incident`` has shape (2,), zero order of the empty run."""
        return complex(incident[0]) * cmath.exp(-1j * self.k_in * self.near_um)

    def amplitudes(self, limit: NDArray[Any], incident: NDArray[Any]) -> tuple[complex, complex]:
        """(t, r) of the zero order, in the planes of the conventions.

        ``limit`` and ``incident``, each of shape (2,), are the zero orders at the near and the far monitor, of the run
        with the structure and of the empty run.
        """
        at_pillar = self.incident_at_pillar(incident)
        t = complex(limit[1]) * cmath.exp(-1j * self.k_out[0] * self.far_um) / at_pillar
        r = (complex(limit[0]) - complex(incident[0])) * cmath.exp(1j * self.k_in * self.near_um) / at_pillar
        return t, r


def grid_wavenumber(
    n: float, wavelength_um: float, pixel_um: float, courant: float, across: tuple[float, float] = (0.0, 0.0)
) -> complex:
    """Wave number along z (rad/um) of a plane wave on the Yee grid; imaginary where it is evanescent.

    The sum of sin^2(k_i dx / 2) / dx^2 over the axes is n^2 sin^2(omega dt / 2) / dt^2 (Taflove and Hagness 2005,
    Eq. 4.5). With the wave numbers of the continuum, results would depend on the positions of the monitors. ``courant``
    is the time step over the grid spacing, ``across`` the wave numbers along x and y.
    """
    total = n / courant * math.sin(math.pi * courant * pixel_um / wavelength_um)
    along = cmath.sqrt(total**2 - sum(math.sin(k * pixel_um / 2.0) ** 2 for k in across))
    return 2.0 / pixel_um * cmath.asin(along)


def permittivity(n: tuple[complex, complex]) -> tuple[complex, complex, complex]:
    """Permittivity along x, y, z. The zero order does not depend on eps_z; evanescent orders get the mean."""
    x, y = complex(n[0]) ** 2, complex(n[1]) ** 2
    return x, y, (x + y) / 2.0


def family(cell: PillarCell) -> Family:
    """The family of grids with the least stretching.

    The pixel is that of the x period; the y period gets the nearest number of pixels.
    """

    def stretch(count: int, length: float, pixel: float) -> float:
        return abs(math.log(length / (count * pixel))) if length > 0.0 and count > 0 else 0.0

    sizes = (cell.width_nm, cell.length_nm)
    grids: list[tuple[float, Family]] = []
    for p_x in _HALF_PERIODS:
        pixel = cell.period_nm[0] / p_x
        period = (p_x, max(1, round(cell.period_nm[1] / pixel)))
        in_x, in_y = map(_split, sizes, cell.period_nm, period)
        height = max(1, round(cell.height_nm / pixel))
        worst = stretch(height, cell.height_nm, pixel)
        for i, p, size, whole in zip((in_x, in_y), period, sizes, cell.period_nm, strict=True):
            worst = max(worst, stretch(i, size, pixel), stretch(p - i, whole - size, pixel))
        grids.append((worst, Family(period, (in_x, in_y), height)))
    return min(grids, key=lambda grid: grid[0])[1]


def _split(size: float, period: float, count: int) -> int:
    """Pixels of the pillar out of ``count`` of a period; a pillar and a gap keep one each."""
    if size <= 0.0:
        return 0
    if size >= period:
        return count
    return min(max(1, round(size / period * count)), count - 1)


def plan(
    cell: PillarCell,
    grids: Family,
    polarisation: Polarisation,
    member: int,
    *,
    decay: float,
    longest_time: float,
    shift_nodes: int = 0,
) -> Plan:
    """FDTD run of one polarisation; light from either half space travels along +z, and the pillar begins at z = 0.

    ``grids`` are of :func:`family`, ``member`` is the resolution in multiples of the coarsest, and both monitors move
    outwards by ``shift_nodes`` pixels; t and r do not depend on it. ``decay`` and ``longest_time``: see :class:`Job`.
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
    in_x, in_y = (2 * member * inside for inside in grids.inside)
    x = lateral_axis(n_x, in_x, cell.width_nm * 1e-3, cell.period_nm[0] * 1e-3, pixel)
    y = lateral_axis(n_y, in_y, cell.length_nm * 1e-3, cell.period_nm[1] * 1e-3, pixel)
    z = Axis((0, begin, end, n_z), (1.0, height / ((end - begin) * pixel), 1.0), (0, 1, 2))
    axis, courant = POLARISATIONS.index(polarisation), _courant(cell, (x, y, z))
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
        # The flux of x polarised light varies with the stretch along y, that of y polarised light along x.
        weight=tuple((y if polarisation == "x" else x).node_stretch()),
        epsilon_in=permittivity(cell.n_in),
        blocks=stretched_blocks((x, y, z), _epsilon(cell), pixel, n_z / 2),
        smooth=False,
        mirrors=("x", "y"),
        decay=decay,
        longest_time=longest_time,
        courant=courant,
    )
    k_in, k_out = (grid_wavenumber(n[axis].real, wavelength, pixel, courant) for n in (cell.n_in, cell.n_out))
    return Plan(job, (near - begin) * pixel, (far - end) * pixel, k_in, (k_out,))


def smoothed_plan(
    cell: PillarCell,
    polarisation: Polarisation,
    pixels: tuple[int, int],
    pixel_um: float,
    height_um: float,
    blocks: Callable[[float, float], tuple[Block, ...]],
    *,
    components: tuple[Polarisation, ...],
    orders: tuple[tuple[int, int], ...] = ((0, 0),),
    across: Sequence[tuple[float, float]] = ((0.0, 0.0),),
    mirrors: tuple[Polarisation, ...] = POLARISATIONS,
    decay: float,
    longest_time: float,
) -> Plan:
    """FDTD run of one polarisation on a plain grid, where Meep averages the pixels that a wall crosses.

    Args:
        cell: half spaces, wavelength and side of incidence.
        polarisation: of the incident wave.
        pixels: pixels of the period along x and y.
        pixel_um: grid spacing.
        height_um: height of the structure.
        blocks: returns the structure for the z at which it begins and a z outside of the cell.
        components: recorded components of E.
        orders: recorded orders.
        across: wave numbers of the orders along x and y, rad/um.
        mirrors: axes along which the structure equals its mirror image.
        decay: see :class:`Job`.
        longest_time: see :class:`Job`.
    """
    wavelength = cell.wavelength_nm * 1e-3
    absorber, clearance = (math.ceil(part * wavelength / pixel_um) for part in (ABSORBER, CLEARANCE))
    near = absorber + 2 * PLANE_NODES
    begin = near + clearance + _OFFSET
    far = math.ceil(begin + height_um / pixel_um) + clearance
    n_z = far + PLANE_NODES + absorber
    n_z += n_z % 2
    axis = POLARISATIONS.index(polarisation)
    job = Job(
        pixel_um=pixel_um,
        n_x=pixels[0],
        n_y=pixels[1],
        n_z=n_z,
        absorber_nodes=absorber,
        source_node=absorber + PLANE_NODES,
        monitor_nodes=(near, far),
        wavelength_um=wavelength,
        polarisation=polarisation,
        components=components,
        orders=orders,
        weight=(1.0,) * pixels[1 - axis],
        epsilon_in=permittivity(cell.n_in),
        blocks=blocks((begin - n_z / 2) * pixel_um, n_z * pixel_um),
        smooth=True,
        mirrors=mirrors,
        decay=decay,
        longest_time=longest_time,
        courant=COURANT,
    )
    n_in, n_out = cell.n_in[axis].real, cell.n_out[axis].real
    k_in = grid_wavenumber(n_in, wavelength, pixel_um, COURANT)
    k_out = tuple(grid_wavenumber(n_out, wavelength, pixel_um, COURANT, each) for each in across)
    return Plan(job, (near - begin) * pixel_um, (far - begin) * pixel_um - height_um, k_in, k_out)


def _courant(cell: PillarCell, axes: tuple[Axis, Axis, Axis]) -> float:
    """Time step over pixel, at the fastest point of the stretched grid (Taflove and Hagness 2005, Eq. 4.60)."""
    lowest_n = min(n.real for n in (*cell.n_in, *cell.n_out, complex(cell.n_ambient)))
    inverse = sum(1.0 / min(axis.stretch) ** 2 for axis in axes)
    return min(0.5, _STABILITY * lowest_n / math.sqrt(inverse))


def _epsilon(cell: PillarCell) -> dict[tuple[int, int, int], tuple[complex, ...]]:
    """Regions along (x, y, z) -> permittivity along x, y and z."""
    ambient, pillar = (permittivity((n, n)) for n in (cell.n_ambient, cell.n_pillar))
    epsilon: dict[tuple[int, int, int], tuple[complex, ...]] = {}
    for in_x, in_y in product((0, 1), repeat=2):
        epsilon[in_x, in_y, 0] = permittivity(cell.n_in)
        epsilon[in_x, in_y, 1] = pillar if in_x and in_y else ambient
        epsilon[in_x, in_y, 2] = permittivity(cell.n_out)
    return epsilon
