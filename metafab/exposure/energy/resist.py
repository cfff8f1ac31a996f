"""Energy in the resist at every pillar of a lens, tile by tile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import in_order, kept_threads, spread
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.far import LONG_PERIODS, LongRange, MiddleRange, block_masses
from metafab.exposure.energy.near import add_near, near_tables
from metafab.layout import PillarMap

Scalar = TypeVar("Scalar", bound=np.generic)

#: Sites a side of a tile.
TILE_SITES = 512
#: Shortest range that reaches beyond the nearest neighbours, in periods.
_MIDDLE_PERIODS = 0.3


@dataclass(frozen=True)
class TileEnergy:
    """Energy on one tile, in units of that of a large pad at dose 1."""

    rows: slice  #: Lattice rows of the tile.
    columns: slice  #: Lattice columns of the tile.
    size_index: NDArray[np.uint16]  #: Shape (n_y, n_x).
    dose: Float32Array  #: Shape (n_y, n_x).
    centre: Float32Array  #: Shape (n_y, n_x), at the centre of each pillar.
    others: Float32Array  #: Shape (2, n_y, n_x), energy of all other pillars, mean of both x edges and of both y edges.


class ResistEnergy:
    """Energy in the resist at every pillar of a pattern, for any doses; InputError for a hexagonal lattice."""

    def __init__(self, pillars: PillarMap, psf: BeamPsf) -> None:
        lattice = pillars.lattice
        if lattice.hexagonal:
            raise InputError.single("exposure", "lattice", "a rectangular lattice", "hexagonal", "not available so far")
        self.psf = psf
        self.size_nm = pillars.size_nm()
        self.size_index = pillars.to_array()
        self.period_nm = lattice.period_nm
        smallest = min(self.period_nm)
        self._near = near_tables(psf.between(0.0, LONG_PERIODS * smallest), self.size_nm, self.period_nm)
        middle = psf.between(_MIDDLE_PERIODS * smallest, LONG_PERIODS * smallest)
        self._middle = MiddleRange.of(middle, self.period_nm, TILE_SITES)
        self._long_psf = psf.between(LONG_PERIODS * smallest, math.inf)
        self._area = (self.size_nm[:, 0] * self.size_nm[:, 1]).astype(np.float32)
        self._sides = self.size_nm.astype(np.float32)
        n_y, n_x = lattice.shape
        blocks = [
            (slice(row, min(row + TILE_SITES, n_y)), slice(column, min(column + TILE_SITES, n_x)))
            for row, column in lattice.tile_corners(TILE_SITES)
        ]
        #: Rows and columns of the tiles that hold pillars.
        self.tiles = tuple(block for block in blocks if self.size_index[block].any())

    def map_tiles(
        self,
        dose: Float32Array,
        executor: Executor,
        work: Callable[[TileEnergy], FloatArray],
        tiles: Sequence[tuple[slice, slice]] | None = None,
    ) -> Iterator[tuple[tuple[slice, slice], FloatArray]]:
        """Compute the energy of each tile and apply ``work`` to it, in threads; yield rows, columns and its array.

        Doses, shape (n_y, n_x) of the lattice, are relative to the base dose. ``tiles`` are some of the tiles; all by
        default.
        """
        long_range = self._long_range(dose, executor)

        def both(block: tuple[slice, slice]) -> tuple[tuple[slice, slice], FloatArray]:
            return block, work(self._tile(dose, long_range, block))

        yield from in_order(executor, both, self.tiles if tiles is None else tiles)

    def direct(self, dose: Float32Array, row: int, column: int) -> FloatArray:
        """Compute the energy at one pillar as a direct sum over all in reach, the reference of :meth:`map_tiles`.

        Doses have the shape (n_y, n_x) of the lattice and are relative to the base dose. The energy, shape (3,), is
        that at the centre, the mean of the x edges and that of the y edges; the pillar itself included.
        """
        reach = math.ceil(5.0 * float(self.psf.range_nm.max()) / min(self.period_nm)) + 1
        top, left = max(0, row - reach), max(0, column - reach)
        part = (slice(top, row + reach + 1), slice(left, column + reach + 1))
        w, length = self.size_nm[self.size_index[row, column]]
        points = np.array([[0.0, 0.0], [0.5 * w, 0.0], [-0.5 * w, 0.0], [0.0, 0.5 * length], [0.0, -0.5 * length]])
        points += np.array([column - left, row - top]) * np.asarray(self.period_nm)
        pattern = (self.size_index[part], dose[part], self.size_nm, *self.period_nm)
        rows = np.zeros((pattern[0].shape[0], len(points)))
        with kept_threads():
            spread(_sum_rows, len(rows), *pattern, self.psf.weight, self.psf.range_nm, points, rows)
        energy = rows.sum(axis=0)
        return np.array([energy[0], energy[1:3].mean(), energy[3:].mean()])

    def _long_range(self, dose: Float32Array, executor: Executor) -> LongRange | None:
        if self._long_psf.range_nm.size == 0:
            return None
        rows = range(0, self.size_index.shape[0], TILE_SITES)

        def band(row: int) -> FloatArray:
            part = slice(row, row + TILE_SITES)
            return block_masses(np.asarray(self._area[self.size_index[part]] * dose[part], dtype=np.float64))

        masses = np.concatenate(list(in_order(executor, band, rows)))
        return LongRange.of(self._long_psf, masses, self.period_nm)

    def _tile(self, dose: Float32Array, long_range: LongRange | None, block: tuple[slice, slice]) -> TileEnergy:
        rows, columns = block
        margin = self._middle.margin if self._middle is not None else 1
        index = _with_margin(self.size_index, rows, columns, margin)
        doses = _with_margin(dose, rows, columns, margin)
        if self._middle is None:
            n_y, n_x = rows.stop - rows.start, columns.stop - columns.start
            energy = np.zeros((3, n_y, n_x), dtype=np.float32)
        else:
            sides = self._sides[index]
            energy = self._middle.energy(self._area[index] * doses, sides[..., 0], sides[..., 1])
        if long_range is not None:
            energy += long_range.at(rows, columns)
        inner = slice(margin - 1, index.shape[0] - margin + 1), slice(margin - 1, index.shape[1] - margin + 1)
        near = self._near
        add_near(
            index[inner], doses[inner], near.centre, near.edge_x, near.edge_y, near.width_of, near.length_of, energy
        )
        return TileEnergy(rows, columns, self.size_index[block], dose[block], energy[0], energy[1:])


def _with_margin(values: NDArray[Scalar], rows: slice, columns: slice, margin: int) -> NDArray[Scalar]:
    """A block with a margin of sites, zero outside of the lattice."""
    n_y, n_x = values.shape
    top, bottom = max(0, rows.start - margin), min(n_y, rows.stop + margin)
    left, right = max(0, columns.start - margin), min(n_x, columns.stop + margin)
    shape = (rows.stop - rows.start + 2 * margin, columns.stop - columns.start + 2 * margin)
    result = np.zeros(shape, dtype=values.dtype)
    y, x = top - rows.start + margin, left - columns.start + margin
    result[y : y + bottom - top, x : x + right - left] = values[top:bottom, left:right]
    return result


@compiled
def _sum_rows(
    first: int,
    behind: int,
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    size_nm: FloatArray,
    period_x_nm: float,
    period_y_nm: float,
    weight: FloatArray,
    range_nm: FloatArray,
    points_nm: FloatArray,
    energy: FloatArray,
) -> None:
    """Add each row's energy at ``points_nm`` (n, 2), from the centre of the first site, to ``energy`` (n_rows, n).

    A Gaussian is left out beyond five of its ranges, where it is below 1e-11 of its peak.
    """
    largest = 0.5 * max(size_nm[:, 0].max(), size_nm[:, 1].max())
    for row in range(first, behind):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                continue
            half_w, half_l = 0.5 * size_nm[size, 0], 0.5 * size_nm[size, 1]
            for k in range(len(points_nm)):
                x = points_nm[k, 0] - column * period_x_nm
                y = points_nm[k, 1] - row * period_y_nm
                distance = max(abs(x), abs(y)) - largest
                total = 0.0
                for n in range(range_nm.size - 1, -1, -1):
                    beta = range_nm[n]
                    if distance > 5.0 * beta:
                        break
                    along_x = math.erf((x + half_w) / beta) - math.erf((x - half_w) / beta)
                    along_y = math.erf((y + half_l) / beta) - math.erf((y - half_l) / beta)
                    total += 0.25 * weight[n] * along_x * along_y
                energy[row, k] += dose[row, column] * total
