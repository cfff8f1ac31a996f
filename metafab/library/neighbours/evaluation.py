"""Field of pillars among their neighbours by the library's chains of coupled modes: rows, and blocks of sites.

In a block every row along x and every row along y is a closed chain. The field of a site is the library's plus the
correction by its row and the correction by its column. The joint effect of both, cross-polarised light included, is
solved in small blocks (:mod:`metafab.library.neighbours.blocks.joint`). In larger ones the chains are coupled to the
next ones, and to those of the other polarisation, where the library holds their couplings. What is left of the joint
effect enters the stated error.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metafab.cell import pillar_cell
from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.core.errors import InputError, SolverError
from metafab.library.neighbours.blocks.cross import CrossLight
from metafab.library.neighbours.blocks.joint import has_joint_effect, joint_effect
from metafab.library.neighbours.blocks.lattice import SolvedLines
from metafab.library.neighbours.doubt import RowDoubts
from metafab.library.neighbours.line import IntArray
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.neighbours.solve import line_corrections

if TYPE_CHECKING:
    from metafab.library.library import Library

#: Error of a block over the product of the rms steps of t from site to site along x and along y, each relative to t:
#: the joint effect of rows and columns, and cross-polarised light, need steps in both directions. Measured by spectral
#: elements, with rows and columns solved exactly, on both lights of 21 blocks: at most 0.75 on eight of 3 x 3 as in a
#: lens and on twelve of 2 x 2 and 3 x 3 random pillars, 0.3 and 1.6 on one of 4 x 4 as in a lens.
_BLOCK_SHARE = 2.0
#: Error of a solved joint effect over its norm. On both lights of ten windows of a lens and of two blocks of random
#: sizes, 3 x 3 to 7 x 7 pillars against fine elements: 0.05 to 0.24; 0.06 to 0.28 with gaps and pillars of order three,
#: and 0.75 of a small one. Unsymmetric blocks of 7 x 7, which have that order, were not compared.
_JOINT_SHARE = 0.5
#: Largest block, in sites, whose lines are coupled: 20 x 20 sites take 4 s, 40 x 40 would take 22 s and 0.9 GB.
_MOST_COUPLED_SITES = 400


def solve_supercell(library: Library, supercell: Supercell) -> SupercellOrders:
    """Transmitted orders of a supercell by the library's model of neighbours.

    Amplitudes of both incident polarisations; cross-polarised light in small blocks, and in larger ones where the
    library holds their couplings.
    InputError if the library holds no such model, or a site has no pillar or one outside its sizes.
    """
    start = time.perf_counter()
    neighbours = require_neighbours(library)
    _require_known_sizes(library, supercell.size_nm)
    known = library.surface(supercell.size_nm[..., 0], supercell.size_nm[..., 1])
    local = np.stack([known.t_xx, known.t_yy])
    order = supercell.propagating_orders("x")
    joint = None
    if has_joint_effect(supercell):
        neighbours, joint = neighbours.uncoupled, joint_effect(supercell, local)
    lights = _solve_lines(neighbours, supercell, order, local, joint)
    # The model does not conserve energy: amplitudes are scaled down where more light would leave than arrives, of x or
    # y polarised light, or of any other.
    t = np.stack([light.amplitude / math.sqrt(max(1.0, light.power)) for light in lights], axis=2)
    scale = 1.0 / math.sqrt(max(1.0, largest_power(supercell, order, t)))
    library_error = float(np.max(known.error))
    errors = [
        _error(neighbours, library_error, supercell, axis, local[axis], light, joint)
        for axis, light in enumerate(lights)
    ]
    weights = [float(np.sum(np.abs(light.amplitude) ** 2)) for light in lights]
    error = _weighted_rms(errors, weights) + (1.0 - scale)
    return SupercellOrders(supercell, order, scale * t, error, time.perf_counter() - start)


def joint_share(library: Library, size_nm: FloatArray) -> FloatArray | None:
    """Joint effect of the rows and columns of a small block, cross-polarised light included, over its field.

    Shape (2,), for x and y polarised light; None where it is not solved, or cannot be. ``size_nm`` is (width, length),
    shape (n_y, n_x, 2). InputError as :func:`solve_supercell`.
    """
    if any(not np.ptp(size_nm, axis=axis).any() for axis in (0, 1)):
        return np.zeros(len(POLARISATIONS))
    neighbours, supercell = require_neighbours(library), Supercell(pillar_cell(library.unit_cell, 0.0, 0.0), size_nm)
    if not has_joint_effect(supercell) or not library.is_continuous:
        return None
    _require_known_sizes(library, size_nm)
    known = library.surface(size_nm[..., 0], size_nm[..., 1])
    local = np.stack([known.t_xx, known.t_yy])
    try:
        joint = joint_effect(supercell, local)
    except SolverError:
        return None
    lights = _solve_lines(neighbours.uncoupled, supercell, supercell.propagating_orders("x"), local, joint)
    shares = [np.linalg.norm(joint[:, :, k]) / np.linalg.norm(light.amplitude) for k, light in enumerate(lights)]
    return np.array(shares)


def _require_known_sizes(library: Library, size_nm: FloatArray) -> None:
    """Refuse sizes that the library does not hold, and empty sites."""
    for axis, (name, grid) in enumerate((("width_nm", library.width_nm), ("length_nm", library.length_nm))):
        low, high = float(size_nm[..., axis].min()), float(size_nm[..., axis].max())
        if low < grid[0] - 1e-6 or high > grid[-1] + 1e-6:
            expected = f"{grid[0]:g} to {grid[-1]:g} nm, the sizes of the model of neighbours"
            raise InputError.single(
                "supercell", name, expected, f"{low:g} to {high:g} nm", "use the solver rcwa or meep"
            )


def largest_power(supercell: Supercell, order: IntArray, t: ComplexArray) -> float:
    """Power of all orders over the incident one, for the incident polarisation that makes it largest.

    ``t``, shape (orders, 2, 2), is indexed [order, out, in]. Where x and y polarised light each carry no more than
    arrives, light between them may: its power holds products of both fields.
    """
    jones = (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 1.0j)
    of_x, of_y, of_sum, of_turning = (float(supercell.relative_power(order, t @ light, "x").sum()) for light in jones)
    both = of_x + of_y
    # Largest eigenvalue of the Hermitian matrix of the power, whose outer elements follow from the two sums.
    return 0.5 * (both + math.hypot(of_x - of_y, of_sum - both, of_turning - both))


@dataclass(frozen=True)
class _Light:
    """Light of a block for one incident polarisation."""

    corrections: ComplexArray  #: Shape (2, n_y, n_x), of the field of the sites by its rows and by its columns.
    amplitude: ComplexArray  #: Shape (orders, 2), E_x and E_y of each order.
    power: float  #: Of all orders, over that of the incident light.


def _solve_lines(
    neighbours: Neighbours, supercell: Supercell, order: IntArray, local: ComplexArray, joint: ComplexArray | None
) -> list[_Light]:
    """Light of a block by its rows and columns, coupled where the model holds their couplings, for x and y.

    ``local`` are t_xx and t_yy of the pillars among equal ones, shape (2, n_y, n_x); ``joint`` is the joint effect of
    rows and columns, shape (orders, 2, 2), where it is solved.
    """
    corrected = [_corrected(neighbours, supercell.size_nm, axis) for axis in range(len(POLARISATIONS))]
    cross = np.zeros_like(local)
    if neighbours.cross is not None and all(len(coupled) == 2 for _, coupled in corrected):
        cross = CrossLight(neighbours, [coupled for _, coupled in corrected]).field(neighbours.cross)

    def light(axis: int, corrections: ComplexArray, cross: ComplexArray) -> _Light:
        amplitude = np.zeros((len(order), 2), dtype=np.complex128) if joint is None else joint[:, :, axis].copy()
        amplitude[:, axis] += supercell.local_period(order, local[axis] + corrections.sum(axis=0))
        amplitude[:, 1 - axis] += supercell.local_period(order, cross)
        power = supercell.relative_power(order, amplitude, POLARISATIONS[axis])
        return _Light(corrections, amplitude, float(np.sum(power)))

    lights = []
    for axis, (corrections, coupled) in enumerate(corrected):
        found = light(axis, corrections, cross[axis])
        if coupled and found.power > 1.0:
            # A resonance of coupled lines that sends out more light than arrives is false: lines without coupling.
            alone = block_corrections(neighbours.uncoupled, supercell.size_nm, axis)
            found = light(axis, alone, np.zeros_like(cross[axis]))
        lights.append(found)
    return lights


def _error(
    neighbours: Neighbours,
    library_error: float,
    supercell: Supercell,
    axis: int,
    local: ComplexArray,
    light: _Light,
    joint: ComplexArray | None,
) -> float:
    """Stated relative error of a block's light of polarisation ``axis``.

    Sum of the errors of the library, of the scaling to the incident power, of rows, of columns, and of their joint
    effect. ``library_error`` is that of t itself; ``local``, shape (n_y, n_x), is the field among equal pillars.
    """
    norm = float(np.linalg.norm(local))
    error = library_error * math.sqrt(local.size) / norm
    error += max(0.0, 1.0 - 1.0 / math.sqrt(max(1.0, light.power)))
    for direction in (0, 1):
        if supercell.shape[1 - direction] > 1:
            line = neighbours.line(direction, POLARISATIONS[axis])
            error += _stated_error(line, direction, supercell.size_nm, local, light.corrections)
    if joint is not None:
        return error + _JOINT_SHARE * float(np.linalg.norm(joint[:, :, axis]) / np.linalg.norm(light.amplitude))
    if min(supercell.shape) > 1:
        along_x, along_y = (float(np.linalg.norm(local - np.roll(local, 1, side))) / norm for side in (1, 0))
        error += _BLOCK_SHARE * along_x * along_y
    return error


def _weighted_rms(values: list[float], weights: list[float]) -> float:
    """Root of the weighted mean square."""
    return math.sqrt(sum(value**2 * weight for value, weight in zip(values, weights, strict=True)) / sum(weights))


def _stated_error(
    line: TrainedLine, direction: int, size_nm: FloatArray, local: ComplexArray, corrections: ComplexArray
) -> float:
    """Stated error of the rows along x (``direction`` 0) or y (1) of a block, relative rms over all of them."""
    correction = corrections[direction]
    if direction == 1:
        size_nm, local, correction = size_nm.transpose(1, 0, 2)[..., ::-1], local.T, correction.T
    errors = RowDoubts.of(line.model, size_nm, local, correction).stated_errors(line.statistics)
    return float(np.linalg.norm(errors * np.linalg.norm(local, axis=1)) / np.linalg.norm(local))


def require_neighbours(library: Library) -> Neighbours:
    """The library's model of neighbours; InputError if it has none."""
    if library.neighbours is not None:
        return library.neighbours
    remedy = "build the library from a unit cell with a table `[neighbours]`, or use the solver rcwa, meep or lone"
    raise InputError.single(
        f"library {library.inputs_sha256[:12]}",
        "neighbours",
        "a model of neighbours",
        "pillars among equal neighbours only",
        remedy,
    )


