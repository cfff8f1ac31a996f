"""The written mask at three zooms, drawn in one pass over its tiles, and fields of a simulated patch of it.

Memory does not grow with the lens: the grey map has a limited number of pixels, the zooms a fixed number of sites.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import PillarMap, PillarTile
from metafab.report.style import (
    GOOD,
    HAIRLINE,
    INK,
    PHASE_MAP,
    PHASE_TICKS,
    SHARE_MAP,
    X_COLOUR,
    Extent,
    dress,
    picture,
)

#: Largest number of pixels along a side of the grey map.
_MAP_PIXELS = 360
#: Centre of the zooms as a share of the half side: off the axis and off the diagonals.
_LOOK_AT = (0.42, 0.23)
#: Sites along a side of each zoom.
_ZOOM_SITES = (40, 10)


def fill_map(fill: FloatArray, half_side_um: tuple[float, float], axes: Axes, marks_um: list[FloatArray]) -> Axes:
    """Draw the share of the surface that pillars cover, with frames at the places of the closer zooms.

    The share has the shape (n_y, n_x), 0 to 1 and NaN without pillars, over twice ``half_side_um``. ``marks_um`` holds
    an array (left, right, low, high), shape (4,), for each closer zoom.
    """
    half_x, half_y = half_side_um
    extent = (-half_x, half_x, -half_y, half_y)
    # Blocks on the rim lie partly outside the lens and do not set the scale.
    low, high = np.nanpercentile(fill, (2.0, 98.0)) if np.isfinite(fill).any() else (0.0, 1.0)
    bar = "#ffffff" if np.isfinite(fill[0, 0]) else INK
    scale: dict[str, Any] = {"cmap": SHARE_MAP, "vmin": low, "vmax": high}
    picture(axes, fill, extent, "share covered by pillars", "The whole mask", bar=bar, **scale)
    for left, right, low, high in marks_um:
        pad = max(0.0, 0.012 * 2 * half_x - (right - left) / 2)  # visible size of the frame
        corners_x = [left - pad, right + pad, right + pad, left - pad, left - pad]
        corners_y = [low - pad, low - pad, high + pad, high + pad, low - pad]
        axes.plot(corners_x, corners_y, color="#ffffff", linewidth=1.1)
    return axes


def pillar_outlines(
    rectangles_um: FloatArray, axes: Axes, title: str, *, outline: Outline = RECTANGLE, label_nearest: bool = False
) -> Axes:
    """Draw pillars (x, y of the centre, width, length), shape (n, 4), with the outlines of the file.

    ``label_nearest`` marks the pillar nearest to the middle and writes its width x length, or its diameter, above.
    """
    x, y = rectangles_um[:, 0], rectangles_um[:, 1]
    unit_um = outline.database_unit_nm * 1e-3
    paths = [
        Path(np.array([place]) + outline.vertices(*size) * unit_um, closed=False)
        for place, size in zip(rectangles_um[:, :2], np.rint(rectangles_um[:, 2:] / unit_um).astype(int), strict=True)
    ]
    # A single path is drawn as fast as a picture, and it follows the theme of the page. As a patch of the axes, its
    # extent would be sought edge by edge, though the limits are set below.
    axes.add_artist(PathPatch(Path.make_compound_path(*paths), facecolor=GOOD, linewidth=0.0))
    dress(axes, "x / µm", "y / µm", title)
    axes.set(xlim=(x.min() - 0.2, x.max() + 0.2), ylim=(y.min() - 0.2, y.max() + 0.2), aspect="equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(HAIRLINE)
    if label_nearest and x.size:
        nearest = int(np.argmin((x - x.mean()) ** 2 + (y - y.mean()) ** 2))
        width_nm, length_nm = (1e3 * rectangles_um[nearest, 2:]).tolist()
        is_round = outline.shape in {"ellipse", "ring"} and width_nm == length_nm
        text = f"Ø {width_nm:g} nm" if is_round else f"{width_nm:g} × {length_nm:g} nm"
        axes.add_artist(PathPatch(paths[nearest], color=X_COLOUR, lw=0))
        axes.set_title(text, fontsize=9, color=X_COLOUR, loc="right", pad=7)
    return axes


def patch_phase(field: ComplexArray, x_um: FloatArray, y_um: FloatArray, axes: Axes, title: str) -> Axes:
    """Draw the phase of a field, shape (n_y, n_x), at the sites (x, y) of a patch on a cyclic scale."""
    extent = _extent(x_um, y_um)
    scale: dict[str, Any] = {"cmap": PHASE_MAP, "vmin": -math.pi, "vmax": math.pi}
    return picture(axes, np.angle(field), extent, "phase / rad", title, bar=INK, ticks=PHASE_TICKS, **scale)


def patch_amplitude(
    field: ComplexArray, x_um: FloatArray, y_um: FloatArray, axes: Axes, title: str, largest: float
) -> Axes:
    """Draw the amplitude of a field, shape (n_y, n_x), at the sites (x, y) of a patch, on a scale up to ``largest``."""
    extent = _extent(x_um, y_um)
    scale: dict[str, Any] = {"cmap": SHARE_MAP, "vmin": 0.0, "vmax": largest}
    return picture(axes, np.abs(field), extent, "field over incident field", title, **scale)


def neighbour_map(
    values: FloatArray,
    x_um: FloatArray,
    y_um: FloatArray,
    axes: Axes,
    label: str,
    title: str,
    scale: tuple[float, float],
) -> Axes:
    """Draw one of the maps of :class:`metafab.optics.point_spread.NeighbourMap`, shape (n_y, n_x).

    ``x_um`` and ``y_um`` are the centres of its blocks, ``label`` names the values, ``scale`` is (lowest, highest).
    """
    return picture(
        axes, values, _extent(x_um, y_um), label, title, cmap=SHARE_MAP, vmin=scale[0], vmax=scale[1], bar=INK
    )


def _extent(x_um: FloatArray, y_um: FloatArray) -> Extent:
    """Extent of the patch, half a period beyond the outermost sites."""
    half_x, half_y = (0.5 * (axis[-1] - axis[0]) / max(1, axis.size - 1) for axis in (x_um, y_um))
    return (x_um[0] - half_x, x_um[-1] + half_x, y_um[0] - half_y, y_um[-1] + half_y)


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
