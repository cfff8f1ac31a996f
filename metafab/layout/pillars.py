"""Pillars as integers: a lattice, a table of sizes, and tiles of indices into it.

From the mapping on, every length is a whole number of database units (dbu). A pillar is a size index at a
lattice site; 25 million of them are arrays, never objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed, dataset
from metafab.core.errors import InputError
from metafab.core.parallel.executor import in_order
from metafab.core.storage.scratch import release
from metafab.layout.outlines import RECTANGLE, Outline

if TYPE_CHECKING:
    import gdstk
    import xarray

SizeIndexArray = NDArray[np.uint16]
Result = TypeVar("Result")
#: Rows of the lattice that are held in memory at a time.
_BAND_ROWS = 512


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """A lattice centred on the optical axis: all sites of a rectangular grid, or every other one.

    A hexagonal lattice consists of the grid sites whose row and column are both even or both odd, like the squares of
    one colour on a chessboard; the grid's pitch along x is half a period. Both kinds are thus rectangular arrays of
    sites, and code that sums over pillars need not distinguish them. InputError for an odd period with an even number
    of sites, which puts sites on half units.
    """

    period_dbu: tuple[int, int]  #: (x, y) pitch of the grid.
    shape: tuple[int, int]  #: (n_y, n_x) sites of the grid.
    database_unit_nm: float  #: Size of one database unit.
    hexagonal: bool = False  #: Whether only every other site can carry a pillar.

    def __post_init__(self) -> None:
        for axis, period, count in zip("xy", self.period_dbu, self.shape[::-1], strict=True):
            if period % 2 and count % 2 == 0:
                expected = f"a unit in which half the {axis} period is a whole number"
                remedy = "halve the unit, so that the sites next to the axis stay exact"
                raise InputError.single("mask", "database_unit_nm", expected, f"a period of {period} units", remedy)

    @property
    def period_nm(self) -> tuple[float, float]:
        """(x, y) pitch of the grid."""
        return self.period_dbu[0] * self.database_unit_nm, self.period_dbu[1] * self.database_unit_nm

    @property
    def cell_dbu(self) -> tuple[int, int]:
        """(x, y) sides of the rectangle that belongs to one pillar; these rectangles tile the plane."""
        p_x, p_y = self.period_dbu
        return (2 * p_x, p_y) if self.hexagonal else (p_x, p_y)

    @property
    def cell_um2(self) -> float:
        """Area that belongs to one pillar."""
        return math.prod(side * self.database_unit_nm * 1e-3 for side in self.cell_dbu)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(rows, columns) from a site to half of its nearest neighbours: each pair of neighbours occurs once."""
        return ((0, 2), (1, 1), (1, -1)) if self.hexagonal else ((0, 1), (1, 0), (1, 1), (1, -1))

    @property
    def spacing_nm(self) -> float:
        """Least distance between two pillars' centres."""
        return min(math.hypot(right * self.period_nm[0], down * self.period_nm[1]) for down, right in self.pairs)

    @property
    def reach(self) -> tuple[int, int]:
        """(rows, columns) to the farthest of the nearest neighbours."""
        return max(down for down, _ in self.pairs), max(right for _, right in self.pairs)

    def carries(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether sites of some rows, shape (n_rows,), and columns can carry a pillar: shape (n_rows, n_columns)."""
        if not self.hexagonal:
            return np.ones((rows.size, columns.size), dtype=np.bool_)
        return np.asarray((rows[:, None] + columns) % 2 == 0)

    def tile_corners(self, tile_sites: int) -> Iterator[tuple[int, int]]:
        """(row, column) of the first site of each square tile, row by row; tiles at the edges are smaller."""
        for row in range(0, self.shape[0], tile_sites):
            for column in range(0, self.shape[1], tile_sites):
                yield row, column

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
    """A rectangular block of sites."""

    row: int  #: Lattice row of the first row of the tile.
    column: int  #: Lattice column of the first column of the tile.
    size_index: SizeIndexArray  #: Shape (n_y, n_x); 0 means no pillar, i the i-th row of the map's size table.

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the tile in an array over the whole lattice."""
        n_y, n_x = self.size_index.shape
        return slice(self.row, self.row + n_y), slice(self.column, self.column + n_x)


@dataclass(frozen=True, repr=False)
class PillarMap(Displayed):
    """All pillars of a lens, as a stream of tiles that can be read repeatedly.

    Attributes:
        lattice: lattice of the sites.
        size_dbu: shape (n_sizes + 1, 2), (width, length) of each size index; row 0 is (0, 0), no pillar.
        tiles: opens the stream; tiles cover the lattice once, row by row of tiles; empty tiles may be left out.
        tile_sites: sites per side of a tile (tiles at the edges are smaller).
        whole: shape ``lattice.shape``, the indices of all tiles, in memory or on disk; None if they are not kept.
        angle_deg: shape (n_sizes + 1,), counter-clockwise turn of each size about its site; None for upright pillars.
        remapped: maps all tiles anew and yields a function of each, as :meth:`apply`; None if the tiles are kept.
    """

    lattice: Lattice
    size_dbu: NDArray[np.int32]
    tiles: Callable[[], Iterator[PillarTile]]
    tile_sites: int
    whole: SizeIndexArray | None = None
    angle_deg: FloatArray | None = None
    remapped: Callable[[Callable[[PillarTile], Any], Executor, int], Iterator[Any]] | None = None

    @classmethod
    def from_array(
        cls,
        lattice: Lattice,
        size_dbu: NDArray[np.int32],
        size_index: SizeIndexArray,
        tile_sites: int,
        angle_deg: FloatArray | None = None,
    ) -> PillarMap:
        """Make a map from an array of the shape ``lattice.shape`` (else ValueError), in memory or on disk."""
        if size_index.shape != lattice.shape:
            raise ValueError(f"`size_index`: expected shape {lattice.shape}, got {size_index.shape}")

        def tiles() -> Iterator[PillarTile]:
            for row, column in lattice.tile_corners(tile_sites):
                if column == 0:
                    release(size_index)
                block = size_index[row : row + tile_sites, column : column + tile_sites]
                if block.any():
                    yield PillarTile(row, column, block)

        return cls(lattice, size_dbu, tiles, tile_sites, size_index, angle_deg)

    def apply(self, function: Callable[[PillarTile], Result], executor: Executor, ahead: int) -> Iterator[Result]:
        """Yield ``function`` of each tile in order, at most ``ahead`` in flight; tiles without pillars may be left out.

        Tiles that are not kept are mapped by the call that applies the function, so that they do not travel.
        """
        if self.remapped is not None:
            return self.remapped(function, executor, ahead)
        return in_order(executor, function, (tile for tile in self.tiles() if tile.size_index.any()), ahead=ahead)

    def to_array(self) -> SizeIndexArray:
        """All tiles as one array of shape ``lattice.shape`` (2 bytes per site); read-only by agreement."""
        if self.whole is not None:
            return self.whole
        whole = np.zeros(self.lattice.shape, dtype=np.uint16)
        for tile in self.tiles():
            whole[tile.window] = tile.size_index
        return whole

    def bands(self, rows: int) -> Iterator[tuple[int, SizeIndexArray]]:
        """First row and indices of every ``rows`` rows of sites, shape (rows + 1, n_x), the next row included.

        The last band may be shorter. A map on disk takes the memory of a few bands.
        """
        whole = self.to_array()
        for row in range(0, len(whole), rows):
            yield row, whole[row : row + rows + 1]
            release(whole)

    def numbers(self) -> NDArray[np.int64]:
        """Number of pillars of each size, shape (n_sizes + 1,); 0 for no pillar."""
        numbers = np.zeros(len(self.size_dbu), dtype=np.int64)
        for tile in self.tiles():
            numbers += np.bincount(tile.size_index.ravel(), minlength=numbers.size)
        numbers[0] = 0
        return numbers

    def size_nm(self) -> FloatArray:
        """Width and length of each size in nanometres, shape (n_sizes + 1, 2)."""
        return np.multiply(self.size_dbu, self.lattice.database_unit_nm, dtype=np.float64)

    def key_figures(self) -> dict[str, str]:
        """Sites, period and sizes."""
        unit_nm = self.lattice.database_unit_nm
        period = " x ".join(f"{side * unit_nm:g}" for side in self.lattice.cell_dbu)
        return {
            "sites": " x ".join(str(count) for count in self.lattice.shape),
            "period": f"{period} nm",
            "sizes": str(len(self.size_dbu) - 1),
        }

    def to_xarray(self) -> xarray.Dataset:
        """Width and length of every pillar over (y_um, x_um), NaN where none stands; 8 bytes per site.

        MissingToolError without xarray.
        """
        axes, index = ("y_um", "x_um"), self.to_array()
        sizes = np.where(self.size_dbu > 0, self.size_nm(), np.nan).astype(np.float32)
        variables = {name: (axes, sizes[index, k], "nm") for k, name in enumerate(("width_nm", "length_nm"))}
        return dataset(variables, {"y_um": self.lattice.y_um(), "x_um": self.lattice.x_um()})

    def to_gdstk(
        self, name: str = "lens", *, layer: int = 1, datatype: int = 0, outline: Outline = RECTANGLE
    ) -> gdstk.Cell:
        """Return the pillars as a gdstk cell centred on the optical axis, in micrometres: one polygon a size.

        Each polygon carries its places as a repetition. For chips composed with gdstk or gdsfactory, up to some million
        pillars; ``metafab.mask.write`` streams any number to a file. The outline is that of ``Outline.of(design)``.
        """
        import gdstk

        unit_um, index = 1e-3 * self.lattice.database_unit_nm, self.to_array()
        x_um, y_um = self.lattice.x_um(), self.lattice.y_um()
        rows, columns = np.nonzero(index)
        order = np.argsort(index[rows, columns], kind="stable")
        centres_um = np.stack([x_um[columns[order]], y_um[rows[order]]], axis=1)
        sizes, firsts = np.unique(index[rows, columns][order], return_index=True)
        cell = gdstk.Cell(name)
        parts = np.split(centres_um, firsts[1:]) if sizes.size else []
        for size, places in zip(sizes.tolist(), parts, strict=True):
            corners_um = (outline.vertices(*self.size_dbu[size].tolist()) * unit_um).tolist()
            polygon = gdstk.Polygon(corners_um, layer, datatype)
            if self.angle_deg is not None:
                polygon.rotate(math.radians(self.angle_deg[size]))
            polygon.translate(*places[0])
            if len(places) > 1:
                # Offsets in two columns: from lists along one axis gdstk writes OASIS that KLayout refuses.
                polygon.repetition = gdstk.Repetition(offsets=places[1:] - places[0])
            cell.add(polygon)
        return cell


def bands(size_index: NDArray[np.uint16]) -> Iterator[slice]:
    """Yield bands of rows that cover a lattice whose size indices have the shape (n_y, n_x)."""
    for row in range(0, size_index.shape[0], _BAND_ROWS):
        yield slice(row, min(row + _BAND_ROWS, size_index.shape[0]))


def resized(pillars: PillarMap, sizes_nm: Callable[[slice], FloatArray], step_dbu: int = 1) -> PillarMap:
    """Return the pillars with other sizes, rounded to steps of the database unit.

    Args:
        pillars: upright pillars whose sites are kept.
        sizes_nm: returns the widths and lengths of a band of rows, shape (2, n_rows, n_x); a value that is not finite
            or rounds to 0 leaves the site empty. Values at sites without a pillar are ignored. It is called twice for
            each band, and again for each doubling of the step.
        step_dbu: sizes are whole multiples of this number of database units. The step is doubled until at most 65 535
            sizes are left.
    """
    lattice, index = pillars.lattice, pillars.to_array()
    while True:
        step_nm = step_dbu * lattice.database_unit_nm
        across = max(lattice.cell_dbu) // step_dbu + 1
        used = np.zeros(across * across, dtype=bool)
        for rows in bands(index):
            used[_keys(index[rows], sizes_nm(rows), step_nm, across)] = True
        used[0] = False
        sizes = np.flatnonzero(used)
        if sizes.size <= np.iinfo(np.uint16).max:
            break
        step_dbu *= 2
    number = np.zeros(used.size, dtype=np.uint16)
    number[sizes] = np.arange(1, sizes.size + 1)
    new_index = np.zeros(lattice.shape, dtype=np.uint16)
    for rows in bands(index):
        new_index[rows] = number[_keys(index[rows], sizes_nm(rows), step_nm, across)]
    size_dbu = np.concatenate([[(0, 0)], step_dbu * np.stack(np.divmod(sizes, across), axis=1)]).astype(np.int32)
    return PillarMap.from_array(lattice, size_dbu, new_index, pillars.tile_sites)


def _keys(size_index: NDArray[np.uint16], sizes_nm: FloatArray, step_nm: float, across: int) -> NDArray[np.int64]:
    """One number for each rounded size, 0 without a pillar; larger sizes are cut to the unit cell."""
    stand = (size_index > 0) & np.isfinite(sizes_nm).all(axis=0)
    steps = np.rint(np.where(stand, sizes_nm, 0.0) / step_nm).astype(np.int64)
    steps = np.clip(steps, 0, across - 1)
    return np.asarray(np.where((steps > 0).all(axis=0), steps[0] * across + steps[1], 0))
