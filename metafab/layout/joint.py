"""Sizes chosen jointly: a pillar may exceed the period less the gap if its neighbours leave room for it.

A greedy local search. It starts from sizes that keep the gap with any neighbour, and visits each site once. A site
tries its candidates (:func:`candidates`); neighbours that come too close fall back on the first of their own candidates
that fits. The move with the largest gain in total overlap is made, if there is a gain. Every move therefore raises the
overlap and keeps every gap.

Sites are visited by colour, 4 x 4 colours in all. A move reads two rings of neighbours and changes the first ring, so
moves of one colour cannot interfere: their order does not matter, and a site depends only on sites at most
:func:`reach_sites` away. A halo of that width makes tiles independent of one another. On a hexagonal lattice, where
neighbours in a row are two sites apart, colours repeat after 4 rows and 8 columns.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import default_workers
from metafab.layout.gaps import centre_distances, signed_square
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import Lattice, SizeIndexArray
from metafab.library import SizeTable

#: Colours along each axis: moves of sites this many apart, two rings each, do not interfere.
_COLOURS = 4

# Candidates are listed for _CELLS x _CELLS pairs of phases, in steps of 0.025 rad; they are the best sizes within
# _LIMITS x _LIMITS limits of width and length.
_CELLS = 256
_LIMITS = 9
#: Most candidates of a pair of phases.
_LONGEST = 16
#: Pairs of phases whose overlaps with all sizes are held at once.
_CELLS_AT_ONCE = 256


def reach_sites(lattice: Lattice) -> tuple[int, int]:
    """(rows, columns) that the choice of a site can reach: three rings of neighbours for each colour."""
    down, right = lattice.reach
    return 3 * _COLOURS**2 * down, 3 * _COLOURS**2 * right


class _Tables(NamedTuple):
    """Look-up tables of the kernels."""

    candidates: SizeIndexArray  #: As :attr:`JointSizes.candidates`.
    step: int  #: Phase cells of the size table per phase cell of the candidates.
    size_dbu: FloatArray  #: Shape (n_sizes + 1, 2), width and length of the bounding boxes.
    field: FloatArray  #: Shape (n_sizes + 1, 4), real parts of t for x and y polarisation, then imaginary parts.
    target: FloatArray  #: Shape (cells, 2), cosine and sine of the phase of each cell.
    neighbours: NDArray[np.int64]  #: Shape (n, 2), (rows, columns) to each neighbour.
    centres: FloatArray  #: Shape (n, 2), distances between the centres along x and y.
    limit_square: float  #: Square of the smallest gap.


@dataclass(frozen=True)
class JointSizes:
    """The joint choice of sizes."""

    table: SizeTable  #: All sizes; its look-up table names only sizes that keep the gap with any neighbour.
    #: Shape (cells, cells, longest), indexed [phi_y, phi_x]: sizes in order of falling overlap.
    candidates: SizeIndexArray
    min_gap_dbu: float  #: Smallest gap.
    #: Outline of the pillars; gaps are measured between bounding boxes, which never overstates them.
    outline: Outline = RECTANGLE

    @classmethod
    def of(
        cls, wide: SizeTable, each: SizeTable, lattice: Lattice, min_gap_dbu: float, outline: Outline = RECTANGLE
    ) -> JointSizes:
        """Return the joint choice among the sizes of ``wide``.

        ``each`` is the subset of ``wide`` that keeps the gap with any neighbour; the search starts from its look-up.
        """
        row_of = {tuple(size): row for row, size in enumerate(wide.size_dbu.tolist())}
        rows = np.array([row_of[tuple(size)] for size in each.size_dbu.tolist()], dtype=np.uint16)
        table = replace(wide, size_index=rows[each.size_index], overlap=each.overlap)
        return cls(table, candidates(table, lattice.cell_dbu, min_gap_dbu), min_gap_dbu, outline)

    def improve(
        self, size_index: SizeIndexArray, target_rad: FloatArray, lattice: Lattice, corner: tuple[int, int]
    ) -> None:
        """Improve a block of sites in place; sites within :func:`reach_sites` of a cut edge are not final.

        Args:
            size_index: shape (n_y, n_x), sizes that keep the gap; 0 for no pillar, which stays so.
            target_rad: shape (2, n_y, n_x), target phases, not necessarily wrapped.
            corner: (row, column) of the first site of the block on the lattice, which sets the colours.
        """
        cells = self.table.cells
        cell = (np.rint(target_rad * (cells / (2.0 * np.pi))).astype(np.int64) & (cells - 1)).astype(np.int32)
        tables = self._tables(lattice)
        every = _COLOURS * lattice.reach[0], _COLOURS * lattice.reach[1]
        for first_row in range(every[0]):
            for first_column in range(every[1]):
                first = (first_row - corner[0]) % every[0], (first_column - corner[1]) % every[1]
                _visit_colour(size_index, cell, tables, first, every)

    def _tables(self, lattice: Lattice) -> _Tables:
        cells = self.table.cells
        turn = 2.0 * np.pi * np.arange(cells) / cells
        pairs, centres = np.array(lattice.pairs), centre_distances(lattice)
        return _Tables(
            self.candidates,
            cells // len(self.candidates),
            self.outline.boxes(self.table.size_dbu).astype(np.float64),
            np.concatenate([self.table.t.real, self.table.t.imag], axis=1),
            np.stack([np.cos(turn), np.sin(turn)], axis=1),
            np.concatenate([pairs, -pairs]),
            np.concatenate([centres, centres]),
            (self.min_gap_dbu - 1e-6) ** 2,
        )


def candidates(table: SizeTable, period_dbu: tuple[int, int], min_gap_dbu: float) -> SizeIndexArray:
    """List the distinct best sizes within all pairs of limits "width up to a, length up to b".

    The best size of all comes first, then the best of those that are narrower or shorter, down to sizes that fit next
    to the largest pillar. The look-up table of ``table`` is not used. The lists have the shape (256, 256, 16), indexed
    [phi_y, phi_x], in order of falling overlap; 0 ends a list.
    """
    u = np.concatenate([table.t.real, table.t.imag], axis=1)[1:]
    limit_x, limit_y = (_first_limit(table.size_dbu[1:, axis], period_dbu[axis], min_gap_dbu) for axis in (0, 1))
    box = limit_x * _LIMITS + limit_y
    # Sizes sorted by box, so that each box is a slice.
    order = np.argsort(box, kind="stable")
    ends = np.searchsorted(box[order], np.arange(_LIMITS**2 + 1))
    phase = 2.0 * np.pi * np.arange(_CELLS) / _CELLS
    phase_y, phase_x = (axis.ravel() for axis in np.meshgrid(phase, phase, indexing="ij"))
    wanted = np.stack([np.cos(phase_x), np.cos(phase_y), np.sin(phase_x), np.sin(phase_y)], axis=1)

    def of_cells(first: int) -> SizeIndexArray:
        """Lists of some of the phase cells."""
        overlap = wanted[first : first + _CELLS_AT_ONCE] @ u[order].T
        best = np.full((len(overlap), _LIMITS**2), -np.inf)
        size = np.zeros(best.shape, dtype=np.uint16)
        for k in range(_LIMITS**2):
            if ends[k] < ends[k + 1]:
                column = ends[k] + overlap[:, ends[k] : ends[k + 1]].argmax(axis=1)
                size[:, k] = order[column] + 1
                best[:, k] = overlap[np.arange(len(overlap)), column]
        return _sorted_lists(best, size)

    with ThreadPoolExecutor(default_workers()) as threads:
        lists = list(threads.map(of_cells, range(0, _CELLS**2, _CELLS_AT_ONCE)))
    return np.concatenate(lists).reshape(_CELLS, _CELLS, _LONGEST)


def _first_limit(size_dbu: NDArray[np.int32], period_dbu: int, min_gap_dbu: float) -> NDArray[np.int64]:
    """Index of the first limit that holds each size.

    Limits rise evenly from the largest size that fits next to the largest pillar, up to that pillar's size.
    """
    largest = float(size_dbu.max())
    return np.searchsorted(np.linspace(2.0 * (period_dbu - min_gap_dbu) - largest, largest, _LIMITS) + 1e-6, size_dbu)


def _sorted_lists(best: FloatArray, size: SizeIndexArray) -> SizeIndexArray:
    """Turn the best size between neighbouring limits, shape (n, limits^2), into the best sizes up to each limit."""
    n = len(best)
    best, size = best.reshape(n, _LIMITS, _LIMITS), size.reshape(n, _LIMITS, _LIMITS)
    for axis in (1, 2):
        for k in range(1, _LIMITS):
            here, before = ((slice(None),) * axis + (index,) for index in (k, k - 1))
            smaller = best[here] < best[before]
            best[here] = np.where(smaller, best[before], best[here])
            size[here] = np.where(smaller, size[before], size[here])
    best, size = best.reshape(n, -1), size.reshape(n, -1)
    size = np.take_along_axis(size, np.lexsort((size, -best), axis=1), axis=1)
    size[:, 1:][size[:, 1:] == size[:, :-1]] = 0
    filled_first = np.argsort(size == 0, axis=1, kind="stable")[:, :_LONGEST]
    return np.ascontiguousarray(np.take_along_axis(size, filled_first, axis=1))


@compiled
def _too_near(size: FloatArray, other: FloatArray, centres: FloatArray, limit_square: float) -> bool:
    """Whether pillars of two sizes, with ``centres`` between their centres, are nearer than the limit."""
    gap_x, gap_y = centres[0] - 0.5 * (size[0] + other[0]), centres[1] - 0.5 * (size[1] + other[1])
    return bool(signed_square(gap_x, gap_y) < limit_square)


@compiled
def _candidates_at(cell: NDArray[np.int32], row: int, column: int, tables: _Tables) -> SizeIndexArray:
    """Candidates of a site, by its target phases."""
    listed: SizeIndexArray = tables.candidates[cell[1, row, column] // tables.step, cell[0, row, column] // tables.step]
    return listed


@compiled
def _overlap(size: int, cell: NDArray[np.int32], row: int, column: int, tables: _Tables) -> float:
    """Overlap of the field of a size with the target phases of a site."""
    t, x, y = tables.field[size], tables.target[cell[0, row, column]], tables.target[cell[1, row, column]]
    return float(t[0] * x[0] + t[1] * y[0] + t[2] * x[1] + t[3] * y[1])


@compiled
def _size_at(size_index: SizeIndexArray, row: int, column: int) -> int:
    """Size at a site, 0 beyond the block."""
    n_y, n_x = size_index.shape
    return int(size_index[row, column]) if 0 <= row < n_y and 0 <= column < n_x else 0


@compiled
def _first_that_fits(
    size_index: SizeIndexArray, cell: NDArray[np.int32], row: int, column: int, tables: _Tables
) -> int:
    """First candidate of a site that keeps the gap to all neighbours; 0 if none does."""
    for size in _candidates_at(cell, row, column, tables):
        fits = size > 0
        for k in range(len(tables.neighbours)):
            other = _size_at(size_index, row + tables.neighbours[k, 0], column + tables.neighbours[k, 1])
            if other and _too_near(
                tables.size_dbu[size], tables.size_dbu[other], tables.centres[k], tables.limit_square
            ):
                fits = False
                break
        if fits or size == 0:
            return int(size)
    return 0


@compiled
def _save_ring(size_index: SizeIndexArray, row: int, column: int, tables: _Tables, ring: SizeIndexArray) -> None:
    """Copy the sizes of a site's neighbours and, last, of the site itself to ``ring``; 0 beyond the block."""
    for k in range(len(tables.neighbours)):
        ring[k] = _size_at(size_index, row + tables.neighbours[k, 0], column + tables.neighbours[k, 1])
    ring[-1] = size_index[row, column]


