"""The inverted mask for a positive resist: the field around the pillars as rectangles.

A unit cell with a pillar leaves four rectangles: below and above the pillar over the whole width of the cell, left and
right over its length. A cell without a pillar is one rectangle. The rectangles touch and never overlap. Each follows
from the size at its site, so that they are written like pillars.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.layout import PillarMap, PillarTile
from metafab.layout.pillars import SizeIndexArray
from metafab.mask.drawing.cells import Stamp
from metafab.mask.drawing.copies import LensCopy, Variant
from metafab.mask.shapes.hierarchy import IntArray

#: Rectangles that a unit cell with a pillar leaves, at most.
FIELD_RECTANGLES = 4


class InvertedField:
    """Stamps of the field around pillars, for each bias of the copies, and rectangles of tiles without pillars.

    The layer's datatype is 0. InputError if the lattice is hexagonal, or a pillar is wider than its cell.
    """

    def __init__(self, pillars: PillarMap, layer: int, biases_dbu: tuple[int, ...]) -> None:
        self._lattice, self._tile_sites = lattice, _ = pillars.lattice, pillars.tile_sites
        if lattice.hexagonal:
            expected = "a rectangular lattice, in whose cells the field is divided"
            raise InputError.single("mask", "tone", expected, "a hexagonal one", "use 'positive'")
        self._stamps: list[Stamp] = []
        # For each stamp, the indices whose rectangle is not empty.
        self._drawn: list[NDArray[np.bool_]] = []
        p_x, p_y = lattice.period_dbu
        half_x, half_y = p_x // 2, p_y // 2
        for bias_dbu in biases_dbu:
            # Row 0 is never drawn, row 1 is a site without a pillar, row i + 1 is size i.
            size = np.concatenate([np.zeros((1, 2), dtype=np.int64), pillars.size_dbu.astype(np.int64)])
            size[2:] += bias_dbu
            if np.any(size > lattice.period_dbu):
                got = f"{size.max() * lattice.database_unit_nm:g} nm"
                raise InputError.single("mask", "tone", "pillars within their cells", got, "use 'positive'")
            (w, h), zero = size.T // 2, np.zeros(len(size), dtype=np.int64)
            below = (zero - half_x, zero - half_y, zero + p_x, half_y - h)
            above = (zero - half_x, h, zero + p_x, p_y - half_y - h)
            left = (zero - half_x, -h, half_x - w, 2 * h)
            right = (w, -h, p_x - half_x - w, 2 * h)
            for number, (x, y, width, height) in enumerate((below, above, left, right)):
                shape = np.stack([width, height], axis=1)
                stamp = Stamp(shape, np.stack([x, y], axis=1), layer, 0, Variant(bias_dbu), f"_F{number}")
                self._stamps.append(stamp)
                drawn = np.all(shape > 0, axis=1)
                drawn[0] = False
                self._drawn.append(drawn)

    def of(self, tile: PillarTile) -> Iterator[tuple[PillarTile, Stamp]]:
        """Yield the field of a tile: indices, and the stamp to which they refer."""
        shifted: SizeIndexArray = tile.size_index + np.uint16(1)
        for stamp, drawn in zip(self._stamps, self._drawn, strict=True):
            index = np.where(drawn[shifted], shifted, np.uint16(0))
            if index.any():
                yield PillarTile(tile.row, tile.column, index), stamp

    def count(self, used: NDArray[np.int64], filled: set[tuple[int, int]], copies: tuple[LensCopy, ...]) -> int:
        """Count the rectangles of the field over all copies.

        ``used``, shape (n_sizes + 1,), is the number of sites of each size in the ``filled`` tiles, (row, column).
        """
        total = len(self.without_pillars(filled, copies))
        for stamp, drawn in zip(self._stamps, self._drawn, strict=True):
            lenses = sum(copy.variant == stamp.variant for copy in copies)
            total += lenses * int(used @ drawn[1:])
        return total

    def without_pillars(self, filled: set[tuple[int, int]], copies: tuple[LensCopy, ...]) -> IntArray:
        """One rectangle for each tile of each copy that is not among ``filled`` (row, column); shape (n, 4)."""
        lattice, step = self._lattice, self._tile_sites
        (n_y, n_x), (p_x, p_y) = lattice.shape, lattice.period_dbu
        left, bottom = int(lattice.x_dbu()[0]) - p_x // 2, int(lattice.y_dbu()[0]) - p_y // 2
        rectangles = []
        for copy in copies:
            for row, column in lattice.tile_corners(step):
                if (row, column) not in filled:
                    x, y = copy.x_dbu + left + column * p_x, copy.y_dbu + bottom + row * p_y
                    rectangles.append((x, y, min(step, n_x - column) * p_x, min(step, n_y - row) * p_y))
        return np.array(rectangles, dtype=np.int64).reshape(-1, 4)
