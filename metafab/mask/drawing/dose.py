"""Which dose class, and so which datatype, each pillar of a mask is written on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.layout import PillarMap, PillarTile
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.spec import Dose


class DoseClasses:
    """Splits tiles by dose class.

    Classes divide evenly the range of what they go by, over the whole mask, so that they know nothing of tiles.

    Args:
        pillars: the drawn pillars; read once where classes go by density.
        dose: how many classes, by what; None for a single one.
        outline: of the pillars, for their areas.
    """

    def __init__(self, pillars: PillarMap, dose: Dose | None, outline: Outline = RECTANGLE) -> None:
        self._count = 1 if dose is None else dose.classes
        self._of_size: NDArray[np.int64] | None = None
        self._of_block: NDArray[np.int64] | None = None
        if dose is None:
            return
        area = outline.area(pillars.size_dbu)
        if dose.by == "size":
            self._of_size = _classes(area, area[1:], dose.classes)
            return
        lattice = pillars.lattice
        self._block = [
            max(1, round(dose.block_um * 1e3 / (period * lattice.database_unit_nm)))
            for period in reversed(lattice.period_dbu)
        ]
        covered = np.zeros([-(-n // b) for n, b in zip(lattice.shape, self._block, strict=True)])
        for tile in pillars.tiles():
            rows, columns = self._blocks(tile)
            np.add.at(covered, (rows[:, None], columns[None, :]), area[tile.size_index])
        self._of_block = _classes(covered, covered[covered > 0], dose.classes)

    def split(self, tile: PillarTile) -> Iterator[tuple[int, PillarTile]]:
        """(class, the pillars of ``tile`` in it) for each class that occurs; one tile as it is without classes."""
        if self._count == 1:
            yield 0, tile
            return
        index = tile.size_index
        if self._of_size is not None:
            classes = self._of_size[index]
        else:
            assert self._of_block is not None
            rows, columns = self._blocks(tile)
            classes = self._of_block[rows[:, None], columns[None, :]]
        for number in np.unique(classes[index > 0]).tolist():
            part = np.where(classes == number, index, np.uint16(0))
            yield number, PillarTile(tile.row, tile.column, part)

    def _blocks(self, tile: PillarTile) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Block of each row and of each column of a tile."""
        n_y, n_x = tile.size_index.shape
        return (tile.row + np.arange(n_y)) // self._block[0], (tile.column + np.arange(n_x)) // self._block[1]


def _classes(value: FloatArray, of: FloatArray, count: int) -> NDArray[np.int64]:
    """Class of each value: ``count`` equal parts of the range of ``of``."""
    low, high = (float(of.min()), float(of.max())) if of.size else (0.0, 0.0)
    if high <= low:
        return np.zeros(value.shape, dtype=np.int64)
    share = (value - low) / (high - low)
    return np.clip((share * count).astype(np.int64), 0, count - 1)
