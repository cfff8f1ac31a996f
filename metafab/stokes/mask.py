"""Turned pillars in a file and back: one cell with one polygon for each size and angle, placed by its sites."""

from __future__ import annotations

import datetime
import math
from pathlib import Path

import gdstk
import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import whole_file
from metafab.layout import lattice_of
from metafab.library import Library
from metafab.spec import Design
from metafab.stokes.assign import TurnedPillars, jones_of

#: Files do not tell when they were written: the same pillars give the same bytes.
_TIME = datetime.datetime(2023, 1, 1)
#: Vertices on the database grid tell sides to about a nanometre; the library's sizes are further apart.
_LARGEST_ROUNDING_NM = 1.0


def write(pillars: TurnedPillars, path: Path, design: Design) -> Path:
    """Write the pillars as GDSII or OASIS, by the suffix of ``path``.

    Vertices lie on the database grid, rounded once in the cell of each kind, so that all pillars of a kind are equal.
    """
    unit_um = design.mask.database_unit_nm * 1e-3
    file = gdstk.Library(unit=1e-6, precision=unit_um * 1e-6)
    top = file.new_cell(f"{design.name}_stokes")
    x_um, y_um = pillars.lattice.x_um(), pillars.lattice.y_um()
    order = np.argsort(pillars.index, axis=None, kind="stable")
    present, first = np.unique(pillars.index.ravel()[order], return_index=True)
    for number, start, stop in zip(present, first, [*first[1:], order.size], strict=True):
        if number == 0:
            continue
        width, length, angle_deg = pillars.kinds[number - 1]
        cell = file.new_cell(f"w{width:g}_l{length:g}_a{angle_deg:g}".replace(".", "p"))
        vertices = np.round(_rectangle_um(width, length, angle_deg) / unit_um) * unit_um
        cell.add(
            gdstk.Polygon(
                [(x, y) for x, y in vertices.tolist()], layer=design.mask.layer, datatype=design.mask.datatype
            )
        )
        rows, columns = np.unravel_index(order[start:stop], pillars.index.shape)
        sites = np.stack([x_um[columns], y_um[rows]], axis=1)
        reference = gdstk.Reference(cell, tuple(sites[0]))
        if len(sites) > 1:
            reference.repetition = gdstk.Repetition(offsets=sites[1:] - sites[0])
        top.add(reference)
    with whole_file(path) as part:
        if path.suffix == ".oas":
            file.write_oas(str(part), compression_level=6)
        else:
            file.write_gds(str(part), timestamp=_TIME)
    return path


def _rectangle_um(width_nm: float, length_nm: float, angle_deg: float) -> FloatArray:
    cosine, sine = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    corners = 0.5e-3 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width_nm, length_nm)
    return np.asarray(corners @ np.array([[cosine, sine], [-sine, cosine]]))


def read(path: Path, library: Library, design: Design, *, angles: int) -> TurnedPillars:
    """The pillars of a written file, with the Jones matrices of the sizes and angles that its polygons have.

    Args:
        path: what :func:`write` wrote.
        library: for the Jones matrices.
        design: lattice and layer.
        angles: steps of half a turn to which angles are rounded; sides are rounded to the library's sizes.

    Raises:
        InputError: the file cannot be read, or holds a shape that is no turned pillar on a site of its own.
    """
    try:
        file = gdstk.read_oas(str(path)) if path.suffix == ".oas" else gdstk.read_gds(str(path))
        (top,) = (cell for cell in file.top_level() if isinstance(cell, gdstk.Cell))
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError.single(str(path), "file", "a mask with one top cell", str(error), "write it again") from None
    lattice = lattice_of(design)
    index = np.zeros(lattice.shape, dtype=np.uint16)
    origin = np.array([lattice.x_um()[0], lattice.y_um()[0]])
    pitch = np.array(lattice.period_dbu) * lattice.database_unit_nm * 1e-3
    size_grid_nm = design.unit_cell.sweep.size_grid_nm
    numbers: dict[str, int] = {}
    kinds: list[tuple[float, float, float]] = []
    misplaced = 0
    for reference in sorted(top.references, key=lambda r: str(r.cell.name)):
        number = numbers.get(reference.cell.name)
        if number is None:
            kinds.append(_only_kind(reference.cell, angles, size_grid_nm, path))
            number = numbers[reference.cell.name] = len(kinds)
        places = (_sites(reference) - origin) / pitch
        column, row = np.round(places).astype(np.intp).T
        inside = (row >= 0) & (row < index.shape[0]) & (column >= 0) & (column < index.shape[1])
        on_site = inside & (np.abs(places - np.round(places)).max(axis=1) < 1e-3)
        misplaced += int((~on_site).sum()) + int((index[row[on_site], column[on_site]] != 0).sum())
        index[row[on_site], column[on_site]] = number
    if misplaced:
        raise InputError.single(
            str(path), "pillars", "one pillar a site of the lattice", f"{misplaced} elsewhere", "write it again"
        )
    table = np.array(kinds)
    jones = np.concatenate([np.zeros((1, 3), dtype=np.complex128), jones_of(library, design, table)])
    return TurnedPillars(lattice, index, table, jones, math.nan)


def _only_kind(cell: gdstk.Cell, angles: int, size_grid_nm: float, path: Path) -> tuple[float, float, float]:
    """Width, length and angle of a cell's only polygon."""
    kinds = [_kind(1e3 * np.asarray(polygon.points), angles, size_grid_nm) for polygon in cell.polygons]
    if len(kinds) != 1 or kinds[0] is None:
        raise InputError.single(
            str(path), "pillars", "cells of one turned rectangle of the library's sizes", cell.name,
            "read the file with the design that wrote it",
        )  # fmt: skip
    return kinds[0]


def _sites(reference: gdstk.Reference) -> FloatArray:
    """Where a reference's copies stand, shape (n, 2), um."""
    origin = np.array(reference.origin)
    if reference.repetition.size == 0:
        return origin[None]
    return np.asarray(origin + reference.repetition.get_offsets())


def _kind(vertices_nm: FloatArray, angles: int, size_grid_nm: float) -> tuple[float, float, float] | None:
    """Width, length and angle of a rectangle from its vertices, wherever the file begins it; None for other shapes."""
    if len(vertices_nm) != 4:
        return None
    sides = np.roll(vertices_nm, -1, axis=0) - vertices_nm
    along = 0.5 * (sides[:2] - sides[2:])
    measured = np.hypot(*along.T)
    sizes = np.round(measured / size_grid_nm) * size_grid_nm
    if np.abs(sizes - measured).max() > _LARGEST_ROUNDING_NM:
        return None
    step = 180.0 / angles
    angle = np.round(math.degrees(math.atan2(along[0, 1], along[0, 0])) / step) * step % 180.0
    # A side is the other's by a quarter of a turn: angles are kept below it.
    if angle >= 90.0:
        return float(sizes[1]), float(sizes[0]), float(angle - 90.0)
    return float(sizes[0]), float(sizes[1]), float(angle)
