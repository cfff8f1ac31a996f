"""Bicubic B-splines on tiles: coefficients, errors, and compiled evaluation.

A tile is a rectangle of cells of one uniform grid. Each tile has a grid of its own, finer by a whole number. The
coefficients of all tiles lie in one table, row by row, so that a fine grid costs memory only where it is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve as solve_dense
from scipy.ndimage import maximum_filter

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled

IntArray = NDArray[np.int64]

#: Safety factor on errors that are measured half-way between the nodes.
SAFETY = 1.25


@dataclass(frozen=True)
class SplineTiles:
    """Splines of two functions over the cells of a uniform grid."""

    cells: tuple[int, int]  #: Cells of one tile along (y, x).
    row: IntArray  #: Shape (n_y,), index of the tile of each row of cells.
    column: IntArray  #: Shape (n_x,), index of the tile of each column of cells.
    first_row: IntArray  #: Shape (n_tiles_y,), first cell of each tile; the last tile may overlap the one before.
    first_column: IntArray  #: Shape (n_tiles_x,), first cell of each tile.
    parts: IntArray  #: Shape (n_tiles_y, n_tiles_x), steps of a tile's grid for each cell.
    start: IntArray  #: Shape (n_tiles_y, n_tiles_x), first row of ``coefficients`` of each tile.
    coefficients: ComplexArray  #: Shape (n_coefficients, 2).
    error: FloatArray  #: Shape (n_y, n_x), error in each cell.

    @property
    def nbytes(self) -> int:
        """Memory of the tables."""
        return int(self.coefficients.nbytes + self.error.nbytes)

    def evaluate(self, x: FloatArray, y: FloatArray, values: ComplexArray, error: FloatArray) -> None:
        """Evaluate the splines at fractional cell coordinates of the uniform grid; runs without the GIL.

        Columns ``x`` and rows ``y`` have the shape (n,); ``values``, shape (n, 2), receives both functions and
        ``error``, shape (n,), the error of the cell.
        """
        tiles = self.row, self.column, self.first_row, self.first_column, self.parts, self.start
        coefficients = self.coefficients.view(np.float64)  # real and imaginary parts side by side
        _evaluate(*self.cells, *tiles, coefficients, self.error, x, y, values, error)


def bicubic_coefficients(values: ComplexArray) -> ComplexArray:
    """Return the coefficients of the bicubic B-spline through values on a uniform grid.

    Values have the shape (n_y, n_x, n_channels), coefficients (n_y + 2, n_x + 2, n_channels). The ends are free of a
    knot next to the edge (not-a-knot conditions).
    """
    for _ in range(2):  # each pass treats the first axis and swaps the two
        count = values.shape[0]
        rows = np.zeros((count + 2, count + 2))
        inner = np.arange(count)
        for shift, weight in enumerate((1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)):
            rows[inner + 1, inner + shift] = weight
        rows[0, :5] = rows[-1, -5:] = (1.0, -4.0, 6.0, -4.0, 1.0)
        right = np.zeros((count + 2, *values.shape[1:]), dtype=np.complex128)
        right[1:-1] = values
        solved = solve_dense(rows, right.reshape(count + 2, -1)).reshape(right.shape)
        values = np.asarray(np.swapaxes(solved, 0, 1), dtype=np.complex128)
    return np.ascontiguousarray(values)


def midpoint_error(coefficients: ComplexArray, fine: ComplexArray) -> FloatArray:
    """Return the largest error of a spline around each node, measured half-way between nodes in both directions.

    For a constant fourth derivative the error of a cubic spline is largest exactly half-way. ``SAFETY`` covers ridges
    for which it is not constant. Coefficients have the shape (n_y + 2, n_x + 2, n_channels), the exact values at the
    nodes and half-way (2 n_y - 1, 2 n_x - 1, n_channels), the errors (n_y, n_x).
    """
    values = coefficients
    for axis in (0, 1):
        moved = np.moveaxis(values, axis, 0)
        nodes = (moved[:-2] + 4.0 * moved[1:-1] + moved[2:]) / 6.0
        middles = (moved[:-3] + 23.0 * moved[1:-2] + 23.0 * moved[2:-1] + moved[3:]) / 48.0
        both = np.empty((2 * nodes.shape[0] - 1, *nodes.shape[1:]), dtype=np.complex128)
        both[::2], both[1::2] = nodes, middles
        values = np.moveaxis(both, 0, axis)
    miss = np.abs(values - fine).max(axis=-1)
    return np.asarray(SAFETY * maximum_filter(miss, size=3, mode="nearest")[::2, ::2], dtype=np.float64)


def left_out_error(values: ComplexArray) -> FloatArray:
    """Return the error of cubics through every other node at the nodes left out, spread to neighbouring nodes.

    Values have the shape (n_y, n_x, n_channels), errors (n_y, n_x). Where an axis has fewer than seven nodes, the
    error is the largest magnitude of all values.
    """
    miss = np.zeros(values.shape[:2])
    for axis in (0, 1):
        moved = np.moveaxis(values, axis, 0)
        if moved.shape[0] < 7:
            return np.full(values.shape[:2], np.abs(values).max())
        full = np.zeros((moved.shape[0], moved.shape[1]))
        for first in (0, 1):  # odd nodes are left out, then even ones
            coarse = moved[first::2]
            if coarse.shape[0] < 4:
                continue
            middle = (-coarse[:-3] + 9.0 * coarse[1:-2] + 9.0 * coarse[2:-1] - coarse[3:]) / 16.0
            # The outermost intervals lack a node on one side: the cubic goes on from the other.
            low, high = ((5.0 * a + 15.0 * b - 5.0 * c + d) / 16.0 for a, b, c, d in (coarse[:4], coarse[:-5:-1]))
            found = np.concatenate([low[None], middle, high[None]])
            left_out = slice(first + 1, first + 2 * found.shape[0], 2)
            full[left_out] = np.abs(found - moved[left_out]).max(axis=-1)
        miss = np.maximum(miss, full if axis == 0 else full.T)
    return np.asarray(maximum_filter(miss, size=3, mode="nearest"), dtype=np.float64)


@compiled
def _evaluate(
    tile_rows: int,
    tile_columns: int,
    tile_row: IntArray,
    tile_column: IntArray,
    first_row: IntArray,
    first_column: IntArray,
    parts: IntArray,
    start: IntArray,
    coefficients: FloatArray,
    cell_error: FloatArray,
    x: FloatArray,
    y: FloatArray,
    values: ComplexArray,
    error: FloatArray,
) -> None:
    """Evaluate point by point, with real and imaginary parts apart, which is 1.7 times faster."""
    n_y, n_x = cell_error.shape
    for n in range(y.size):
        i = min(max(int(y[n]), 0), n_y - 1)
        j = min(max(int(x[n]), 0), n_x - 1)
        a, b = tile_row[i], tile_column[j]
        part = parts[a, b]
        fine_y, fine_x = (y[n] - first_row[a]) * part, (x[n] - first_column[b]) * part
        k = min(max(int(fine_y), 0), tile_rows * part - 1)
        m = min(max(int(fine_x), 0), tile_columns * part - 1)
        stride = tile_columns * part + 3
        first = start[a, b] + k * stride + m
        f, h = fine_y - k, fine_x - m
        g, e = 1.0 - f, 1.0 - h
        w = (
            g * g * g / 6.0,
            (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0,
            (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0,
            f * f * f / 6.0,
        )
        v = (
            e * e * e / 6.0,
            (4.0 - 6.0 * h * h + 3.0 * h * h * h) / 6.0,
            (4.0 - 6.0 * e * e + 3.0 * e * e * e) / 6.0,
            h * h * h / 6.0,
        )
        re_0, im_0, re_1, im_1 = 0.0, 0.0, 0.0, 0.0
        for c in range(4):
            for d in range(4):
                weight = w[c] * v[d]
                place = first + c * stride + d
                re_0 += weight * coefficients[place, 0]
                im_0 += weight * coefficients[place, 1]
                re_1 += weight * coefficients[place, 2]
                im_1 += weight * coefficients[place, 3]
        values[n, 0] = complex(re_0, im_0)
        values[n, 1] = complex(re_1, im_1)
        error[n] = cell_error[i, j]
