"""Pillars of a written mask around a point of the lens, as a supercell for a full-wave solver."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from metafab.cell import PillarCell, pillar_cell
from metafab.cell.supercell import Supercell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.layout import PillarMap
from metafab.library import Library

Axis: TypeAlias = Literal["x", "y"]

#: Sites of the line on which a local period is measured, and the longest period measurable on it.
_LINE_SITES = 64
_LONGEST_SITES = 40


def site_cell(library: Library) -> PillarCell:
    """Return the cell of a supercell's sites, without a pillar; InputError for rings."""
    if library.unit_cell.cell.shape == "ring":
        expected = "rectangles, circles, ellipses or crosses in a supercell"
        raise InputError.single("supercell", "cell.shape", expected, "rings: not available for these")
    return pillar_cell(library.unit_cell, 0.0, 0.0)


def site_at(pillars: PillarMap, x_um: float, y_um: float) -> tuple[int, int]:
    """Return (row, column) of the site nearest to a point; InputError if the point lies outside the lattice."""
    lattice = pillars.lattice
    nearest = []
    for name, at, sites in (("y", y_um, lattice.y_um()), ("x", x_um, lattice.x_um())):
        pitch = lattice.period_dbu[1 if name == "y" else 0] * lattice.database_unit_nm * 1e-3
        if not sites[0] - pitch <= at <= sites[-1] + pitch:
            expected = f"a point on the lens, {sites[0]:g} to {sites[-1]:g} um"
            raise InputError.single("place in the mask", f"{name}_um", expected, f"{at:g} um")
        nearest.append(int(np.argmin(np.abs(sites - at))))
    return nearest[0], nearest[1]


def sizes_at(pillars: PillarMap, row: int, column: int, shape: tuple[int, int]) -> FloatArray:
    """Return the sizes (width, length) of a block of ``shape`` sites, nm, shape (n_y, n_x, 2).

    Its first row and column may lie outside the lattice; sizes are zero where there is no pillar or no site.
    InputError for turned pillars and hexagonal lattices.
    """
    if pillars.lattice.hexagonal or pillars.angle_deg is not None:
        got = "a hexagonal lattice" if pillars.lattice.hexagonal else "turned ones"
        expected = "upright pillars in a rectangular lattice in a supercell"
        raise InputError.single("supercell", "pillars", expected, f"{got}: not available for these")
    index = np.zeros(shape, dtype=np.uint16)
    for tile in pillars.tiles():
        n_y, n_x = tile.size_index.shape
        low_y, high_y = max(row, tile.row), min(row + shape[0], tile.row + n_y)
        low_x, high_x = max(column, tile.column), min(column + shape[1], tile.column + n_x)
        if low_y < high_y and low_x < high_x:
            index[low_y - row : high_y - row, low_x - column : high_x - column] = tile.size_index[
                low_y - tile.row : high_y - tile.row, low_x - tile.column : high_x - tile.column
            ]
    return np.asarray(pillars.size_nm()[index], dtype=np.float64)


def supercell_at(
    pillars: PillarMap, library: Library, x_um: float, y_um: float, shape: tuple[int, int]
) -> tuple[Supercell, FloatArray, FloatArray]:
    """Return a block of written pillars of ``shape`` sites around a point; its middle is the nearest site.

    The library has the pillars' materials and illumination. Also returns x, shape (n_x,), and y, shape (n_y,), of the
    sites in um.
    """
    lattice = pillars.lattice
    row, column = site_at(pillars, x_um, y_um)
    row, column = row - shape[0] // 2, column - shape[1] // 2
    pitch_x, pitch_y = (period * lattice.database_unit_nm * 1e-3 for period in lattice.period_dbu)
    x = lattice.x_um()[0] + pitch_x * (column + np.arange(shape[1]))
    y = lattice.y_um()[0] + pitch_y * (row + np.arange(shape[0]))
    return Supercell(site_cell(library), sizes_at(pillars, row, column, shape)), x, y


def library_responses(supercell: Supercell, library: Library) -> ComplexArray:
    """Return the library's t_xx and t_yy at each site, shape (2, n_y, n_x); 0 where there is no pillar."""
    responses = np.zeros((2, *supercell.shape), dtype=np.complex128)
    pillar = np.all(supercell.size_nm > 0.0, axis=-1)
    if pillar.any():
        stored = library.at_sizes(*supercell.size_nm[pillar].T)
        responses[:, pillar] = stored.t_xx, stored.t_yy
    return responses


def line_at(pillars: PillarMap, library: Library, x_um: float, y_um: float, axis: Axis) -> ComplexArray:
    """Return the library's t_xx and t_yy along a line of pillars around a point, shape (2, n)."""
    shape = (1, _LINE_SITES) if axis == "x" else (_LINE_SITES, 1)
    return library_responses(supercell_at(pillars, library, x_um, y_um, shape)[0], library).reshape(2, -1)


def local_period_sites(t: ComplexArray) -> tuple[int, int]:
    """Find the local period on a line of pillars from the peak of the spectrum of their responses, shape (n,).

    Returns its sites, and the sign of its phase slope: the order (+1 or -1) of the deflected light. InputError if the
    phase changes by less than 2 pi in 40 sites.
    """
    fine = 64 * t.size
    spectrum = np.abs(np.fft.fft(t * np.hanning(t.size), fine))
    turns = np.fft.fftfreq(fine)[int(np.argmax(spectrum))]
    if abs(turns) * _LONGEST_SITES < 1.0:
        got = f"{1.0 / abs(turns):.0f} sites" if turns else "a constant phase"
        expected, remedy = (
            f"a local period of up to {_LONGEST_SITES} sites",
            "choose a point with a larger deflection angle",
        )
        raise InputError.single("coupling", "place", expected, got, remedy)
    return max(2, round(1.0 / abs(turns))), 1 if turns > 0.0 else -1