@compiled
def _restore_ring(size_index: SizeIndexArray, row: int, column: int, tables: _Tables, ring: SizeIndexArray) -> None:
    """Copy the sizes back that :func:`_save_ring` saved."""
    for k in range(len(tables.neighbours)):
        if ring[k] > 0:
            size_index[row + tables.neighbours[k, 0], column + tables.neighbours[k, 1]] = ring[k]
    size_index[row, column] = ring[-1]


@compiled
def _make_room(
    size_index: SizeIndexArray, cell: NDArray[np.int32], row: int, column: int, tables: _Tables, old: SizeIndexArray
) -> float:
    """Shrink the ``old`` neighbours that are too near to the new size of a site; return the overlap lost.

    It is 0 if no neighbour is too near, and infinite if one cannot fall back.
    """
    cost = 0.0
    new = tables.size_dbu[size_index[row, column]]
    for k in range(len(tables.neighbours)):
        if old[k] == 0 or not _too_near(new, tables.size_dbu[old[k]], tables.centres[k], tables.limit_square):
            continue
        i, j = row + tables.neighbours[k, 0], column + tables.neighbours[k, 1]
        size = _first_that_fits(size_index, cell, i, j, tables)
        if size == 0:
            return np.inf
        size_index[i, j] = size
        cost += _overlap(old[k], cell, i, j, tables) - _overlap(size, cell, i, j, tables)
    return cost


@compiled
def _visit_colour(
    size_index: SizeIndexArray, cell: NDArray[np.int32], tables: _Tables, first: tuple[int, int], every: tuple[int, int]
) -> None:
    """Make the best move of each site of one colour: from ``first`` on, in steps of ``every``."""
    n_y, n_x = size_index.shape
    old, best = np.zeros((2, len(tables.neighbours) + 1), dtype=np.uint16)
    for row in range(first[0], n_y, every[0]):
        for column in range(first[1], n_x, every[1]):
            if size_index[row, column] == 0:
                continue
            _save_ring(size_index, row, column, tables, old)
            held = _overlap(old[-1], cell, row, column, tables)
            largest_gain = 0.0
            for size in _candidates_at(cell, row, column, tables):
                gain = _overlap(size, cell, row, column, tables) - held
                if size == 0 or gain <= largest_gain:
                    break
                size_index[row, column] = size
                cost = _make_room(size_index, cell, row, column, tables, old)
                if gain - cost > largest_gain:
                    largest_gain = gain - cost
                    _save_ring(size_index, row, column, tables, best)
                _restore_ring(size_index, row, column, tables, old)
                if cost == 0.0:
                    break
            if largest_gain > 0.0:
                _restore_ring(size_index, row, column, tables, best)
