"""Layers of supercells of ellipses: the elements of each pillar's quarter cell, mirrored and repeated.

A row keeps the mirror about its axis: its upper half is solved for each light alone. A block has all quarters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metafab.cell.curved.functions import functions_of
from metafab.cell.curved.layers import MeshMatrices
from metafab.cell.curved.mesh import Arc, Point, Quad, QuarterMesh, untreated
from metafab.cell.elements.assembly import Layer, RealWaves
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.coordinates import IntArray
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, Polarisation
from metafab.core.errors import Fault, InputError

#: Square in the middle of a pillar, over the pillar's size.
_SQUARE = 0.45
#: Sectors of half a pillar and of a whole one: angles where the arc begins and ends, and whether it runs along +x.
_QUARTER = 0.25 * math.pi
_HALF = ((0.0, _QUARTER, False), (3.0 * _QUARTER, _QUARTER, True), (4.0 * _QUARTER, 3.0 * _QUARTER, False))
_WHOLE = (
    (-_QUARTER, _QUARTER, False),
    (3.0 * _QUARTER, _QUARTER, True),
    (5.0 * _QUARTER, 3.0 * _QUARTER, False),
    (5.0 * _QUARTER, 7.0 * _QUARTER, True),
)
#: Diameter of the elements of a site without a pillar, as a share of the period.
_EMPTY_SITE = 0.5


def polynomial_order(resolution: float) -> int:
    """Polynomial order of all elements at a resolution."""
    return math.floor(resolution) + 1


def count_functions(supercell: Supercell, resolution: float) -> int:
    """Number of functions of the transverse E at a resolution, apart from those of a row's mirror planes."""
    return 2 * polynomial_order(resolution) ** 2 * len(supercell_mesh(supercell).quads)


def curved_layer(supercell: Supercell, lights: Sequence[Polarisation], resolution: float, order: IntArray) -> Layer:
    """Layer of a row along x for one light, or of a block for one or both.

    Args:
        supercell: ellipses.
        lights: incident polarisations.
        resolution: see :func:`polynomial_order`.
        order: shape (n_orders, 2), transmitted orders.

    Raises:
        InputError: a pillar has no elements.
    """
    mesh, cell = supercell_mesh(supercell), supercell.cell
    functions = functions_of(mesh, lights[0], polynomial_order(resolution))
    # A block holds the uniform fields of both lights, whatever the incident one.
    axes = [0, 1] if all(mesh.repeats) else [POLARISATIONS.index(lights[0])]
    matrices = MeshMatrices.of(functions, axes)
    waves, count = matrices.waves(), len(axes)
    uniform = np.zeros((2, len(matrices.grams.e)))
    uniform[axes] = waves.te[:, :count].T
    orders = np.zeros((len(order), 2, len(matrices.grams.e)), dtype=np.complex128)
    k = supercell.wavevectors_per_um(order) * 1e-3
    for each in functions.elements:
        x, y = np.exp(-1j * np.outer(k[:, 0], each.at[0])), np.exp(-1j * np.outer(k[:, 1], each.at[1]))
        for axis in range(2):
            # Over both halves of a row: the light's component is even about its axis, the other one odd.
            along_y = y if all(mesh.repeats) else y.real if axis == axes[0] else 1j * y.imag
            orders[:, axis, each.place] += (x * along_y * each.weight) @ each.e[axis].T
    p, q = matrices.grams.p_and_q(cell.layer, cell.k0_per_nm)
    tm, te = RealWaves(waves.k_squared_tm, waves.tm.T), RealWaves(waves.k_squared_te[count:], waves.te[:, count:].T)
    return Layer(p, q, tm, te, uniform, orders / matrices.area_nm2, matrices.area_nm2)


def supercell_mesh(supercell: Supercell) -> QuarterMesh:
    """Elements of a block, or of the upper half of a row along x; InputError for a pillar that has none."""
    # A single column is doubled: the elements between two sites must have different sites at their ends.
    sizes = np.tile(supercell.size_nm, (1, 2, 1)) if supercell.shape[1] == 1 else supercell.size_nm
    (n_y, n_x), period = sizes.shape[:2], supercell.cell.period_nm
    is_row = n_y == 1
    quads: list[Quad] = []
    for row, column in np.ndindex(n_y, n_x):
        size = tuple(sizes[row, column].tolist())
        solid = all(size)
        width, length = size if solid else [_EMPTY_SITE * each for each in period]
        cell = replace(supercell.cell, width_nm=width, length_nm=length)
        faults = untreated(cell)
        if cell.shape != "ellipse":
            outline = "crosses" if cell.shape == "cross" else "rounded corners"
            faults = [Fault("shape", "rectangles, circles or ellipses for supercells by rcwa", outline)]
        if faults:
            raise InputError("supercell", [replace(fault, remedy="use meep") for fault in faults])
        # Phases count from the middle of the supercell as given, not of its doubled column.
        middle = (column + 0.5 - supercell.shape[1] / 2) * period[0], (row + 0.5 - n_y / 2) * period[1]
        quads += _site(cell, middle, solid=solid, is_half=is_row)
    ends = n_x * period[0], (0.5 if is_row else n_y) * period[1]
    return QuarterMesh(tuple(quads), ends, repeats=(True, not is_row))


def _site(cell: PillarCell, middle: Point, *, solid: bool, is_half: bool) -> Iterator[Quad]:
    """A square in the middle of a pillar, then one element a sector to its outline, and one from there to the period.

    In all sectors, coordinates run outwards, and along +x or +y: sides that neighbours share have one sense.
    """
    radius, half = (0.5 * cell.width_nm, 0.5 * cell.length_nm), (0.5 * cell.period_nm[0], 0.5 * cell.period_nm[1])
    square = _SQUARE * radius[0], _SQUARE * radius[1]

    def place(half_sizes: Point, turn: float, *, on_arc: bool) -> Point:
        """A point of an ellipse, or of a rectangle at its corners and in the middle of its sides."""
        along = math.cos(turn), math.sin(turn)
        x, y = (size * (at if on_arc else round(at)) for size, at in zip(half_sizes, along, strict=True))
        return middle[0] + x, middle[1] + y

    def corner(sign_x: float, sign_y: float) -> Point:
        return middle[0] + sign_x * square[0], middle[1] + sign_y * square[1]

    low = 0.0 if is_half else -1.0
    yield Quad((corner(-1.0, low), corner(1.0, low), corner(1.0, 1.0), corner(-1.0, 1.0)), solid)
    for inner, outer, of_arc in ((square, radius, 1), (radius, half, 0)):
        for begin, end, along_x in _HALF if is_half else _WHOLE:
            one, two = (place(inner, turn, on_arc=not of_arc) for turn in (begin, end))
            three, four = (place(outer, turn, on_arc=bool(of_arc)) for turn in (end, begin))
            arc, inside = Arc(middle, radius, begin, end), solid and bool(of_arc)
            gathered = 1 if of_arc else -1
            near, far = (None, arc) if of_arc else (arc, None)
            if along_x:
                yield Quad((one, two, three, four), inside, bottom=near, top=far, gathered=(0, gathered))
            else:
                yield Quad((one, four, three, two), inside, left=near, right=far, gathered=(gathered, 0))
