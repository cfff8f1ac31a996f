"""The field around the pillars as rectangles, for a positive resist: what is drawn goes, and the pillars stay.

Around a pillar its unit cell is left in four rectangles, below and above over the whole width of the cell, left and
right as long as the pillar; a site without one is left whole. They touch and never overlap, and each follows from the
size at its site, so that they are written like pillars.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.layout import PillarMap, PillarTile
from metafab.layout.pillars import SizeIndexArray
from metafab.mask.drawing.cells import Stamp
from metafab.mask.drawing.copies import LensCopy
from metafab.mask.shapes.hierarchy import IntArray

#: Rectangles that are left of a unit cell with a pillar.
RECTANGLES = 4


class InvertedField:
    """Stamps of the field around pillars, and the tiles that hold none.

    Args:
        pillars: the drawn pillars.
        layer: layer of the field; its datatype is 0.
        biases_dbu: biases of the copies of the lens.

    Raises:
        InputError: the lattice is hexagonal, or a pillar is wider than its cell.
    """

    def __init__(self, pillars: PillarMap, layer: int, biases_dbu: tuple[int, ...]) -> None:
        self._lattice, self._tile_sites = lattice, _ = pillars.lattice, pillars.tile_sites
        if lattice.hexagonal:
            expected = "a rectangular lattice, in whose cells the field is divided"
            raise InputError.single("mask", "tone", expected, "a hexagonal one", "use 'positive'")
        self._biases_dbu = biases_dbu
        self._stamps: list[Stamp] = []
        self._drawn: list[NDArray[np.bool_]] = []
        (p_x, p_y), (half_x, half_y) = lattice.period_dbu, (period // 2 for period in lattice.period_dbu)
        for bias_dbu in biases_dbu:
            # Row 0 is never drawn, row 1 is a site without pillar, row i + 1 size i.
            size = np.concatenate([np.zeros((1, 2), dtype=np.int64), pillars.size_dbu.astype(np.int64)])
            size[2:] += bias_dbu
            if np.any(size > lattice.period_dbu):
                got = f"{size.max() * lattice.database_unit_nm:g} nm"
                raise InputError.single("mask", "tone", "pillars within their cells", got, "use 'positive'")
            (w, h), zero = size.T // 2, np.zeros(len(size), dtype=np.int64)
            parts = (
                (zero - half_x, zero - half_y, zero + p_x, half_y - h),
                (zero - half_x, h, zero + p_x, p_y - half_y - h),
                (zero - half_x, -h, half_x - w, 2 * h),
                (w, -h, p_x - half_x - w, 2 * h),
            )
            for number, (x, y, width, height) in enumerate(parts):
                shape = np.stack([width, height], axis=1)
                stamp = Stamp(shape, np.stack([x, y], axis=1), layer, 0, bias_dbu, f"_F{number}")
                self._stamps.append(stamp)
                drawn = np.all(shape > 0, axis=1)
                drawn[0] = False
                self._drawn.append(drawn)

    def of(self, tile: PillarTile) -> Iterator[tuple[PillarTile, Stamp]]:
        """The field in a tile: indices and what they stand for."""
        shifted: SizeIndexArray = tile.size_index + np.uint16(1)
        for stamp, drawn in zip(self._stamps, self._drawn, strict=True):
            index = np.where(drawn[shifted], shifted, np.uint16(0))
            if index.any():
                yield PillarTile(tile.row, tile.column, index), stamp

    def count(self, used: NDArray[np.int64], seen: set[tuple[int, int]], copies: tuple[LensCopy, ...]) -> int:
        """Rectangles of the field of all copies.

        Args:
            used: sites of each size in the tiles ``seen``, shape (n_sizes + 1,); index 0 counts those without a pillar.
            seen: (row, column) of the tiles that hold pillars.
            copies: the lenses.
        """
        of_bias = dict.fromkeys(self._biases_dbu, 0)
        for stamp, drawn in zip(self._stamps, self._drawn, strict=True):
            of_bias[stamp.bias_dbu] += int(used @ drawn[1:])
        return sum(of_bias[copy.bias_dbu] for copy in copies) + len(self.without_pillars(seen, copies))

    def without_pillars(self, seen: set[tuple[int, int]], copies: tuple[LensCopy, ...]) -> IntArray:
        """Rectangles, shape (n, 4), of the tiles of every copy that are not among ``seen`` (row, column)."""
        lattice, step = self._lattice, self._tile_sites
        (n_y, n_x), (p_x, p_y) = lattice.shape, lattice.period_dbu
        left, bottom = (int(centres[0]) - p // 2 for centres, p in ((lattice.x_dbu(), p_x), (lattice.y_dbu(), p_y)))
        found = [
            (
                copy.x_dbu + left + column * p_x,
                copy.y_dbu + bottom + row * p_y,
                min(step, n_x - column) * p_x,
                min(step, n_y - row) * p_y,
            )
            for copy in copies
            for row in range(0, n_y, step)
            for column in range(0, n_x, step)
            if (row, column) not in seen
        ]
        return np.array(found, dtype=np.int64).reshape(-1, 4)
