"""Continuous evaluation of a library at millions of sizes per second, each with its error bound.

A model (or, without one, the grid of sizes) is sampled once and then interpolated by bicubic B-splines. Near a sharp
resonance a tile of the plane gets a finer grid, until the spline's own error, measured between its nodes, is small
against the library's. Neighbouring tiles agree at their border to within that error.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.bicubic_spline import SplineTiles, bicubic_coefficients, left_out_error, midpoint_error
from metafab.core.parallel.executor import default_workers, one_blas_thread
from metafab.library.fit.rational import RationalModel
from metafab.library.fit.size_grid import refined_axis

#: Share of the library's target error that the spline may add, unless the finest tiles are reached first.
SPLINE_SHARE = 0.1
#: Number of sizes that one thread evaluates at a time.
BLOCK = 1 << 16
#: Steps of the uniform grid for each of the library's steps, where a model is sampled.
STEPS = 2
#: Cells of the uniform grid along each side of a tile, and steps of the finest tile's grid for each of them.
TILE, FINEST = 8, 16
#: Nodes beyond a tile that its spline passes through: the effect of a spline's end decays by 3.7 per node.
MARGIN = 10


@dataclass(frozen=True)
class SizeResponse:
    """Transmission at some sizes."""

    t_xx: ComplexArray  #: Any shape, zero-order transmission of x polarised light.
    t_yy: ComplexArray  #: Shape of ``t_xx``, zero-order transmission of y polarised light.
    error: FloatArray  #: Shape of ``t_xx``, bound on the absolute error of either.


@dataclass(frozen=True)
class Surface:
    """t_xx and t_yy of a library as functions of width and length, built once and evaluated often."""

    low_nm: tuple[float, float]  #: Smallest (width, length).
    step_nm: tuple[float, float]  #: Step of the uniform grid along (width, length).
    tiles: SplineTiles  #: Splines over its cells, with the error in each: the library's and the spline's.

    @classmethod
    def of_grid(cls, width_nm: FloatArray, length_nm: FloatArray, t: ComplexArray, error: FloatArray) -> Surface:
        """Interpolate amplitudes on a grid of uniform widths, shape (n_width,), and lengths, shape (n_length,).

        ``t``, shape (n_length, n_width, 2), holds t_xx and t_yy, ``error``, shape (n_length, n_width), that at each
        size.
        """
        return _tiled(width_nm, length_nm, bicubic_coefficients(t), _cells(left_out_error(t), 1), _cells(error, 1))

    @classmethod
    @one_blas_thread()
    def of_model(
        cls, width_nm: FloatArray, length_nm: FloatArray, model: RationalModel, error: FloatArray, target_error: float
    ) -> Surface:
        """Sample a model, finely enough that the spline adds little to the target error.

        Widths, shape (n_width,), and lengths, shape (n_length,), are uniform; ``error``, shape (n_length, n_width), is
        that of the model around each size.
        """
        fine_width, fine_length = refined_axis(width_nm, STEPS), refined_axis(length_nm, STEPS)
        coefficients, node_error = _spline(model, fine_width, fine_length)
        cell_error = np.repeat(np.repeat(_cells(error, 1), STEPS, axis=0), STEPS, axis=1)
        spline_error, allowed = _cells(node_error, 1), SPLINE_SHARE * target_error
        return _tiled(fine_width, fine_length, coefficients, spline_error, cell_error, model, allowed)

    def __call__(self, width_nm: ArrayLike, length_nm: ArrayLike) -> SizeResponse:
        """Evaluate at any sizes within the sweep (else InputError); widths and lengths of any shapes broadcast."""
        widths, lengths = np.asarray(width_nm, dtype=np.float64), np.asarray(length_nm, dtype=np.float64)
        widths, lengths = np.broadcast_arrays(widths, lengths)
        shape, width, length = widths.shape, widths.ravel(), lengths.ravel()
        self._check(width, length)
        t, error = np.empty((width.size, 2), dtype=np.complex128), np.empty(width.size)

        def evaluate_block(start: int) -> None:
            block = slice(start, start + BLOCK)
            x = (width[block] - self.low_nm[0]) / self.step_nm[0]
            y = (length[block] - self.low_nm[1]) / self.step_nm[1]
            self.tiles.evaluate(x, y, t[block], error[block])

        starts = range(0, width.size, BLOCK)
        if len(starts) > 1:
            with ThreadPoolExecutor(default_workers()) as threads:
                list(threads.map(evaluate_block, starts))
        else:
            evaluate_block(0)
        return SizeResponse(t[:, 0].reshape(shape), t[:, 1].reshape(shape), error.reshape(shape))

    def _check(self, width_nm: FloatArray, length_nm: FloatArray) -> None:
        """Refuse sizes outside the sweep, NaN included."""
        n_length, n_width = self.tiles.error.shape
        sides = (("width_nm", width_nm, n_width), ("length_nm", length_nm, n_length))
        faults = []
        for (name, size, cells), low, step in zip(sides, self.low_nm, self.step_nm, strict=True):
            high, slack = low + cells * step, 1e-9 * step
            if size.size and not (size.min() >= low - slack and size.max() <= high + slack):
                expected = f"{low:g} to {high:g} nm, the library's sweep"
                got = f"{size.min():g} to {size.max():g} nm"
                faults.append(Fault(name, expected, got, "build a library of a wider sweep"))
        if faults:
            raise InputError("library", faults)


def _tiled(
    width_nm: FloatArray,
    length_nm: FloatArray,
    coefficients: ComplexArray,
    spline_error: FloatArray,
    library_error: FloatArray,
    model: RationalModel | None = None,
    allowed: float = 0.0,
) -> Surface:
    """Cut a spline over a uniform grid into tiles and refine those whose error is too large.

    Args:
        width_nm: shape (n_width,), nodes of the grid; likewise ``length_nm``.
        coefficients: shape (n_length + 2, n_width + 2, 2).
        spline_error: shape (n_length - 1, n_width - 1), error of the spline in each cell; ``library_error``: error of
            the interpolated amplitudes.
        model: amplitudes for finer tiles; None if there are none.
        allowed: largest error of a spline before its tile is refined.
    """
    shape = spline_error.shape
    cells = min(TILE, shape[0]), min(TILE, shape[1])
    first_row, first_column = (np.minimum(np.arange(0, n, k), n - k) for n, k in zip(shape, cells, strict=True))
    parts, start = (np.zeros((first_row.size, first_column.size), dtype=np.int64) for _ in range(2))
    tile_error = np.zeros(shape)
    tables, end = [], 0
    for (a, i), (b, j) in product(enumerate(first_row.tolist()), enumerate(first_column.tolist())):
        inside = slice(i, i + cells[0]), slice(j, j + cells[1])
        table, miss, part = coefficients[i : i + cells[0] + 3, j : j + cells[1] + 3], spline_error[inside], 1
        while model is not None and miss.max() > allowed and part < FINEST:
            part *= 2
            tile_width, tile_length = width_nm[j : j + cells[1] + 1], length_nm[i : i + cells[0] + 1]
            table, miss = _finer_tile(model, tile_width, tile_length, part)
        parts[a, b], start[a, b] = part, end
        tables.append(table.reshape(-1, 2))
        end += tables[-1].shape[0]
        tile_error[inside] = np.maximum(tile_error[inside], miss)
    row = np.minimum(np.arange(shape[0]) // cells[0], first_row.size - 1)
    column = np.minimum(np.arange(shape[1]) // cells[1], first_column.size - 1)
    error = library_error + tile_error
    table = np.concatenate(tables)
    tiles = SplineTiles(cells, row, column, first_row, first_column, parts, start, table, error)
    low_nm = float(width_nm[0]), float(length_nm[0])
    return Surface(low_nm, (float(width_nm[1] - width_nm[0]), float(length_nm[1] - length_nm[0])), tiles)


def _finer_tile(
    model: RationalModel, width_nm: FloatArray, length_nm: FloatArray, parts: int
) -> tuple[ComplexArray, FloatArray]:
    """Coefficients of a finer spline over one tile, ``parts`` steps for each cell, and its error in each cell.

    ``width_nm`` and ``length_nm``, shape (n,), are nodes of the uniform grid from edge to edge of the tile. The
    spline's margin ends where the model's ranges end.
    """
    columns, left = _with_margin(refined_axis(width_nm, parts), model.width_nm)
    rows, bottom = _with_margin(refined_axis(length_nm, parts), model.length_nm)
    coefficients, node_error = _spline(model, columns, rows)
    n_row, n_column = parts * (length_nm.size - 1), parts * (width_nm.size - 1)
    table = coefficients[bottom : bottom + n_row + 3, left : left + n_column + 3]
    return table, _cells(node_error[bottom : bottom + n_row + 1, left : left + n_column + 1], parts)


def _with_margin(axis_nm: FloatArray, span_nm: tuple[float, float]) -> tuple[FloatArray, int]:
    """An axis with up to ``MARGIN`` more nodes at both ends, within a span; and the number of nodes added in front."""
    step = (axis_nm[-1] - axis_nm[0]) / (axis_nm.size - 1)
    before = min(MARGIN, int((axis_nm[0] - span_nm[0]) / step + 1e-6))
    after = min(MARGIN, int((span_nm[1] - axis_nm[-1]) / step + 1e-6))
    return axis_nm[0] + step * np.arange(-before, axis_nm.size + after), before


def _spline(model: RationalModel, width_nm: FloatArray, length_nm: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Coefficients of the spline through the model at the nodes, and its error around each of them."""
    fine = np.moveaxis(model.on_grid(refined_axis(width_nm, 2), refined_axis(length_nm, 2))[:2], 0, -1)
    coefficients = bicubic_coefficients(fine[::2, ::2])
    return coefficients, midpoint_error(coefficients, fine)


def _cells(nodes: FloatArray, parts: int) -> FloatArray:
    """Largest value among the nodes of each cell, its edges included: shape (n parts + 1, ...) -> (n, ...)."""
    windows = sliding_window_view(nodes, (parts + 1, parts + 1))[::parts, ::parts]
    return np.asarray(windows.max(axis=(-2, -1)), dtype=np.float64)
