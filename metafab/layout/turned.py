"""Turned pillars: at each site the size and angle whose Jones matrix is nearest to the target, and their outlines."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.layout.gap_rule import largest_sides_nm
from metafab.layout.geometry import lattice_of, tile_sites, whole_dbu
from metafab.layout.outlines import IntArray, Outline, polygon_area
from metafab.layout.pillars import PillarMap
from metafab.library import Library
from metafab.library.use.amplitudes import power_amplitudes, turned_jones
from metafab.phase.jones_target import JonesTarget
from metafab.spec import Design
from metafab.spec.turned import require_turnable

#: Rows of sites that are assigned at a time.
_ROWS = 16
#: Number of trial phases added to the target, and trial amplitudes of it over the library's rms: the library's phases
#: cover the circle unevenly.
_TRIAL_PHASES = 8
_TRIAL_AMPLITUDES = (0.8, 1.0, 1.25, 1.6, 2.0)
#: Sites on which these are tried.
_SAMPLED_SITES = 4000
#: Weight of the entries xx, xy = yx and yy in the Frobenius norm: xy counts twice.
_NORM_WEIGHT = np.array([1.0, math.sqrt(2.0), 1.0])


@dataclass(frozen=True, eq=False)
class TurnedRectangles(Outline):
    """Rectangles turned about the centres of their sites, vertices rounded to the database grid."""

    #: Shape (n_sizes + 1,), counter-clockwise turn of each size index; 0 for index 0, no pillar.
    angle_deg: FloatArray = field(default_factory=lambda: np.zeros(1))

    @property
    def is_rectangle(self) -> bool:
        """False: the sides do not lie along x and y."""
        return False

    def polygons(self, size_dbu: NDArray[np.int64]) -> tuple[IntArray, ...]:
        """Vertices of each size (width, length) about its centre, shapes (n_sizes + 1, 2) and (4, 2) each."""
        return tuple(turned_rectangles(size_dbu, self.angle_deg))

    def area(self, size_dbu: NDArray[np.int32]) -> FloatArray:
        """Area of each polygon, shape (n_sizes + 1,), squared database units, for sizes of shape (n_sizes + 1, 2)."""
        return np.array([polygon_area(polygon) for polygon in turned_rectangles(size_dbu, self.angle_deg)])


def turned_rectangles(size_dbu: NDArray[np.integer[Any]], angle_deg: FloatArray) -> IntArray:
    """Return the vertices of turned rectangles about their centres, rounded to whole database units: shape (n, 4, 2).

    Sizes, shape (n, 2), are width and length; angles, shape (n,), are counter-clockwise, 0 to below 90 degrees.
    Vertices run counter-clockwise from the lowest; of two that are as low, from the left one.
    """
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size_dbu[:, None]
    turn = np.moveaxis(np.array([[cosine, sine], [-sine, cosine]]), -1, 0)
    return np.asarray(np.rint(corners @ turn), dtype=np.int64)


def outline_of(pillars: PillarMap, design: Design) -> Outline:
    """Return the outlines of the sizes of a map: turned rectangles, or the upright shape of the design."""
    if pillars.angle_deg is None:
        return Outline.of(design)
    return TurnedRectangles("rectangle", design.mask.database_unit_nm, angle_deg=pillars.angle_deg)


@dataclass(frozen=True)
class TurnedAssignment:
    """Turned pillars of a lens."""

    pillars: PillarMap  #: The map; its sizes have angles.
    overlap: float  #: |<target, J>|^2 / (<target, target> <J, J>) over all sites, 0 to 1.


def assign_turned(
    target: JonesTarget,
    library: Library,
    design: Design,
    *,
    angles: int = 16,
    size_step_nm: float = 6.0,
    progress: Progress = silent,
) -> TurnedAssignment:
    """Choose the size and the angle of every pillar whose site's centre lies in the aperture.

    Args:
        library: response over width and length.
        design: lattice, aperture and rules. Bounding boxes keep the gap, so that no pair of neighbours is too close.
        angles: angles in half a turn, even, so that both diagonals are among them.
        size_step_nm: step of widths and lengths, rounded up to a multiple of ``sweep.size_grid_nm``.

    Raises:
        InputError: the gap leaves no room for any pillar, or sizes lie off the mask's grid.
    """
    require_turnable(design)
    lattice = lattice_of(design)
    size_dbu, angle_deg = turned_sizes(design, angles, size_step_nm)
    width_nm, length_nm = size_dbu[1:].T * lattice.database_unit_nm
    jones = turned_jones(power_amplitudes(library, width_nm, length_nm), angle_deg[1:]) * _NORM_WEIGHT
    x_um, y_um = lattice.x_um(), lattice.y_um()
    scale = _NORM_WEIGHT * _target_scale(target, x_um, y_um, jones)
    # |target - J|^2 is least where Re<target, J> - |J|^2 / 2 is largest: one matrix product for all sites and sizes.
    table = _real_and_imaginary(jones).T
    penalty = (0.5 * np.sum(np.abs(jones) ** 2, axis=1)).astype(np.float32)
    index = np.zeros(lattice.shape, dtype=np.uint16)
    common = target_power = power = 0.0
    for row in range(0, y_um.size, _ROWS):
        block = slice(row, min(row + _ROWS, y_um.size))
        inside = design.device.encloses(x_um, y_um[block])
        inside &= lattice.carries(np.arange(block.start, block.stop), np.arange(x_um.size))
        wanted = target(x_um, y_um[block])[:, inside].T * scale
        if wanted.size:
            best = np.argmax(_real_and_imaginary(wanted) @ table - penalty, axis=1)
            index[block][inside] = best + 1
            chosen = jones[best]
            common += float(np.sum(wanted.conj() * chosen).real)
            target_power += float(np.sum(np.abs(wanted) ** 2))
            power += float(np.sum(np.abs(chosen) ** 2))
        progress("layout", block.stop, y_um.size)
    pillars = PillarMap.from_array(lattice, size_dbu, index, tile_sites(design), angle_deg)
    return TurnedAssignment(pillars, common**2 / (target_power * power))


def turned_sizes(design: Design, angles: int, size_step_nm: float) -> tuple[NDArray[np.int32], FloatArray]:
    """Return the sizes and angles of turned pillars that keep the rules; index 0 is no pillar.

    There are ``angles`` in half a turn; the step of sizes is rounded up to a multiple of ``sweep.size_grid_nm``. Width
    and length have the shape (n_sizes + 1, 2), database units, angles (n_sizes + 1,), 0 to below 90. InputError as
    :func:`assign_turned`.
    """
    sweep, unit_nm = design.unit_cell.sweep, design.mask.database_unit_nm
    step_nm = math.ceil(size_step_nm / sweep.size_grid_nm - 1e-6) * sweep.size_grid_nm
    sides = [np.arange(smallest, largest + 1e-6, step_nm) for smallest, largest in (sweep.width_nm, sweep.length_nm)]
    # A quarter turn exchanges width and length: angles below it list each pillar once.
    angle_deg = np.arange(angles // 2) * 180.0 / angles
    width, length, angle = (axis.ravel() for axis in np.meshgrid(*sides, angle_deg, indexing="ij"))
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    room_x, room_y = np.array(largest_sides_nm(design)) + 1e-6
    kept = (width * cosine + length * sine <= room_x) & (width * sine + length * cosine <= room_y)
    kept &= np.minimum(width, length) >= design.min_side_nm
    if not kept.any():
        expected, got = "a gap that leaves room for turned pillars", f"{design.rules.min_gap_nm:g} nm"
        raise InputError.single(design.name, "rules.min_gap_nm", expected, got, "make it smaller")
    for side_nm in (sweep.width_nm[0], sweep.length_nm[0], step_nm):
        whole_dbu(side_nm, unit_nm, "sweep", even=True)
    size_dbu = np.rint(np.stack([width, length], axis=1)[kept] / unit_nm).astype(np.int32)
    return np.concatenate([np.zeros((1, 2), dtype=np.int32), size_dbu]), np.append(0.0, angle[kept])


def _target_scale(target: JonesTarget, x_um: FloatArray, y_um: FloatArray, jones: ComplexArray) -> complex:
    """Return the factor (amplitude and phase) by which the target is nearest to the library, from a sample of sites."""
    step = max(1, math.isqrt(x_um.size * y_um.size // _SAMPLED_SITES))
    wanted = target(x_um[::step], y_um[::step]).reshape(3, -1).T * _NORM_WEIGHT
    rms_ratio = math.sqrt(float(np.mean(np.abs(jones) ** 2) / np.mean(np.abs(wanted) ** 2)))
    penalty, largest, best = 0.5 * np.sum(np.abs(jones) ** 2, axis=1), -math.inf, 1.0 + 0.0j
    for amplitude in _TRIAL_AMPLITUDES:
        for turn in range(_TRIAL_PHASES):
            scale = amplitude * rms_ratio * np.exp(2j * np.pi * turn / _TRIAL_PHASES)
            score = (scale * wanted.conj() @ jones.T).real - penalty
            # The light that arrives at the places goes with the square of this overlap.
            overlap = float(abs(np.sum(wanted.conj() * jones[np.argmax(score, axis=1)])))
            if overlap > largest:
                largest, best = overlap, complex(scale.conjugate())
    return best


def _real_and_imaginary(matrices: ComplexArray) -> NDArray[np.float32]:
    """Entries of shape (n, 3) as real numbers, shape (n, 6)."""
    return np.concatenate([matrices.real, matrices.imag], axis=1).astype(np.float32)
