"""Sizes chosen jointly: a pillar may outgrow the period less the gap where its neighbours leave it the room.

The plain rule limits every pillar to the period less the smallest gap, so that any two may stand side by side.
Here only pairs must keep the gap. From the plain choice, which keeps it, sites are visited once: each tries its
:mod:`~metafab.layout.candidates`, and where one comes too close to neighbours, these fall back on theirs. The
move with the largest gain in total overlap is made, if there is any, so every move raises the overlap and keeps
every gap.

Sites are visited in 4 x 4 colours. A move reads its two rings of neighbours and changes the first, so those of
one colour cannot meet: their order does not matter, and what a site becomes depends on sites at most
:func:`reach_sites` away. That is the halo which makes tiles seamless and independent of one another. On a hexagonal
lattice, whose neighbours in a row are two sites away, colours repeat after 4 rows and 8 columns; every other one of
these is empty, so there are as many.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.layout.candidates import candidates
from metafab.layout.gaps import centre_distances, square_of_pair
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import Lattice, SizeIndexArray
from metafab.library import SizeTable

_COLOURS = 4


def reach_sites(lattice: Lattice) -> tuple[int, int]:
    """(rows, columns) that a site's choice can reach: for each colour, from one ring of a move to its second beyond."""
    down, right = lattice.reach
    return 3 * _COLOURS**2 * down, 3 * _COLOURS**2 * right


class _Rules(NamedTuple):
    """What the kernels know of sizes, phases and neighbours.

    Attributes:
        candidates: as :attr:`JointSizes.candidates`.
        step: cells of the targets' phases in one of the candidates'.
        size_dbu: shape (n_sizes + 1, 2), width and length.
        field: shape (n_sizes + 1, 4), real parts of t for x and y polarisation, then imaginary ones.
        target: shape (cells, 2), cosine and sine of each cell's phase.
        neighbours: shape (n, 2), (rows, columns) to each neighbour.
        centres: shape (n, 2), distances of the centres along x and y.
        limit_square: of the smallest gap.
    """

    candidates: SizeIndexArray
    step: int
    size_dbu: FloatArray
    field: FloatArray
    target: FloatArray
    neighbours: NDArray[np.int64]
    centres: FloatArray
    limit_square: float


@dataclass(frozen=True)
class JointSizes:
    """What the joint choice needs.

    Attributes:
        table: all sizes, whose look-up names plain ones only: width and length up to the period less the gap.
        candidates: shape (cells, cells, longest), indexed [phi_y, phi_x]: sizes in order of falling overlap.
        min_gap_dbu: smallest gap.
        outline: of the pillars; gaps are those of the boxes around them, which are no larger than their own.
    """

    table: SizeTable
    candidates: SizeIndexArray
    min_gap_dbu: float
    outline: Outline = RECTANGLE

    @classmethod
    def of(
        cls, wide: SizeTable, plain: SizeTable, lattice: Lattice, min_gap_dbu: float, outline: Outline = RECTANGLE
    ) -> JointSizes:
        """The joint choice from the sizes of ``wide``, begun with the look-up of ``plain``, which are some of them."""
        row_of = {tuple(size): row for row, size in enumerate(wide.size_dbu.tolist())}
        rows = np.array([row_of[tuple(size)] for size in plain.size_dbu.tolist()], dtype=np.uint16)
        table = replace(wide, size_index=rows[plain.size_index], overlap=plain.overlap)
        return cls(table, candidates(table, lattice.cell_dbu, min_gap_dbu), min_gap_dbu, outline)

    def improve(
        self, size_index: SizeIndexArray, target_rad: FloatArray, lattice: Lattice, corner: tuple[int, int]
    ) -> None:
        """Improve a block of sites in place; those within :func:`reach_sites` of a cut are not final.

        Args:
            size_index: shape (n_y, n_x), sizes that keep the gap, 0 for no pillar (which stays none).
            target_rad: shape (2, n_y, n_x), target phases, need not be wrapped.
            lattice: for its periods and neighbours.
            corner: (row, column) of the block's first site on the lattice, which sets the colours.
        """
        cells = self.table.cells
        cell = (np.rint(target_rad * (cells / (2.0 * np.pi))).astype(np.int64) & (cells - 1)).astype(np.int32)
        rules = self._rules(lattice)
        every = _COLOURS * lattice.reach[0], _COLOURS * lattice.reach[1]
        for first_row in range(every[0]):
            for first_column in range(every[1]):
                first = (first_row - corner[0]) % every[0], (first_column - corner[1]) % every[1]
                _visit(size_index, cell, rules, first, every)

    def _rules(self, lattice: Lattice) -> _Rules:
        cells = self.table.cells
        turn = 2.0 * np.pi * np.arange(cells) / cells
        pairs, centres = np.array(lattice.pairs), centre_distances(lattice)
        return _Rules(
            self.candidates,
            cells // len(self.candidates),
            self.outline.boxes(self.table.size_dbu).astype(np.float64),
            np.concatenate([self.table.t.real, self.table.t.imag], axis=1),
            np.stack([np.cos(turn), np.sin(turn)], axis=1),
            np.concatenate([pairs, -pairs]),
            np.concatenate([centres, centres]),
            (self.min_gap_dbu - 1e-6) ** 2,
        )


