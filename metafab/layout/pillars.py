"""Pillars as integers: a lattice, a table of sizes, and tiles of indices into it.

From the mapping on, every length is a whole number of database units (dbu). A pillar is a size index at a
lattice site; 25 million of them are arrays, never objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError

SizeIndexArray = NDArray[np.uint16]


@dataclass(frozen=True)
class Lattice:
    """A lattice whose centre is the optical axis: all sites of a rectangular grid, or every other one.

    A hexagonal lattice is the half of a rectangular grid whose row and column are both even or both odd, like the
    squares of one colour on a chessboard; its grid is half a period fine along x. So both kinds of lattice are arrays
    of sites at products of x and y, and rooms that add up pillars need not know which one it is.

    Attributes:
        period_dbu: (x, y) pitch of the grid of sites.
        shape: (n_y, n_x) sites of the grid.
        database_unit_nm: size of one dbu.
        hexagonal: whether only every other site can carry a pillar.
    """

    period_dbu: tuple[int, int]
    shape: tuple[int, int]
    database_unit_nm: float
    hexagonal: bool = False

    def __post_init__(self) -> None:
        for axis, period, count in zip("xy", self.period_dbu, self.shape[::-1], strict=True):
            if period % 2 and count % 2 == 0:
                raise InputError.single(
                    "mask",
                    "database_unit_nm",
                    f"a unit in which half the {axis} period is a whole number",
                    f"a period of {period} units",
                    "halve the unit, so that sites beside the axis stay exact",
                )

    @property
    def cell_dbu(self) -> tuple[int, int]:
        """(x, y) sides of the rectangle that belongs to one pillar; those of all pillars cover the plane once."""
        p_x, p_y = self.period_dbu
        return (2 * p_x, p_y) if self.hexagonal else (p_x, p_y)

    @property
    def cell_um2(self) -> float:
        """Area that belongs to one pillar."""
        return math.prod(side * self.database_unit_nm * 1e-3 for side in self.cell_dbu)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(rows, columns) from a site to half of its nearest neighbours: each pair of neighbours is one of them."""
        return ((0, 2), (1, 1), (1, -1)) if self.hexagonal else ((0, 1), (1, 0), (1, 1), (1, -1))

    @property
    def reach(self) -> tuple[int, int]:
        """(rows, columns) to the farthest of them."""
        return max(down for down, _ in self.pairs), max(right for _, right in self.pairs)

    def carries(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which sites of these rows and columns can carry a pillar, shape (rows, columns)."""
        if not self.hexagonal:
            return np.ones((rows.size, columns.size), dtype=np.bool_)
        return np.asarray((rows[:, None] + columns) % 2 == 0)

    def x_dbu(self) -> NDArray[np.int64]:
        """Site centres along x, shape (n_x,)."""
        return _centres(self.period_dbu[0], self.shape[1])

    def y_dbu(self) -> NDArray[np.int64]:
        """Site centres along y, shape (n_y,)."""
        return _centres(self.period_dbu[1], self.shape[0])

    def x_um(self) -> FloatArray:
        """Site centres along x in micrometres, shape (n_x,)."""
        return np.multiply(self.x_dbu(), self.database_unit_nm * 1e-3, dtype=np.float64)

    def y_um(self) -> FloatArray:
        """Site centres along y in micrometres, shape (n_y,)."""
        return np.multiply(self.y_dbu(), self.database_unit_nm * 1e-3, dtype=np.float64)


def _centres(period: int, count: int) -> NDArray[np.int64]:
    return (2 * np.arange(count, dtype=np.int64) - (count - 1)) * period // 2


@dataclass(frozen=True)
class PillarTile:
    """A rectangular block of sites.

    Attributes:
        row: lattice row of the tile's first row.
        column: lattice column of the tile's first column.
        size_index: shape (n_y, n_x); 0 means no pillar, i the i-th row of the map's size table.
    """

    row: int
    column: int
    size_index: SizeIndexArray


@dataclass(frozen=True)
class PillarMap:
    """All pillars of a lens, as a stream of tiles that can be read again and again.

    Attributes:
        lattice: where the sites are.
        size_dbu: shape (n_sizes + 1, 2), (width, length) of each size index; row 0 is (0, 0), no pillar.
        tiles: opens the stream; tiles cover the lattice once, row by row of tiles, empty ones may be left out.
        tile_sites: sites a side of a tile (edge tiles are smaller).
        whole: shape ``lattice.shape``, the indices of all tiles; None where these are held nowhere.
    """

    lattice: Lattice
    size_dbu: NDArray[np.int32]
    tiles: Callable[[], Iterator[PillarTile]]
    tile_sites: int
    whole: SizeIndexArray | None = None

    @classmethod
    def from_array(
        cls, lattice: Lattice, size_dbu: NDArray[np.int32], size_index: SizeIndexArray, tile_sites: int
    ) -> PillarMap:
        """A map over an array in memory (or on disk, memory-mapped) of shape ``lattice.shape``."""
        if size_index.shape != lattice.shape:
            raise ValueError(f"`size_index`: expected shape {lattice.shape}, got {size_index.shape}")

        def tiles() -> Iterator[PillarTile]:
            for row in range(0, lattice.shape[0], tile_sites):
                for column in range(0, lattice.shape[1], tile_sites):
                    block = size_index[row : row + tile_sites, column : column + tile_sites]
                    if block.any():
                        yield PillarTile(row, column, block)

        return cls(lattice, size_dbu, tiles, tile_sites, size_index)

    def to_array(self) -> SizeIndexArray:
        """All tiles as one array of shape ``lattice.shape`` (2 bytes a site); not to be written to."""
        if self.whole is not None:
            return self.whole
        whole = np.zeros(self.lattice.shape, dtype=np.uint16)
        for tile in self.tiles():
            n_y, n_x = tile.size_index.shape
            whole[tile.row : tile.row + n_y, tile.column : tile.column + n_x] = tile.size_index
        return whole

    def size_nm(self) -> FloatArray:
        """Width and length of each size in nanometres, shape (n_sizes + 1, 2)."""
        return np.multiply(self.size_dbu, self.lattice.database_unit_nm, dtype=np.float64)
