"""Pictures of a mask, in one pass over its tiles: the whole lens as a grey map, and rectangles at two zooms.

Memory does not grow with the lens: the grey map has a limited number of pixels, the zooms a fixed number of sites.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import PillarMap, PillarTile

#: Largest number of pixels along a side of the grey map.
_MAP_PIXELS = 360
#: Centre of the zooms as a share of the half side: off the axis and off the diagonals.
_LOOK_AT = (0.42, 0.23)
#: Sites along a side of each zoom.
_ZOOM_SITES = (40, 10)


@dataclass(frozen=True)
class MaskPicture:
    """Data of the mask figures."""

    fill: FloatArray  #: Shape (n_y, n_x), share of each block of sites that pillars cover; NaN without pillars.
    half_side_um: tuple[float, float]  #: Half the width and half the height of ``fill``.
    #: Rectangles of each zoom, the wider zoom first; shape (n, 4): x, y, width, length in um.
    zooms: tuple[FloatArray, ...]
    sites_a_pixel: int  #: Sites along a side of one pixel of ``fill``.

    def frames_um(self) -> list[FloatArray]:
        """Frame of each zoom with pillars, shape (4,): left, right, low, high."""
        return [np.array([z[:, 0].min(), z[:, 0].max(), z[:, 1].min(), z[:, 1].max()]) for z in self.zooms if z.size]


def picture_of(pillars: PillarMap, outline: Outline = RECTANGLE) -> MaskPicture:
    """Make the pictures of a pillar map; ``outline`` gives the area of each size."""
    lattice = pillars.lattice
    n_y, n_x = lattice.shape
    across = 2 if lattice.hexagonal else 1  # A row of a hexagonal lattice fills every other column.
    block = across * max(1, math.ceil(max(n_y, n_x) / (across * _MAP_PIXELS)))
    area = outline.area(pillars.size_dbu) * lattice.database_unit_nm**2
    covered = np.zeros((math.ceil(n_y / block), math.ceil(n_x / block)))
    windows = [_window(lattice.shape, (sites, across * sites)) for sites in _ZOOM_SITES]
    pillars_of: list[list[FloatArray]] = [[] for _ in windows]
    for tile in pillars.tiles():
        _add_blocks(covered, tile, area, block)
        for window, rectangles in zip(windows, pillars_of, strict=True):
            rectangles.append(_rectangles(pillars, tile, window))
    period_nm = np.multiply(lattice.period_dbu, lattice.database_unit_nm)
    covered /= float(np.prod(period_nm)) * block**2
    covered[covered == 0.0] = np.nan
    half_x, half_y = (0.5e-3 * block * count * period_nm[axis] for axis, count in enumerate(covered.shape[::-1]))
    zooms = tuple(np.concatenate([np.empty((0, 4)), *rectangles]) for rectangles in pillars_of)
    return MaskPicture(covered, (float(half_x), float(half_y)), zooms, block)


def _window(shape: tuple[int, int], sites: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a zoom of ``sites`` sites."""
    slices = []
    for count, wanted, place in zip(shape, sites, reversed(_LOOK_AT), strict=True):
        start = round(0.5 * count * (1.0 + place)) - wanted // 2
        start = min(max(0, start), max(0, count - wanted))
        slices.append(slice(start, min(count, start + wanted)))
    return slices[0], slices[1]


def _add_blocks(covered: FloatArray, tile: PillarTile, area: FloatArray, block: int) -> None:
    rows = (tile.row + np.arange(tile.size_index.shape[0])) // block
    columns = (tile.column + np.arange(tile.size_index.shape[1])) // block
    by_row = np.add.reduceat(area[tile.size_index], np.flatnonzero(np.diff(rows, prepend=-1)), axis=0)
    blocks = np.add.reduceat(by_row, np.flatnonzero(np.diff(columns, prepend=-1)), axis=1)
    covered[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += blocks


def _rectangles(pillars: PillarMap, tile: PillarTile, window: tuple[slice, slice]) -> FloatArray:
    rows, columns = window
    index = tile.size_index[
        max(0, rows.start - tile.row) : max(0, rows.stop - tile.row),
        max(0, columns.start - tile.column) : max(0, columns.stop - tile.column),
    ]
    if index.size == 0:
        return np.empty((0, 4))
    row, column = np.nonzero(index)
    size_um = 1e-3 * pillars.size_nm()[index[row, column]]
    y = pillars.lattice.y_um()[row + max(tile.row, rows.start)]
    x = pillars.lattice.x_um()[column + max(tile.column, columns.start)]
    return np.column_stack([x, y, size_um])
