"""Sizes chosen jointly: a pillar may outgrow the period less the gap where its neighbours leave it the room.

The plain rule limits every pillar to the period less the smallest gap, so that any two may stand side by side.
Here only pairs must keep the gap. From the plain choice, which keeps it, sites are visited once: each tries its
:mod:`~metafab.layout.candidates`, and where one comes too close to neighbours, these fall back on theirs. The
move with the largest gain in total overlap is made, if there is any, so every move raises the overlap and keeps
every gap.

Sites are visited in 4 x 4 colours. A move reads its two rings of neighbours and changes the first, so those of
one colour cannot meet: their order does not matter, and what a site becomes depends on sites at most
:data:`REACH_SITES` away. That is the halo which makes tiles seamless and independent of one another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numerics import compiled
from metafab.layout.candidates import candidates
from metafab.layout.gaps import square_of_pair
from metafab.layout.pillars import Lattice, SizeIndexArray
from metafab.library import SizeTable

_COLOURS = 4

#: How far a site's choice can depend on others: from the first ring of a move to its second on the other side.
REACH_SITES = 3 * _COLOURS**2


@dataclass(frozen=True)
class JointSizes:
    """What the joint choice needs.

    Attributes:
        table: all sizes, whose look-up names plain ones only: width and length up to the period less the gap.
        candidates: shape (cells, cells, longest), indexed [phi_y, phi_x]: sizes in order of falling overlap.
        min_gap_dbu: smallest gap.
    """

    table: SizeTable
    candidates: SizeIndexArray
    min_gap_dbu: float

    @classmethod
    def of(cls, wide: SizeTable, plain: SizeTable, lattice: Lattice, min_gap_dbu: float) -> JointSizes:
        """The joint choice from the sizes of ``wide``, begun with the look-up of ``plain``, which are some of them."""
        row_of = {tuple(size): row for row, size in enumerate(wide.size_dbu.tolist())}
        rows = np.array([row_of[tuple(size)] for size in plain.size_dbu.tolist()], dtype=np.uint16)
        table = replace(wide, size_index=rows[plain.size_index], overlap=plain.overlap)
        return cls(table, candidates(table, lattice.period_dbu, min_gap_dbu), min_gap_dbu)

    def improve(
        self, size_index: SizeIndexArray, target_rad: FloatArray, lattice: Lattice, corner: tuple[int, int]
    ) -> None:
        """Improve a block of sites in place; those within :data:`REACH_SITES` of a cut are not final.

        Args:
            size_index: shape (n_y, n_x), sizes that keep the gap, 0 for no pillar (which stays none).
            target_rad: shape (2, n_y, n_x), target phases, need not be wrapped.
            lattice: for its periods.
            corner: (row, column) of the block's first site on the lattice, which sets the colours.
        """
        cells = self.table.cells
        cell = (np.rint(target_rad * (cells / (2.0 * np.pi))).astype(np.int64) & (cells - 1)).astype(np.int32)
        turn = 2.0 * np.pi * np.arange(cells) / cells
        for first_row in range(_COLOURS):
            for first_column in range(_COLOURS):
                _visit(
                    size_index, cell, self.candidates, self.table.size_dbu.astype(np.float64),
                    np.concatenate([self.table.t.real, self.table.t.imag], axis=1), np.cos(turn), np.sin(turn),
                    *lattice.period_dbu, (self.min_gap_dbu - 1e-6) ** 2,
                    (first_row - corner[0]) % _COLOURS, (first_column - corner[1]) % _COLOURS,
                )  # fmt: skip


@compiled
def _near(down: int, right: int, size: FloatArray, other: FloatArray, p_x: int, p_y: int, limit_square: float) -> bool:
    """Whether pillars of two sizes, (width, length) each, at neighbouring sites come closer than the limit."""
    gap_x = abs(right) * p_x - 0.5 * (size[0] + other[0])
    gap_y = abs(down) * p_y - 0.5 * (size[1] + other[1])
    return bool(square_of_pair(gap_x, gap_y) < limit_square)


@compiled
def _first_that_fits(
    size_index: SizeIndexArray,
    row: int,
    column: int,
    listed: SizeIndexArray,
    size_dbu: FloatArray,
    p_x: int,
    p_y: int,
    limit_square: float,
) -> int:
    """The first of the ``listed`` sizes that keeps its distance from all neighbours of a site; 0 if none does."""
    n_y, n_x = size_index.shape
    for size in listed:
        fits = size > 0
        for k in range(9):
            i, j = row + k // 3 - 1, column + k % 3 - 1
            if k == 4 or i < 0 or i >= n_y or j < 0 or j >= n_x or size_index[i, j] == 0:
                continue
            if _near(i - row, j - column, size_dbu[size], size_dbu[size_index[i, j]], p_x, p_y, limit_square):
                fits = False
                break
        if fits or size == 0:
            return int(size)
    return 0


@compiled
def _overlap(t: FloatArray, cosine_x: float, sine_x: float, cosine_y: float, sine_y: float) -> float:
    """Of a size's field, real parts before imaginary ones, with a pair of target phases."""
    return float(t[0] * cosine_x + t[1] * cosine_y + t[2] * sine_x + t[3] * sine_y)


