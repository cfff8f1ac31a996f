"""Names and places of the cells that both formats share."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import Lattice, PillarTile
from metafab.layout.turned import TurnedRectangles

_LONGEST_NAME = 32  # what every GDSII reader takes


@dataclass(frozen=True)
class TileCell:
    """The cell of one tile; its origin is the lower left corner of its first unit cell.

    Attributes:
        name: cell name.
        x_dbu: where the top cell places the origin; likewise ``y_dbu``.
        first_x_dbu: centre of the first site, from the origin; likewise ``first_y_dbu``.
    """

    name: str
    x_dbu: int
    y_dbu: int
    first_x_dbu: int
    first_y_dbu: int

    def flattened(self, x_dbu: int, y_dbu: int) -> TileCell:
        """The same sites counted from the origin of the top cell, in the lens at (x_dbu, y_dbu)."""
        first_x_dbu, first_y_dbu = self.x_dbu + self.first_x_dbu + x_dbu, self.y_dbu + self.first_y_dbu + y_dbu
        return TileCell(self.name, 0, 0, first_x_dbu, first_y_dbu)


@dataclass(frozen=True)
class Stamp:
    """The rectangle or polygon that is drawn at a site, by its size index.

    Attributes:
        size_dbu: shape (n_sizes + 1, 2), width and length; row 0 is never drawn.
        corner_dbu: shape (n_sizes + 1, 2), from the centre of the site to the lower left corner of a rectangle, or to
            the first corner of a polygon.
        layer: layer; likewise ``datatype``.
        bias_dbu: of the copy of the lens that it belongs to.
        tag: tells the cells of several stamps of one tile apart.
        polygons: the corners of each size from its first, shape (n, 2) each; None for rectangles.
        turned: whether several polygons share one width and length, at different angles.
    """

    size_dbu: NDArray[np.int64]
    corner_dbu: NDArray[np.int64]
    layer: int
    datatype: int
    bias_dbu: int = 0
    tag: str = ""
    polygons: tuple[NDArray[np.int64], ...] | None = None
    turned: bool = False


def pillar_stamp(
    size_dbu: NDArray[np.int32],
    layer: int,
    datatype: int,
    dose_class: int = 0,
    bias_dbu: int = 0,
    outline: Outline = RECTANGLE,
) -> Stamp:
    """Centred pillars of one dose class, drawn with one bias."""
    drawn = size_dbu.astype(np.int64) + bias_dbu
    stamp = Stamp(
        drawn, -(drawn // 2), layer, datatype + dose_class, bias_dbu, f"_D{dose_class:02d}" if dose_class else ""
    )
    if outline.is_rectangle:
        return stamp
    polygons = outline.polygons(drawn)
    first = np.array([polygon[0] for polygon in polygons])
    return replace(
        stamp,
        corner_dbu=first,
        polygons=tuple(polygon - polygon[0] for polygon in polygons),
        turned=isinstance(outline, TurnedRectangles),
    )


def count_sizes(size_index: NDArray[np.uint16], sizes: int) -> NDArray[np.int64]:
    """How often each of ``sizes`` indices occurs, 0 for no pillar among them; shape (sizes,)."""
    if HAS_NUMBA:
        return _count_sizes(size_index, sizes)
    return np.bincount(size_index.ravel(), minlength=sizes)


@compiled
def _count_sizes(size_index: NDArray[np.uint16], sizes: int) -> NDArray[np.int64]:
    # np.bincount would make 64-bit integers of all of them first.
    count = np.zeros(sizes, dtype=np.int64)
    for i in range(size_index.shape[0]):
        for j in range(size_index.shape[1]):
            count[size_index[i, j]] += 1
    return count


def tile_cell(lattice: Lattice, tile: PillarTile, stamp: Stamp) -> TileCell:
    """Name and place, in its lens, of the cell of what is stamped on the sites of ``tile``."""
    (p_x, p_y), (n_y, n_x) = lattice.period_dbu, lattice.shape
    centre_x = (2 * tile.column - (n_x - 1)) * p_x // 2
    centre_y = (2 * tile.row - (n_y - 1)) * p_y // 2
    name = f"TILE_R{tile.row:06d}_C{tile.column:06d}{stamp.tag}{_bias_tag(stamp.bias_dbu)}"
    return TileCell(name, centre_x - p_x // 2, centre_y - p_y // 2, p_x // 2, p_y // 2)


def lens_name(bias_dbu: int, top: str) -> str:
    """The cell of a lens that the chip holds several copies of; never that of the top cell."""
    name = f"LENS{_bias_tag(bias_dbu)}"
    return f"{name}_" if name == top else name


def _bias_tag(bias_dbu: int) -> str:
    """Tells the cells of corner variants apart; empty without a bias, so that it changes no name."""
    return f"_{'P' if bias_dbu > 0 else 'M'}{abs(bias_dbu):05d}" if bias_dbu else ""


def top_name(design_name: str) -> str:
    """A design's name with the characters and the length that every GDSII reader takes."""
    return re.sub(r"[^A-Za-z0-9_]", "_", design_name)[:_LONGEST_NAME]