def block_corrections(neighbours: Neighbours, size_nm: FloatArray, axis: int) -> ComplexArray:
    """Corrections of the field of a periodic block by its rows along x and by its columns, shape (2, n_y, n_x).

    ``size_nm`` is (width, length), shape (n_y, n_x, 2); ``axis`` is the polarisation, 0 for x and 1 for y.
    """
    return _corrected(neighbours, size_nm, axis)[0]


def _corrected(neighbours: Neighbours, size_nm: FloatArray, axis: int) -> tuple[ComplexArray, list[SolvedLines]]:
    """:func:`block_corrections`, and the lines of each direction that are coupled to the next ones."""
    corrections, coupled = np.zeros((2, *size_nm.shape[:2]), dtype=np.complex128), []
    for direction, lines in enumerate((size_nm, size_nm.transpose(1, 0, 2)[..., ::-1])):
        if lines.shape[1] > 1:
            line = neighbours.line(direction, POLARISATIONS[axis])
            terms = line.model.polynomials(lines)
            if line.coupling is None or len(lines) == 1 or terms[..., 0].size > _MOST_COUPLED_SITES:
                found = line_corrections(line.model, terms)
            else:
                coupled.append(SolvedLines.of(line.model, line.coupling, terms))
                found = coupled[-1].corrections
            corrections[direction] = found if direction == 0 else found.T
    return corrections, coupled