@compiled
def _near(size: FloatArray, other: FloatArray, centres: FloatArray, limit_square: float) -> bool:
    """Whether pillars of two sizes, (width, length), ``centres`` apart along x and y, are nearer than the limit."""
    gap_x, gap_y = centres[0] - 0.5 * (size[0] + other[0]), centres[1] - 0.5 * (size[1] + other[1])
    return bool(square_of_pair(gap_x, gap_y) < limit_square)


@compiled
def _listed(cell: NDArray[np.int32], row: int, column: int, rules: _Rules) -> SizeIndexArray:
    """The candidates of a site, by its target phases."""
    listed: SizeIndexArray = rules.candidates[cell[1, row, column] // rules.step, cell[0, row, column] // rules.step]
    return listed


@compiled
def _overlap(size: int, cell: NDArray[np.int32], row: int, column: int, rules: _Rules) -> float:
    """Of a size's field with the target phases of a site."""
    t, x, y = rules.field[size], rules.target[cell[0, row, column]], rules.target[cell[1, row, column]]
    return float(t[0] * x[0] + t[1] * y[0] + t[2] * x[1] + t[3] * y[1])


@compiled
def _at(size_index: SizeIndexArray, row: int, column: int) -> int:
    """The size at a site, 0 beyond the block."""
    n_y, n_x = size_index.shape
    return int(size_index[row, column]) if 0 <= row < n_y and 0 <= column < n_x else 0


@compiled
def _first_that_fits(size_index: SizeIndexArray, cell: NDArray[np.int32], row: int, column: int, rules: _Rules) -> int:
    """The first of a site's candidates that keeps its distance from all neighbours; 0 if none does."""
    for size in _listed(cell, row, column, rules):
        fits = size > 0
        for k in range(len(rules.neighbours)):
            other = _at(size_index, row + rules.neighbours[k, 0], column + rules.neighbours[k, 1])
            if other and _near(rules.size_dbu[size], rules.size_dbu[other], rules.centres[k], rules.limit_square):
                fits = False
                break
        if fits or size == 0:
            return int(size)
    return 0


@compiled
def _read(size_index: SizeIndexArray, row: int, column: int, rules: _Rules, around: SizeIndexArray) -> None:
    """Copy the sizes of a site's neighbours and, last, its own into ``around``; 0 beyond the block."""
    for k in range(len(rules.neighbours)):
        around[k] = _at(size_index, row + rules.neighbours[k, 0], column + rules.neighbours[k, 1])
    around[-1] = size_index[row, column]


@compiled
def _write(size_index: SizeIndexArray, row: int, column: int, rules: _Rules, around: SizeIndexArray) -> None:
    """The inverse of :func:`_read`."""
    for k in range(len(rules.neighbours)):
        if around[k] > 0:
            size_index[row + rules.neighbours[k, 0], column + rules.neighbours[k, 1]] = around[k]
    size_index[row, column] = around[-1]


@compiled
def _make_room(
    size_index: SizeIndexArray, cell: NDArray[np.int32], row: int, column: int, rules: _Rules, old: SizeIndexArray
) -> float:
    """Let the ``old`` neighbours fall back that are too near to a site's new size.

    Returns:
        The overlap that this costs: 0 where there is room as it is, infinity where there can be none.
    """
    cost = 0.0
    new = rules.size_dbu[size_index[row, column]]
    for k in range(len(rules.neighbours)):
        if old[k] == 0 or not _near(new, rules.size_dbu[old[k]], rules.centres[k], rules.limit_square):
            continue
        i, j = row + rules.neighbours[k, 0], column + rules.neighbours[k, 1]
        size = _first_that_fits(size_index, cell, i, j, rules)
        if size == 0:
            return np.inf
        size_index[i, j] = size
        cost += _overlap(old[k], cell, i, j, rules) - _overlap(size, cell, i, j, rules)
    return cost


@compiled
def _visit(
    size_index: SizeIndexArray,
    cell: NDArray[np.int32],
    rules: _Rules,
    first: tuple[int, int],
    every: tuple[int, int],
) -> None:
    """Visit the sites of one colour, from ``first`` on in steps of ``every``, and make the best move of each."""
    n_y, n_x = size_index.shape
    old, best = np.zeros((2, len(rules.neighbours) + 1), dtype=np.uint16)
    for row in range(first[0], n_y, every[0]):
        for column in range(first[1], n_x, every[1]):
            if size_index[row, column] == 0:
                continue
            _read(size_index, row, column, rules, old)
            held = _overlap(old[-1], cell, row, column, rules)
            largest_gain = 0.0
            for size in _listed(cell, row, column, rules):
                gain = _overlap(size, cell, row, column, rules) - held
                if size == 0 or gain <= largest_gain:
                    break
                size_index[row, column] = size
                cost = _make_room(size_index, cell, row, column, rules, old)
                if gain - cost > largest_gain:
                    largest_gain = gain - cost
                    _read(size_index, row, column, rules, best)
                _write(size_index, row, column, rules, old)
                if cost == 0.0:
                    break
            if largest_gain > 0.0:
                _write(size_index, row, column, rules, best)
