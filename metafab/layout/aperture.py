"""Sites that carry a pillar: those whose whole unit cell lies inside the aperture.

The rule is decided in integers, so that mapping and design rules agree at every site of the rim. A cell is centred at
(x, y) and has the sides (p_x, p_y), all in database units. It is inside

- a circle of diameter D if its far corner is: (2|x| + p_x)^2 + (2|y| + p_y)^2 <= D^2;
- a ring if, besides, its nearest point lies outside the inner circle;
- a square of side D if 2|x| + p_x <= D and 2|y| + p_y <= D;
- a polygon if no edge passes through the open cell and the centre is enclosed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.layout.geometry import aperture_dbu, floor_dbu, lattice_of, nearest_dbu
from metafab.layout.pillars import Lattice
from metafab.spec import Design

IntArray = NDArray[np.int64]

# x and y of the two ends of an edge, the lower end first.
_Edge = tuple[int, int, int, int]


@dataclass(frozen=True)
class Aperture:
    """The sites inside an aperture, stored as runs of columns in each row."""

    lattice: Lattice  #: Lattice of the sites.
    first: IntArray  #: Shape (n_runs, n_y), first column of each run of a row.
    #: Shape (n_runs, n_y), one past the last column of the run; equal to ``first`` where a row has fewer runs. Runs of
    #: a hexagonal lattice include the sites that carry no pillar.
    last: IntArray

    @classmethod
    def of(cls, design: Design) -> Aperture:
        """Return the aperture of ``design`` on its lattice.

        No cell of the lattice inside, and faults of :func:`lattice_of`, raise InputError.
        """
        aperture = cls._of(lattice_of(design), design)
        if aperture.count == 0:
            periods = " x ".join(f"{period:g}" for period in design.unit_cell.cell.period_nm)
            expected = f"an aperture with room for a unit cell of {periods} nm"
            got, remedy = f"a {design.device.aperture_shape} without any", "make it larger, or its hole smaller"
            raise InputError.single(design.name, "device", expected, got, remedy)
        return aperture

    @classmethod
    def _of(cls, lattice: Lattice, design: Design) -> Aperture:
        device = design.device
        if device.aperture_shape == "polygon":
            vertices = [(nearest_dbu(x, design), nearest_dbu(y, design)) for x, y in device.outline_um]
            return cls(lattice, *_polygon_runs(lattice, vertices))
        side, (cell_x, cell_y) = aperture_dbu(design), lattice.cell_dbu
        reach_y = 2 * np.abs(lattice.y_dbu()) + cell_y
        if device.aperture_shape == "square":
            reach_x = np.where(reach_y <= side, side, 0)
        else:
            reach_x = _floor_root(np.maximum(side * side - reach_y * reach_y, 0))
        first, last = _middle_columns(lattice, reach_x - cell_x)
        if device.aperture_shape != "ring":
            return cls(lattice, first[None], last[None])
        inner = floor_dbu(device.inner_um, design)
        near_y = np.maximum(reach_y - 2 * cell_y, 0)
        # The largest |2x| - p_x still inside the inner circle: the sum of squares is below the limit, not equal to it.
        near_x = _floor_root(np.maximum(inner * inner - near_y * near_y - 1, 0))
        hole_first, hole_last = _middle_columns(lattice, np.where(near_y < inner, near_x + cell_x, -cell_x))
        hole_first, hole_last = np.clip(hole_first, first, last), np.clip(hole_last, first, last)
        return cls(lattice, np.stack([first, hole_last]), np.stack([hole_first, last]))

    @property
    def count(self) -> int:
        """Number of sites inside."""
        rows = np.arange(self.lattice.shape[0])
        return int(np.sum(self._sites_before(self.last, rows) - self._sites_before(self.first, rows)))

    def inside(self, row: int, column: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Whether each site of the block at (row, column) is inside; shape ``shape``, (n_y, n_x)."""
        return self.at(np.arange(row, row + shape[0]), np.arange(column, column + shape[1]))

    def at(self, rows: IntArray, columns: IntArray) -> NDArray[np.bool_]:
        """Whether each site of some rows, shape (n_rows,), and columns is inside: shape (n_rows, n_columns)."""
        inside = np.zeros((rows.size, columns.size), dtype=np.bool_)
        for first, last in zip(self.first[:, rows, None], self.last[:, rows, None], strict=True):
            if np.any(first < last):
                inside |= (columns >= first) & (columns < last)
        return inside & self.lattice.carries(rows, columns) if self.lattice.hexagonal else inside

    def meets(self, row: int, column: int, sites: int) -> bool:
        """Whether any site of the square of ``sites`` per side at (row, column) is inside."""
        first = np.maximum(self.first[:, row : row + sites], column)
        last = np.maximum(np.minimum(self.last[:, row : row + sites], column + sites), first)
        rows = row + np.arange(first.shape[1])
        return bool(np.any(self._sites_before(first, rows) < self._sites_before(last, rows)))

    def _sites_before(self, column: IntArray, row: IntArray) -> IntArray:
        """Number of sites of a row, left of a column, that can carry a pillar."""
        return (column + 1 - row % 2) // 2 if self.lattice.hexagonal else column


