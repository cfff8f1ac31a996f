"""Field behind the pillars of a mask, each among its own neighbours.

Solving takes some 3 us a pillar, and PSF, focus, aberrations and chain of losses each pass over all pillars. The first
complete pass therefore keeps the amplitudes in a scratch file, and later ones read them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import in_order, open_threads
from metafab.core.storage.scratch import release, scratch
from metafab.layout.pillars import Lattice, PillarMap, PillarTile, SizeIndexArray
from metafab.library.library import Library
from metafab.library.neighbours import require_neighbours
from metafab.library.neighbours.mask.windows import HALO_SITES, NeighbourTables
from metafab.library.use.amplitudes import half_space_indices
from metafab.optics.point_spread import NeighbourMap
from metafab.optics.sources.source import FieldTile, WrittenField, written_field

#: Sites of a tile along x and y. It is solved with 24 more sites on all four sides, which cost a tenth more time.
_TILE_SITES = 512
#: Most bytes of amplitudes that are kept, those of a lens of 4 mm at the paper's period. Beyond, every pass solves.
_MOST_KEPT_BYTES = 1 << 31
#: Most blocks along a side of the map of the change by neighbours, and least sites of a block, about a period of Shen's
#: lens. Blocks divide tiles.
_MAP_BLOCKS, _BLOCK_SITES = 80, 16
#: Windows that are drawn for each one that is wanted, as some meet the rim or gaps.
_DRAWN = 8
#: Steps along y and x whose multiples, modulo 1, are spread evenly: powers of the inverse of the plastic number, the
#: counterpart of the golden ratio in two dimensions.
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532])
#: Largest kept amplitudes that stay in memory, bytes.
_IN_MEMORY_BYTES = 1 << 26


@dataclass
class _Kept:
    """Results of the first complete pass over the tiles."""

    #: Single precision, shape (2, n_y, n_x), in a file if large; None before that pass.
    amplitudes: NDArray[np.complex64] | None = None
    places: list[tuple[int, int]] = field(default_factory=list)  #: (row, column) of the tiles with pillars.
    change: NeighbourMap | None = None  #: Change of the light by neighbours; None before that pass.


@dataclass(frozen=True)
class NeighbourField:
    """Pillars of a mask with the amplitudes that they have among their neighbours."""

    lone: WrittenField  #: The same pillars with the amplitudes of lattices of equal pillars.
    tables: NeighbourTables  #: Chains of coupled modes at the sizes of the mask.
    power_factor: tuple[float, float]  #: sqrt(n_out / n_in) for x and y polarisation.
    workers: int | None = None  #: Threads; None for one per core.
    _kept: _Kept = field(default_factory=_Kept, init=False, repr=False, compare=False)

    @property
    def lattice(self) -> Lattice:
        """Lattice of the pillars."""
        return self.lone.lattice

    @property
    def pillars(self) -> PillarMap:
        """Pillars of the mask."""
        return self.lone.pillars

    @property
    def change(self) -> NeighbourMap | None:
        """Change of the light by the neighbours; None before the first complete pass over the tiles."""
        return self._kept.change

    def tiles(self) -> Iterator[FieldTile]:
        """Return the tiles with pillars, solved on the first pass; the number of threads does not change amplitudes."""
        if self._kept.amplitudes is not None:
            yield from self._kept_tiles(self._kept.amplitudes)
            return
        amplitudes, block = self._scratch(), self._block_sites()
        sums = np.zeros((4, 2, *(-(-count // block) for count in self.lattice.shape)))
        places: list[tuple[int, int]] = []
        with open_threads(self.workers) as threads:
            for tile, parts in in_order(threads, self._tile, size_windows(self.pillars, HALO_SITES), ahead=4):
                (row, column), (height, width) = (tile.row // block, tile.column // block), parts.shape[2:]
                sums[:, :, row : row + height, column : column + width] = parts
                if amplitudes is not None:
                    amplitudes[_sites(tile.row, tile.column)] = tile.amplitudes
                    if places and places[-1][0] != tile.row:
                        release(amplitudes)
                    places.append((tile.row, tile.column))
                yield tile
        self._kept.amplitudes, self._kept.places, self._kept.change = amplitudes, places, self._map(sums)

    def _scratch(self) -> NDArray[np.complex64] | None:
        """Array for the amplitudes of all sites; None if they are too many, or the disk is too full for them."""
        shape = (2, *self.lattice.shape)
        if math.prod(shape) * np.dtype(np.complex64).itemsize > _MOST_KEPT_BYTES:
            return None
        with suppress(OSError):
            return scratch(shape, np.complex64, _IN_MEMORY_BYTES)
        return None

    def _kept_tiles(self, amplitudes: NDArray[np.complex64]) -> Iterator[FieldTile]:
        last = 0
        for row, column in self._kept.places:
            if row != last:
                release(amplitudes)
                last = row
            yield FieldTile(row, column, amplitudes=amplitudes[_sites(row, column)].astype(np.complex128))

    def _block_sites(self) -> int:
        """Sites along a side of a block of the map, a power of two."""
        sites = max(_BLOCK_SITES, -(-max(self.lattice.shape) // _MAP_BLOCKS))
        return min(_TILE_SITES, 1 << (sites - 1).bit_length())

    def _map(self, sums: FloatArray) -> NeighbourMap:
        """Map of the change from the sums of :func:`_block_sums` over all blocks."""
        change, lone, real, imaginary = sums
        with np.errstate(invalid="ignore"):
            shares = np.sqrt(change / lone), (real**2 + imaginary**2) / lone**2
        axes = self.lattice.x_um(), self.lattice.y_um()
        block = self._block_sites()
        x_um, y_um = (np.array([part.mean() for part in np.split(at, range(block, at.size, block))]) for at in axes)
        return NeighbourMap(x_um, y_um, *shares)

    def _tile(self, window: tuple[int, int, SizeIndexArray]) -> tuple[FieldTile, FloatArray]:
        """Amplitudes of a tile, and the sums of its blocks."""
        row, column, size_index = window
        inner = size_index[HALO_SITES:-HALO_SITES, HALO_SITES:-HALO_SITES]
        lone = np.ascontiguousarray(np.moveaxis(self.lone.table[inner], -1, 0))
        amplitudes = lone.copy()
        for polarisation in (0, 1):
            amplitudes[polarisation] += self.power_factor[polarisation] * self.tables.corrections(
                size_index, polarisation
            )
        # Rounded as they are kept, so that every pass gives the same amplitudes.
        amplitudes = _passive(amplitudes).astype(np.complex64).astype(np.complex128)
        return FieldTile(row, column, amplitudes=amplitudes), _block_sums(amplitudes, lone, self._block_sites())


def neighbour_field(pillars: PillarMap, library: Library, workers: int | None = None) -> NeighbourField:
    """Return the field behind the pillars of a mask by the library's model of unlike neighbours.

    ``workers`` is a number of threads (None: one per core). InputError if the library has no such model, lacks a size
    of the mask, or the pillars are turned or hexagonal.
    """
    neighbours = require_neighbours(library)
    if pillars.angle_deg is not None or pillars.lattice.hexagonal:
        got = "turned pillars" if pillars.angle_deg is not None else "a hexagonal lattice"
        remedy = "set `neighbours = false` in `[optics]`"
        raise InputError.single("optics", "neighbours", "upright pillars in a rectangular lattice", got, remedy)
    n_in, n_out = half_space_indices(library.unit_cell)
    factor = np.sqrt(n_out.real / n_in.real)
    tables = NeighbourTables.of(neighbours, pillars.size_nm())
    return NeighbourField(written_field(pillars, library), tables, (float(factor[0]), float(factor[1])), workers)


def size_windows(pillars: PillarMap, halo: int) -> Iterator[tuple[int, int, SizeIndexArray]]:
    """Row and column of each tile of n_y x n_x sites with pillars, and its size indices with ``halo`` more a side.

    The indices have the shape (n_y + 2 halo, n_x + 2 halo).
    """
    n_y, n_x = pillars.lattice.shape
    for row, band in _bands(pillars, _TILE_SITES, halo):
        height, inner = min(_TILE_SITES, n_y - row), slice(halo, -halo or None)
        wide = np.pad(band[: height + 2 * halo], ((0, 0), (halo, halo)))
        for column in range(0, n_x, _TILE_SITES):
            window = wide[:, column : min(column + _TILE_SITES, n_x) + 2 * halo]
            if window[inner, inner].any():
                yield row, column, window


def filled_windows(pillars: PillarMap, count: int, sites: int) -> FloatArray:
    """Sizes of windows of sites with a pillar each, spread evenly over the mask, shape (windows, sites, sites, 2).

    At most ``count`` windows; fewer where most of a mask, such as a thin ring, holds no such window.
    """
    n_y, n_x = pillars.lattice.shape
    steps = np.arange(1, _DRAWN * count + 1)[:, None] * _SPREAD % 1.0
    corners = (steps * np.maximum([n_y - sites + 1, n_x - sites + 1], 1)).astype(np.intp)
    index = np.zeros((len(corners), sites, sites), dtype=np.uint16)
    for tile in pillars.tiles():
        height, width = tile.size_index.shape
        for window, (row, column) in zip(index, corners - (tile.row, tile.column), strict=True):
            if -sites < row < height and -sites < column < width:
                top, left = max(row, 0), max(column, 0)
                found = tile.size_index[top : row + sites, left : column + sites]
                window[top - row :, left - column :][: found.shape[0], : found.shape[1]] = found
    return pillars.size_nm()[index[index.all(axis=(1, 2))][:count]]


def _sites(row: int, column: int) -> tuple[slice, slice, slice]:
    """Both polarisations of the tile whose first site is (row, column)."""
    return np.s_[:, row : row + _TILE_SITES, column : column + _TILE_SITES]


def _bands(pillars: PillarMap, sites: int, halo: int) -> Iterator[tuple[int, SizeIndexArray]]:
    """First row and size indices, shape (sites + 2 halo, n_x), of bands of rows with their neighbours on both sides.

    Rows outside the lattice hold no pillars. At most two bands and one row of tiles are in memory.
    """
    n_y, n_x = pillars.lattice.shape
    tiles = pillars.tiles()
    pending: list[PillarTile] = []
    for row in range(0, n_y, sites):
        first, last = row - halo, row + sites + halo
        while not pending or pending[-1].row < last:
            following = next(tiles, None)
            if following is None:
                break
            pending.append(following)
        pending = [tile for tile in pending if tile.row + tile.size_index.shape[0] > first]
        band = np.zeros((sites + 2 * halo, n_x), dtype=np.uint16)
        for tile in pending:
            top, bottom = max(tile.row, first), min(tile.row + tile.size_index.shape[0], last)
            if top < bottom:
                columns = slice(tile.column, tile.column + tile.size_index.shape[1])
                band[top - first : bottom - first, columns] = tile.size_index[top - tile.row : bottom - tile.row]
        yield row, band


def _block_sums(amplitudes: ComplexArray, lone: ComplexArray, block: int) -> FloatArray:
    """Sums over blocks of |a - b|^2, |b|^2, Re a b* and Im a b*, shape (4, 2, blocks_y, blocks_x).

    ``amplitudes`` a and ``lone`` b have the shape (2, n_y, n_x).
    """
    product = amplitudes * lone.conj()
    parts = np.array([np.abs(amplitudes - lone) ** 2, np.abs(lone) ** 2, product.real, product.imag])
    for axis in (2, 3):
        parts = np.add.reduceat(parts, np.arange(0, parts.shape[axis], block), axis=axis)
    return parts


def _passive(amplitudes: ComplexArray) -> ComplexArray:
    """Amplitudes whose mean power over a tile is at most that of the incident light, shape (2, n_y, n_x)."""
    lit = np.count_nonzero(amplitudes, axis=(1, 2))
    power = np.sum(np.abs(amplitudes) ** 2, axis=(1, 2)) / np.maximum(lit, 1)
    return np.asarray(amplitudes / np.sqrt(np.maximum(power, 1.0))[:, None, None])
