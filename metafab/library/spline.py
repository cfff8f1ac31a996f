"""Bicubic B-splines on tiles: their coefficients, what they miss, and the loop that evaluates them.

A tile is a rectangle of cells of one uniform grid, with a grid of its own that is finer by a whole number. Its
coefficients lie together, row by row, in one table for all tiles, so that a fine grid costs memory only where it is
needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve as solve_dense
from scipy.ndimage import maximum_filter

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import HAS_NUMBA, compiled

IntArray = NDArray[np.int64]

#: A spline may miss so much more beside the places where its misses are measured.
BETWEEN = 1.25


@dataclass(frozen=True)
class Tiles:
    """Splines of two functions (t_xx and t_yy) over the cells of a uniform grid.

    Attributes:
        cells: cells of one tile along (length, width).
        row: shape (n_length,), the tile of each row of cells; likewise ``column``.
        column: shape (n_width,).
        first_row: shape (tiles_length,), the first cell of each tile; likewise ``first_column``. The last tile may
            overlap the one before.
        first_column: shape (tiles_width,).
        parts: shape (tiles_length, tiles_width), steps of a tile's own grid for each cell.
        start: the same shape, the row of ``coefficients`` where a tile's begin.
        coefficients: shape (n, 2).
        error: shape (n_length, n_width), error in each cell.
    """

    cells: tuple[int, int]
    row: IntArray
    column: IntArray
    first_row: IntArray
    first_column: IntArray
    parts: IntArray
    start: IntArray
    coefficients: ComplexArray
    error: FloatArray

    @property
    def nbytes(self) -> int:
        """Memory of the tables."""
        return int(self.coefficients.nbytes + self.error.nbytes)

    def fill(self, column: FloatArray, row: FloatArray, t: ComplexArray, error: FloatArray) -> None:
        """Values at fractional places of the uniform grid: shape (n,) each -> ``t`` (n, 2) and ``error`` (n,)."""
        fill = fill_compiled if HAS_NUMBA else fill_plain
        fill(self, column, row, t, error)


def coefficients_of(values: ComplexArray) -> ComplexArray:
    """Coefficients of the bicubic B-spline through values on a uniform grid, without a knot beside the edges."""
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


def spline_error(coefficients: ComplexArray, fine: ComplexArray) -> FloatArray:
    """Largest miss of a spline around each of its nodes, measured half-way between them in both directions.

    A cubic spline misses most near the middle of an interval, by symmetry exactly there for a fourth derivative that
    is constant; ``BETWEEN`` is for ridges so sharp that it is not.

    Args:
        coefficients: shape (n_length + 2, n_width + 2, 2).
        fine: shape (2 n_length - 1, 2 n_width - 1, 2), the truth at the nodes and half-way.
    """
    values = coefficients
    for axis in (0, 1):
        moved = np.moveaxis(values, axis, 0)
        nodes = (moved[:-2] + 4.0 * moved[1:-1] + moved[2:]) / 6.0
        middles = (moved[:-3] + 23.0 * moved[1:-2] + 23.0 * moved[2:-1] + moved[3:]) / 48.0
        both = np.empty((2 * nodes.shape[0] - 1, *nodes.shape[1:]), dtype=np.complex128)
        both[::2], both[1::2] = nodes, middles
        values = np.moveaxis(both, 0, axis)
    missed = np.abs(values - fine).max(axis=-1)
    return np.asarray(BETWEEN * maximum_filter(missed, size=3, mode="nearest")[::2, ::2], dtype=np.float64)


def grid_spline_error(t: ComplexArray) -> FloatArray:
    """How far cubics through every other node miss the nodes left out, spread to the nodes beside them."""
    missed = np.zeros(t.shape[:2])
    for axis in (0, 1):
        moved = np.moveaxis(t, axis, 0)
        coarse = moved[::2]
        if coarse.shape[0] < 4:
            return np.full(t.shape[:2], np.abs(t).max())
        middle = (-coarse[:-3] + 9.0 * coarse[1:-2] + 9.0 * coarse[2:-1] - coarse[3:]) / 16.0
        gone = np.abs(middle - moved[3::2][: middle.shape[0]]).max(axis=-1)
        full = np.zeros((moved.shape[0], moved.shape[1]))
        full[3 : 3 + 2 * gone.shape[0] : 2] = gone
        # The outermost interval has no four nodes around it: the nearest inner value stands for it.
        full[:3] = full[3]
        full[2 + 2 * gone.shape[0] :] = full[1 + 2 * gone.shape[0]]
        missed = np.maximum(missed, full if axis == 0 else full.T)
    return np.asarray(maximum_filter(missed, size=3, mode="nearest"), dtype=np.float64)


def fill_plain(tiles: Tiles, column: FloatArray, row: FloatArray, t: ComplexArray, error: FloatArray) -> None:
    """Fill ``t`` and ``error`` at fractional places of the grid (NumPy)."""
    n_length, n_width = tiles.error.shape
    i, j = np.clip(row.astype(np.int64), 0, n_length - 1), np.clip(column.astype(np.int64), 0, n_width - 1)
    a, b = tiles.row[i], tiles.column[j]
    parts = tiles.parts[a, b]
    y, x = (row - tiles.first_row[a]) * parts, (column - tiles.first_column[b]) * parts
    k, m = (
        np.clip(y.astype(np.int64), 0, tiles.cells[0] * parts - 1),
        np.clip(x.astype(np.int64), 0, tiles.cells[1] * parts - 1),
    )
    stride = tiles.cells[1] * parts + 3
    first = tiles.start[a, b] + k * stride + m
    w_row, w_column = _weights(y - k), _weights(x - m)
    t[:] = 0.0
    for c in range(4):
        for d in range(4):
            t += (w_row[c] * w_column[d])[:, None] * tiles.coefficients[first + c * stride + d]
    error[:] = tiles.error[i, j]


def _weights(f: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The four cubic B-splines that reach a point at the fraction ``f`` of its interval."""
    g = 1.0 - f
    return (
        g * g * g / 6.0,
        (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0,
        (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0,
        f * f * f / 6.0,
    )


def _loop(
    tile_length: int,
    tile_width: int,
    tile_row: IntArray,
    tile_column: IntArray,
    first_row: IntArray,
    first_column: IntArray,
    parts: IntArray,
    start: IntArray,
    coefficients: FloatArray,
    cell_error: FloatArray,
    column: FloatArray,
    row: FloatArray,
    t: ComplexArray,
    error: FloatArray,
) -> None:
    """The same, one size at a time (compiled); real and imaginary parts apart, which is 1.7 times faster."""
    n_length, n_width = cell_error.shape
    for n in range(row.size):
        i = min(max(int(row[n]), 0), n_length - 1)
        j = min(max(int(column[n]), 0), n_width - 1)
        a, b = tile_row[i], tile_column[j]
        part = parts[a, b]
        y, x = (row[n] - first_row[a]) * part, (column[n] - first_column[b]) * part
        k = min(max(int(y), 0), tile_length * part - 1)
        m = min(max(int(x), 0), tile_width * part - 1)
        stride = tile_width * part + 3
        first = start[a, b] + k * stride + m
        f, h = y - k, x - m
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
        x_re, x_im, y_re, y_im = 0.0, 0.0, 0.0, 0.0
        for c in range(4):
            for d in range(4):
                weight = w[c] * v[d]
                place = first + c * stride + d
                x_re += weight * coefficients[place, 0]
                x_im += weight * coefficients[place, 1]
                y_re += weight * coefficients[place, 2]
                y_im += weight * coefficients[place, 3]
        t[n, 0] = complex(x_re, x_im)
        t[n, 1] = complex(y_re, y_im)
        error[n] = cell_error[i, j]


_compiled_loop = compiled(_loop)


def fill_compiled(tiles: Tiles, column: FloatArray, row: FloatArray, t: ComplexArray, error: FloatArray) -> None:
    """The same as :func:`fill_plain` where Numba is installed."""
    _compiled_loop(
        *tiles.cells,
        tiles.row,
        tiles.column,
        tiles.first_row,
        tiles.first_column,
        tiles.parts,
        tiles.start,
        tiles.coefficients.view(np.float64),
        tiles.error,
        column,
        row,
        t,
        error,
    )
