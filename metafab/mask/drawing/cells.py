"""Cells of tiles, and the shapes that are stamped on their sites; both formats share them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import Lattice, PillarTile
from metafab.layout.turned import TurnedRectangles
from metafab.mask.drawing.copies import PLAIN, Variant

_LONGEST_NAME = 32  # Every GDSII reader takes names of this length.


@dataclass(frozen=True)
class TileCell:
    """The cell of one tile; its origin is the lower left corner of its first unit cell."""

    name: str  #: Cell name.
    x_dbu: int  #: x at which the lens places the origin.
    y_dbu: int  #: y at which the lens places the origin.
    first_x_dbu: int  #: x of the first site, relative to the origin.
    first_y_dbu: int  #: y of the first site, relative to the origin.

    def flattened(self, x_dbu: int, y_dbu: int) -> TileCell:
        """Return the cell with its origin moved to that of the top cell, for the lens at (x_dbu, y_dbu)."""
        first_x_dbu, first_y_dbu = self.x_dbu + self.first_x_dbu + x_dbu, self.y_dbu + self.first_y_dbu + y_dbu
        return TileCell(self.name, 0, 0, first_x_dbu, first_y_dbu)


@dataclass(frozen=True)
class Stamp:
    """The rectangle or polygon that is drawn at a site, for each size index."""

    size_dbu: NDArray[np.int64]  #: Shape (n_sizes + 1, 2), width and length; row 0 is never drawn.
    #: Shape (n_sizes + 1, 2), from the site to the lower left corner of a rectangle, or to the first corner of a
    #: polygon.
    corner_dbu: NDArray[np.int64]
    layer: int  #: GDSII or OASIS layer.
    datatype: int  #: GDSII or OASIS datatype.
    variant: Variant = PLAIN  #: Bias and dose of the copies of the lens that the shapes belong to.
    tag: str = ""  #: Suffix that distinguishes the cells of one tile; stamps with equal suffixes share a cell.
    #: Corners of each size relative to its first corner, shape (n, 2) each; None for rectangles.
    polygons: tuple[NDArray[np.int64], ...] | None = None
    turned: bool = False  #: Whether several polygons share one width and length, at different angles.


def pillar_stamp(
    size_dbu: NDArray[np.int32],
    layer: int,
    datatype: int,
    dose_class: int = 0,
    variant: Variant = PLAIN,
    outline: Outline = RECTANGLE,
) -> Stamp:
    """Return the stamp of centred pillars of one dose class and one variant (bias and dose) of the lens.

    Sizes, shape (n_sizes + 1, 2), are without the bias; row 0 means no pillar. ``datatype`` is that of dose class 0 of
    the variant; the others follow.
    """
    drawn = size_dbu.astype(np.int64) + variant.bias_dbu
    stamp = Stamp(drawn, -(drawn // 2), layer, datatype + dose_class, variant)
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


def tile_cell(lattice: Lattice, tile: PillarTile, stamp: Stamp) -> TileCell:
    """Cell name and origin, in its lens, for the shapes of ``stamp`` on the sites of ``tile``."""
    (p_x, p_y), (n_y, n_x) = lattice.period_dbu, lattice.shape
    centre_x = (2 * tile.column - (n_x - 1)) * p_x // 2
    centre_y = (2 * tile.row - (n_y - 1)) * p_y // 2
    name = f"TILE_R{tile.row:06d}_C{tile.column:06d}{stamp.tag}{stamp.variant.tag}"
    return TileCell(name, centre_x - p_x // 2, centre_y - p_y // 2, p_x // 2, p_y // 2)


def lens_name(variant: Variant, top: str) -> str:
    """Cell name of a lens that the chip holds several copies of; never equal to the name ``top`` of the top cell."""
    name = f"LENS{variant.tag}"
    return f"{name}_" if name == top else name


def top_name(design_name: str) -> str:
    """Return a design's name in the characters and the length that every GDSII reader takes."""
    return re.sub(r"[^A-Za-z0-9_]", "_", design_name)[:_LONGEST_NAME]
