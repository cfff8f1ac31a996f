"""The grid of manufacturable sizes, its symmetry, and space-filling sequences of sizes to solve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metafab.cell import PillarCell, is_square, pillar_cell
from metafab.core.conventions import FloatArray
from metafab.spec.cell import Sweep, UnitCell

IndexArray = NDArray[np.intp]

#: Smallest number of widths and of lengths that models and surfaces are fitted to.
SMALLEST_SURFACE = 4

# The plastic number: steps of 1/g and 1/g^2 fill the unit square evenly (Roberts' R2 sequence).
_PLASTIC = 1.32471795724474602596


@dataclass(frozen=True)
class SizeGrid:
    """Grid of manufacturable sizes.

    Points are numbered row by row, ``number = row * n_width + column``. Where exchanging x and y maps the grid
    to itself, only points with width <= length are solved. These points are called distinct.
    """

    width_nm: FloatArray  #: Shape (n_width,), ascending.
    length_nm: FloatArray  #: Shape (n_length,), ascending.
    exchange: bool  #: True if t_xx(W, L) = t_yy(L, W) on the grid.
    diagonal: bool = False  #: True if only sizes with equal width and length are made (circles).

    @classmethod
    def of(cls, unit_cell: UnitCell) -> SizeGrid:
        """Return the grid of a unit cell's sweep."""
        sweep = unit_cell.sweep
        exchange = is_square(unit_cell) and sweep.width_nm == sweep.length_nm
        diagonal = unit_cell.cell.is_round
        return cls(_axis(sweep, sweep.width_nm), _axis(sweep, sweep.length_nm), exchange, diagonal)

    @property
    def is_narrow(self) -> bool:
        """Whether every size is solved: those of circles, or of a few widths or lengths, which no model connects."""
        return self.diagonal or min(self.shape) < SMALLEST_SURFACE

    @property
    def size(self) -> int:
        """Number of points."""
        return self.width_nm.size * self.length_nm.size

    @property
    def shape(self) -> tuple[int, int]:
        """(n_length, n_width), the shape of a map over the grid."""
        return self.length_nm.size, self.width_nm.size

    @property
    def spans_nm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """(smallest, largest) width and length."""
        width_nm, length_nm = ((float(axis[0]), float(axis[-1])) for axis in (self.width_nm, self.length_nm))
        return width_nm, length_nm

    @cached_property
    def distinct(self) -> IndexArray:
        """Numbers of the points that differ by symmetry: shape (n_distinct,), ascending."""
        number = np.arange(self.size)
        row, column = np.divmod(number, self.width_nm.size)
        if self.diagonal:
            return np.asarray(number[column == row])
        return number[column <= row] if self.exchange else number

    @cached_property
    def space_filling(self) -> IndexArray:
        """All distinct points as a space-filling sequence: shape (n_distinct,).

        The first n points, for every n, have the density of Chebyshev points, for which polynomial least squares is
        well conditioned. The corners come first, so that no model extrapolates. All points of a diagonal grid are
        solved, in ascending order.
        """
        if self.diagonal:
            return self.distinct
        n_length, n_width = self.shape
        k = np.arange(8 * self.size)
        u = np.mod(0.5 + k / _PLASTIC, 1.0)
        v = np.mod(0.5 + k / _PLASTIC**2, 1.0)
        column = np.rint(0.5 * (1.0 - np.cos(math.pi * u)) * (n_width - 1)).astype(np.intp)
        row = np.rint(0.5 * (1.0 - np.cos(math.pi * v)) * (n_length - 1)).astype(np.intp)
        corners = np.array([0, n_width - 1, (n_length - 1) * n_width, self.size - 1])
        number = self._representative(np.concatenate([corners, row * n_width + column, np.arange(self.size)]))
        first = np.unique(number, return_index=True)[1]
        return number[np.sort(first)]

    def refined(self, parts: int) -> SizeGrid:
        """Return a grid with ``parts`` steps for each step of this one; its points are numbered anew."""
        width_nm, length_nm = refined_axis(self.width_nm, parts), refined_axis(self.length_nm, parts)
        return SizeGrid(width_nm, length_nm, self.exchange, self.diagonal)

    def sizes_nm(self, number: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Return the widths and lengths of points by their numbers, shape (n,) each."""
        row, column = np.divmod(number, self.width_nm.size)
        return self.width_nm[column], self.length_nm[row]

    def cell(self, unit_cell: UnitCell, number: int) -> PillarCell:
        """Return the cell of one point."""
        width_nm, length_nm = self.sizes_nm(np.array([number], dtype=np.intp))
        return pillar_cell(unit_cell, float(width_nm[0]), float(length_nm[0]))

    def exchanged(self, number: IndexArray) -> IndexArray:
        """Return the numbers, shape (n,), of points with width and length swapped (grids with ``exchange`` only)."""
        row, column = np.divmod(number, self.width_nm.size)
        return column * self.width_nm.size + row

    def _representative(self, number: IndexArray) -> IndexArray:
        if not self.exchange:
            return number
        row, column = np.divmod(number, self.width_nm.size)
        return np.where(column <= row, number, self.exchanged(number))


def refined_axis(axis_nm: FloatArray, parts: int) -> FloatArray:
    """Divide each step of a uniform axis, shape (n,), into ``parts``: shape ((n - 1) parts + 1,)."""
    return np.linspace(axis_nm[0], axis_nm[-1], (axis_nm.size - 1) * parts + 1)


def worst_points(grid: SizeGrid, estimate: FloatArray, excluded: NDArray[np.bool_], count: int) -> IndexArray:
    """Return the numbers of the distinct points with the largest error estimates, at most ``count``, worst first.

    No two lie within two grid steps of each other. Estimates have the shape (n_length, n_width); ``excluded``, shape
    (n_points,), is True for points that are not returned, such as solved ones.
    """
    worst = estimate.ravel()
    if grid.exchange:
        worst = np.maximum(worst, estimate.T.ravel())
    candidates = grid.distinct[~excluded[grid.distinct]]
    ranked = candidates[np.argsort(-worst[candidates], kind="stable")]
    chosen: list[int] = []
    free = np.ones(estimate.shape, dtype=bool)
    for number in ranked:
        row, column = divmod(int(number), grid.width_nm.size)
        if free[row, column]:
            chosen.append(int(number))
            free[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] = False
            if len(chosen) == count:
                break
    return np.array(chosen, dtype=np.intp)


def _axis(sweep: Sweep, span_nm: tuple[float, float]) -> FloatArray:
    count = round((span_nm[1] - span_nm[0]) / sweep.size_grid_nm) + 1
    return np.linspace(*span_nm, count)
