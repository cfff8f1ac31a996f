"""Pillars of a written mask around a place, as a supercell that a full-wave solver takes."""

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

#: Sites of the line on which a local period is measured, and the longest that is found there.
_LINE_SITES = 64
_LONGEST_SITES = 40


def site_at(pillars: PillarMap, x_um: float, y_um: float) -> tuple[int, int]:
    """(row, column) of the site nearest to a place.

    Raises:
        InputError: the place lies outside the lattice.
    """
    lattice = pillars.lattice
    found = []
    for name, at, sites in (("y", y_um, lattice.y_um()), ("x", x_um, lattice.x_um())):
        pitch = lattice.period_dbu[1 if name == "y" else 0] * lattice.database_unit_nm * 1e-3
        if not sites[0] - pitch <= at <= sites[-1] + pitch:
            raise InputError.single(
                "patch", f"{name}_um", f"a place on the lens, {sites[0]:g} to {sites[-1]:g} um", f"{at:g} um"
            )
        found.append(int(np.argmin(np.abs(sites - at))))
    return found[0], found[1]


def sizes_at(pillars: PillarMap, row: int, column: int, shape: tuple[int, int]) -> FloatArray:
    """(width, length) in nm of a block of sites, shape (n_y, n_x, 2); zero where there is no pillar or no site.

    Args:
        pillars: read from a mask.
        row: of the block's first row; may lie outside the lattice.
        column: of its first column, likewise.
        shape: (n_y, n_x).
    """
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
    """A block of written pillars about a place.

    Args:
        pillars: read from a mask.
        library: whose materials and illumination they have.
        x_um: of the block's middle, to within a site; likewise ``y_um``.
        y_um: see ``x_um``.
        shape: (n_y, n_x) sites.

    Returns:
        The supercell, and x (n_x,) and y (n_y,) of its sites in um.
    """
    lattice = pillars.lattice
    row, column = site_at(pillars, x_um, y_um)
    row, column = row - shape[0] // 2, column - shape[1] // 2
    pitch_x, pitch_y = (period * lattice.database_unit_nm * 1e-3 for period in lattice.period_dbu)
    x = lattice.x_um()[0] + pitch_x * (column + np.arange(shape[1]))
    y = lattice.y_um()[0] + pitch_y * (row + np.arange(shape[0]))
    return Supercell(empty_cell(library), sizes_at(pillars, row, column, shape)), x, y


def empty_cell(library: Library) -> PillarCell:
    """The library's unit cell without a pillar."""
    return pillar_cell(library.unit_cell, 0.0, 0.0)


def library_responses(supercell: Supercell, library: Library) -> ComplexArray:
    """The library's t_xx and t_yy at each site, shape (2, n_y, n_x); 0 where there is no pillar, as in optics."""
    responses = np.zeros((2, *supercell.shape), dtype=np.complex128)
    pillar = np.all(supercell.size_nm > 0.0, axis=-1)
    if pillar.any():
        found = library.at_sizes(*supercell.size_nm[pillar].T)
        responses[:, pillar] = found.t_xx, found.t_yy
    return responses


def line_at(pillars: PillarMap, library: Library, x_um: float, y_um: float, axis: Axis) -> ComplexArray:
    """The library's t_xx and t_yy along a line of pillars about a place, shape (2, n)."""
    shape = (1, _LINE_SITES) if axis == "x" else (_LINE_SITES, 1)
    return library_responses(supercell_at(pillars, library, x_um, y_um, shape)[0], library).reshape(2, -1)


def local_period_sites(t: ComplexArray) -> tuple[int, int]:
    """Sites of one local period, and the sign of its phase slope, from the strongest wave on a line of pillars.

    Args:
        t: shape (n,), response at each site.

    Returns:
        (sites, order): a row of so many pillars sends its light into the order +1 or -1.

    Raises:
        InputError: the phase turns by less than a round in 40 sites.
    """
    fine = 64 * t.size
    spectrum = np.abs(np.fft.fft(t * np.hanning(t.size), fine))
    turns = np.fft.fftfreq(fine)[int(np.argmax(spectrum))]
    if abs(turns) * _LONGEST_SITES < 1.0:
        raise InputError.single(
            "coupling", "place", f"a local period of up to {_LONGEST_SITES} sites",
            f"{1.0 / abs(turns):.0f} sites" if turns else "a constant phase",
            "choose a place or an axis where the lens bends light more",
        )  # fmt: skip
    return max(2, round(1.0 / abs(turns))), 1 if turns > 0.0 else -1