@compiled
def _read(size_index: SizeIndexArray, row: int, column: int, around: SizeIndexArray) -> None:
    """Copy the sizes of a site and its neighbours, row by row, into ``around``, shape (9,); 0 beyond the block."""
    n_y, n_x = size_index.shape
    for k in range(9):
        i, j = row + k // 3 - 1, column + k % 3 - 1
        around[k] = size_index[i, j] if 0 <= i < n_y and 0 <= j < n_x else 0


@compiled
def _write(size_index: SizeIndexArray, row: int, column: int, around: SizeIndexArray) -> None:
    """The inverse of :func:`_read`."""
    for k in range(9):
        if around[k] > 0:
            size_index[row + k // 3 - 1, column + k % 3 - 1] = around[k]


@compiled
def _make_room(
    size_index: SizeIndexArray,
    row: int,
    column: int,
    old: SizeIndexArray,
    cell: NDArray[np.int32],
    candidates: SizeIndexArray,
    size_dbu: FloatArray,
    t: FloatArray,
    cosine: FloatArray,
    sine: FloatArray,
    p_x: int,
    p_y: int,
    limit_square: float,
) -> float:
    """Let the ``old`` neighbours fall back that are too near to a site's new size.

    Returns:
        The overlap that this costs: 0 where there is room as it is, infinity where there can be none.
    """
    step = len(cosine) // len(candidates)
    cost = 0.0
    for k in range(9):
        down, right = k // 3 - 1, k % 3 - 1
        if k == 4 or old[k] == 0:
            continue
        if not _near(down, right, size_dbu[size_index[row, column]], size_dbu[old[k]], p_x, p_y, limit_square):
            continue
        i, j = row + down, column + right
        x, y = cell[0, i, j], cell[1, i, j]
        listed = candidates[y // step, x // step]
        size = _first_that_fits(size_index, i, j, listed, size_dbu, p_x, p_y, limit_square)
        if size == 0:
            return np.inf
        size_index[i, j] = size
        cost += _overlap(t[old[k]], cosine[x], sine[x], cosine[y], sine[y])
        cost -= _overlap(t[size], cosine[x], sine[x], cosine[y], sine[y])
    return cost


@compiled
def _visit(
    size_index: SizeIndexArray,
    cell: NDArray[np.int32],
    candidates: SizeIndexArray,
    size_dbu: FloatArray,
    t: FloatArray,
    cosine: FloatArray,
    sine: FloatArray,
    p_x: int,
    p_y: int,
    limit_square: float,
    first_row: int,
    first_column: int,
) -> None:
    """Visit the sites of one colour and make the best move of each."""
    n_y, n_x = size_index.shape
    step = len(cosine) // len(candidates)
    old, best = np.zeros(9, dtype=np.uint16), np.zeros(9, dtype=np.uint16)
    for row in range(first_row, n_y, _COLOURS):
        for column in range(first_column, n_x, _COLOURS):
            if size_index[row, column] == 0:
                continue
            _read(size_index, row, column, old)
            x, y = cell[0, row, column], cell[1, row, column]
            held = _overlap(t[old[4]], cosine[x], sine[x], cosine[y], sine[y])
            largest_gain = 0.0
            for size in candidates[y // step, x // step]:
                gain = _overlap(t[size], cosine[x], sine[x], cosine[y], sine[y]) - held
                if size == 0 or gain <= largest_gain:
                    break
                size_index[row, column] = size
                cost = _make_room(
                    size_index, row, column, old, cell, candidates, size_dbu, t, cosine, sine, p_x, p_y, limit_square
                )
                if gain - cost > largest_gain:
                    largest_gain = gain - cost
                    _read(size_index, row, column, best)
                _write(size_index, row, column, old)
                if cost == 0.0:
                    break
            if largest_gain > 0.0:
                _write(size_index, row, column, best)
