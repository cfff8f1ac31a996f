"""Field of pillars among their neighbours by the library's chains of coupled modes: rows, and blocks of sites.

In a block every row along x and every row along y is a closed chain. The field of a site is the library's plus the
correction by its row and the correction by its column. The joint effect of both, cross-polarised light included, is
solved in small blocks (:mod:`metafab.library.neighbours.blocks.joint`). In larger ones the chains are coupled to the
next ones, and to those of the other polarisation, where the library holds their couplings. What is left of the joint
effect enters the stated error.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.core.errors import InputError
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
    size_nm = supercell.size_nm
    for axis, (name, grid) in enumerate((("width_nm", library.width_nm), ("length_nm", library.length_nm))):
        low, high = float(size_nm[..., axis].min()), float(size_nm[..., axis].max())
        if low < grid[0] - 1e-6 or high > grid[-1] + 1e-6:
            expected = f"{grid[0]:g} to {grid[-1]:g} nm, the sizes of the model of neighbours"
            raise InputError.single(
                "supercell", name, expected, f"{low:g} to {high:g} nm", "use the solver rcwa or meep"
            )
    known = library.surface(size_nm[..., 0], size_nm[..., 1])
    order = supercell.propagating_orders("x")
    t, joint = np.zeros((2, len(order), 2, 2), dtype=np.complex128)
    is_solved = has_joint_effect(supercell)
    if is_solved:
        neighbours, joint = neighbours.uncoupled, joint_effect(supercell, np.stack([known.t_xx, known.t_yy]))
    squared, power = 0.0, 0.0
    corrected = [_corrected(neighbours, size_nm, axis) for axis in range(len(POLARISATIONS))]
    cross = np.zeros((2, *supercell.shape), dtype=np.complex128)
    if neighbours.cross is not None and all(len(coupled) == 2 for _, coupled in corrected):
        cross = CrossLight(neighbours, [coupled for _, coupled in corrected]).field(neighbours.cross)
    for axis, (light, local) in enumerate(zip(POLARISATIONS, (known.t_xx, known.t_yy), strict=True)):
        corrections, coupled = corrected[axis]
        field = local + corrections.sum(axis=0)
        amplitude, transmitted = _amplitude(supercell, order, axis, field, cross[axis], joint[:, :, axis])
        if coupled and transmitted > 1.0:
            # A resonance of coupled lines that sends out more light than arrives is false: lines without coupling.
            corrections = block_corrections(neighbours.uncoupled, size_nm, axis)
            field = local + corrections.sum(axis=0)
            amplitude, transmitted = _amplitude(supercell, order, axis, field, np.zeros_like(field), joint[:, :, axis])
        # The model does not conserve energy: amplitudes are scaled down where more light would leave than arrives.
        t[:, :, axis] = amplitude / np.sqrt(max(1.0, transmitted))
        norm = float(np.linalg.norm(local))
        steps = [float(np.linalg.norm(local - np.roll(local, 1, axis))) / norm for axis in (1, 0)]
        # The library's error is of t itself, that of the answer relative to the field.
        error = float(np.max(known.error)) * np.sqrt(local.size) / norm
        error += max(0.0, 1.0 - 1.0 / np.sqrt(max(1.0, transmitted)))
        for direction in (0, 1):
            if supercell.shape[1 - direction] > 1:
                error += _stated_error(neighbours.line(direction, light), direction, size_nm, local, corrections)
        if is_solved:
            error += _JOINT_SHARE * float(np.linalg.norm(joint[:, :, axis]) / np.linalg.norm(amplitude))
        elif min(supercell.shape) > 1:
            error += _BLOCK_SHARE * steps[0] * steps[1]
        weight = float(np.sum(np.abs(amplitude) ** 2))
        squared, power = squared + error**2 * weight, power + weight
    return SupercellOrders(supercell, order, t, float(np.sqrt(squared / power)), time.perf_counter() - start)


def _amplitude(
    supercell: Supercell, order: IntArray, axis: int, field: ComplexArray, cross: ComplexArray, joint: ComplexArray
) -> tuple[ComplexArray, float]:
    """Amplitudes of orders, shape (orders, 2), and their power.

    From a block's field and cross-polarised field, and from the joint effect on its orders, shape (orders, 2).
    """
    amplitude = joint.copy()
    amplitude[:, axis] += supercell.local_period(order, field)
    amplitude[:, 1 - axis] += supercell.local_period(order, cross)
    return amplitude, float(np.sum(supercell.relative_power(order, amplitude, POLARISATIONS[axis])))


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