def _middle_columns(lattice: Lattice, reach: IntArray) -> tuple[IntArray, IntArray]:
    """First column, and one past the last, with |2x| <= ``reach``, shape (n_y,) each; equal where there is none."""
    n_x = lattice.shape[1]
    # |2 i - (n_x - 1)| <= k for column i; of the two parities only that of n_x - 1 counts.
    k = np.where(reach >= 0, reach // lattice.period_dbu[0], -1)
    first = np.maximum(-((k - (n_x - 1)) // 2), 0)
    last = np.minimum((n_x - 1 + k) // 2 + 1, n_x)
    return first, np.where(k < 0, first, np.maximum(first, last))


def _floor_root(square: IntArray) -> IntArray:
    """Largest integer whose square does not exceed ``square``; floating point alone errs above 2^53."""
    root = np.sqrt(square.astype(np.float64)).astype(np.int64)
    root -= root * root > square
    return root + ((root + 1) * (root + 1) <= square)


def _polygon_runs(lattice: Lattice, vertices: list[tuple[int, int]]) -> tuple[IntArray, IntArray]:
    """Runs of the cells inside a polygon. Lengths are doubled, because the edges of a cell may lie on half units."""
    edges: list[_Edge] = []
    for (x_1, y_1), (x_2, y_2) in zip(vertices, vertices[1:] + vertices[:1], strict=True):
        edge = (2 * x_1, 2 * y_1, 2 * x_2, 2 * y_2)
        edges.append(edge if y_1 <= y_2 else (*edge[2:], *edge[:2]))
    _, lowest, _, highest = np.array(edges, dtype=np.int64).T
    (n_y, n_x), (p_x, p_y), (cell_x, cell_y) = lattice.shape, lattice.period_dbu, lattice.cell_dbu
    middle_x = (n_x - 1) * p_x
    runs: list[list[tuple[int, int]]] = []
    for row in range(n_y):
        centre = (2 * row - (n_y - 1)) * p_y
        low, high = centre - cell_y, centre + cell_y
        near = np.flatnonzero((highest > low) & (lowest < high))
        runs_of_row = []
        for left, right in _free_spans([edges[k] for k in near], low, high):
            # Columns i whose cells, from 2 i p_x - middle_x - cell_x to 2 i p_x - middle_x + cell_x, lie in the span.
            first = max(-(-(left + cell_x + middle_x) // (2 * p_x)), 0)
            last = min((right - cell_x + middle_x) // (2 * p_x) + 1, n_x)
            if first < last:
                runs_of_row.append((first, last))
        runs.append(runs_of_row)
    table = np.zeros((2, max(1, *map(len, runs)), n_y), dtype=np.int64)
    for row, runs_of_row in enumerate(runs):
        if runs_of_row:
            table[:, : len(runs_of_row), row] = np.transpose(runs_of_row)
    return table[0], table[1]


def _free_spans(edges: list[_Edge], low: int, high: int) -> Iterator[tuple[int, int]]:
    """Enclosed intervals (left, right) of x that no edge enters at low < y < high, shrunk to whole numbers."""
    parts = []
    for x_1, y_1, x_2, y_2 in edges:
        if y_1 == y_2:
            ends = [x_1, x_2]
        else:
            rises = [(x_2 - x_1) * (y - y_1) for y in (max(low, y_1), min(high, y_2))]
            ends = [x_1 + rise // (y_2 - y_1) for rise in rises] + [x_1 - (-rise // (y_2 - y_1)) for rise in rises]
        parts.append((min(ends), max(ends), y_1 <= (low + high) // 2 < y_2))
    enclosed, free_from = False, 0
    for left, right, crosses in sorted(parts):
        if enclosed and free_from < left:
            yield free_from, left
        # ``free_from`` is not used before the first crossing.
        free_from = max(free_from, right) if enclosed else right
        enclosed ^= crosses
