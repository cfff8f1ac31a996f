"""Dose classes: each class of pillars has its own datatype."""

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

    The classes divide the range of areas, or of densities, over the whole mask evenly; they do not depend on tiles.

    Args:
        pillars: the drawn pillars; read once if classes go by density.
        dose: number and kind of the classes; None for a single class.
        outline: outline of the pillars, for their areas.
    """

    def __init__(self, pillars: PillarMap, dose: Dose | None, outline: Outline = RECTANGLE) -> None:
        self._count = 1 if dose is None else dose.classes
        self._of_size: NDArray[np.int64] | None = None
        if dose is None:
            return
        area = outline.area(pillars.size_dbu)
        if dose.by == "size":
            self._of_size = _classes(area, area[1:], dose.classes)
            return
        lattice = pillars.lattice
        period_nm = [period * lattice.database_unit_nm for period in lattice.period_dbu]
        self._block_columns, self._block_rows = [max(1, round(dose.block_um * 1e3 / side)) for side in period_nm]
        covered = np.zeros((-(-lattice.shape[0] // self._block_rows), -(-lattice.shape[1] // self._block_columns)))
        for tile in pillars.tiles():
            np.add.at(covered, self._blocks(tile), area[tile.size_index])
        self._of_block = _classes(covered, covered[covered > 0], dose.classes)

    def split(self, tile: PillarTile) -> Iterator[tuple[int, PillarTile]]:
        """Yield each class that occurs, and its pillars; a single class yields the tile itself."""
        if self._count == 1:
            yield 0, tile
            return
        index = tile.size_index
        classes = self._of_block[self._blocks(tile)] if self._of_size is None else self._of_size[index]
        for number in np.unique(classes[index > 0]).tolist():
            yield number, PillarTile(tile.row, tile.column, np.where(classes == number, index, np.uint16(0)))

    def _blocks(self, tile: PillarTile) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Density block of each row, shape (n_y, 1), and of each column, shape (1, n_x), of a tile."""
        n_y, n_x = tile.size_index.shape
        rows, columns = tile.row + np.arange(n_y), tile.column + np.arange(n_x)
        return (rows // self._block_rows)[:, None], (columns // self._block_columns)[None]


def _classes(value: FloatArray, of: FloatArray, count: int) -> NDArray[np.int64]:
    """Class of each value: the range of ``of``, divided into ``count`` equal parts."""
    low, high = (float(of.min()), float(of.max())) if of.size else (0.0, 0.0)
    if high <= low:
        return np.zeros(value.shape, dtype=np.int64)
    share = (value - low) / (high - low)
    return np.clip((share * count).astype(np.int64), 0, count - 1)
