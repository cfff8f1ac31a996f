"""Continuous evaluation: millions of sizes a second, each with its error.

The model (or, without one, the grid itself) is sampled once and looked up by bicubic B-splines. Where a resonance is
sharp, a tile of the plane gets a finer grid of its own, until the spline's own error, measured between its nodes, is
small against the library's. Neighbouring tiles agree where they meet to within that error.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.compiled import HAS_NUMBA
from metafab.core.parallel.executor import default_workers
from metafab.library.fit.models import SizeModel
from metafab.library.library import SMALLEST_SURFACE, Library, SizeResponse
from metafab.library.spline import Tiles, coefficients_of, grid_spline_error, spline_error

#: The spline may add this part of the library's target error, unless the finest tiles are reached first.
SPLINE_SHARE = 0.1
#: Sizes that one thread evaluates at a time.
BLOCK = 1 << 16
#: Steps of the uniform grid for each of the library's own, where there is a model to sample.
STEPS = 2
#: Cells of the uniform grid along each side of a tile, and steps of the finest tile's grid for each of them.
TILE, FINEST = 8, 16
#: Nodes beyond a tile that its spline goes through: what the end of a spline does fades by 3.7 from node to node.
MARGIN = 10


@dataclass(frozen=True)
class Surface:
    """t_xx and t_yy of a library as functions of width and length, built once and evaluated often.

    Attributes:
        low_nm: smallest (width, length).
        step_nm: step of the uniform grid along (width, length).
        tiles: splines over its cells, with the error in each: the library's and the spline's.
    """

    low_nm: tuple[float, float]
    step_nm: tuple[float, float]
    tiles: Tiles

    @classmethod
    def of(cls, library: Library) -> Surface:
        """Sample a library's model finely enough; without a model, its grid as it is.

        Raises:
            InputError: the library has fewer than four widths or lengths, or none but circles.
        """
        if not library.known.all():
            expected = "a library of widths and lengths, which is continuous in both"
            raise InputError.single("library", "cell.shape", expected, "circles", "ask for sizes of the grid")
        if min(library.width_nm.size, library.length_nm.size) < SMALLEST_SURFACE:
            got = f"{library.width_nm.size} widths and {library.length_nm.size} lengths"
            raise InputError.single("library", "sweep", "at least 4 sizes a side", got, "sweep a range of sizes")
        if library.model is None:
            width_nm, length_nm = library.width_nm, library.length_nm
            t = np.stack([library.t_xx[0], library.t_yy[0]], axis=-1)
            coefficients, missed = coefficients_of(t), grid_spline_error(t)
        else:
            width_nm, length_nm = (_refined(axis, STEPS) for axis in (library.width_nm, library.length_nm))
            coefficients, missed = _spline(library.model, width_nm, length_nm)
        tiles = _tiles(library, width_nm, length_nm, coefficients, _cells(missed, 1))
        return cls(
            low_nm=(float(width_nm[0]), float(length_nm[0])),
            step_nm=(float(width_nm[1] - width_nm[0]), float(length_nm[1] - length_nm[0])),
            tiles=tiles,
        )

    @property
    def nbytes(self) -> int:
        """Memory of the tables."""
        return self.tiles.nbytes

    def __call__(self, width_nm: ArrayLike, length_nm: ArrayLike) -> SizeResponse:
        """Values at any sizes within the sweep.

        Args:
            width_nm: any shape.
            length_nm: a shape that broadcasts with it.

        Raises:
            InputError: a size lies outside the sweep (nothing is extrapolated).
        """
        width, length = np.broadcast_arrays(
            np.asarray(width_nm, dtype=np.float64), np.asarray(length_nm, dtype=np.float64)
        )
        flat = width.ravel(), length.ravel()
        self._check(*flat)
        t, error = np.empty((width.size, 2), dtype=np.complex128), np.empty(width.size)

        def fill(start: int) -> None:
            block = slice(start, start + BLOCK)
            column, row = ((size[block] - low) / step for size, low, step in zip(flat, *self._grid, strict=True))
            self.tiles.fill(column, row, t[block], error[block])

        starts = range(0, width.size, BLOCK)
        if len(starts) > 1 and HAS_NUMBA:  # compiled loops run side by side, without the interpreter's lock
            with ThreadPoolExecutor(default_workers()) as threads:
                list(threads.map(fill, starts))
        else:
            for start in starts:
                fill(start)
        return SizeResponse(t[:, 0].reshape(width.shape), t[:, 1].reshape(width.shape), error.reshape(width.shape))

    @property
    def _grid(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.low_nm, self.step_nm

    def _check(self, width_nm: FloatArray, length_nm: FloatArray) -> None:
        """Refuse sizes outside the sweep, NaN included."""
        n_length, n_width = self.tiles.error.shape
        faults = []
        for name, size, low, step, cells in zip(
            ("width_nm", "length_nm"), (width_nm, length_nm), *self._grid, (n_width, n_length), strict=True
        ):
            high, slack = low + cells * step, 1e-9 * step
            if size.size and not (size.min() >= low - slack and size.max() <= high + slack):
                faults.append(
                    Fault(
                        name,
                        f"{low:g} to {high:g} nm, the library's sweep",
                        f"{size.min():g} to {size.max():g} nm",
                        "build a library of a wider sweep",
                    )
                )
        if faults:
            raise InputError("library", faults)


def evaluate(library: Library, width_nm: ArrayLike, length_nm: ArrayLike, **axes: float) -> SizeResponse:
    """Continuous values of a library; the :class:`Surface` behind is built at the first call and kept with it.

    ``axes`` name a corner (``wavelength_nm=803.0``); to evaluate one often, keep ``library.at(...)``.

    Raises:
        InputError: a size lies outside the sweep, or a corner outside the library's axes.
    """
    return library.at(**axes).surface(width_nm, length_nm)


def _tiles(
    library: Library, width_nm: FloatArray, length_nm: FloatArray, coefficients: ComplexArray, missed: FloatArray
) -> Tiles:
    """Cut a spline of the uniform grid into tiles, those anew where it misses too much.

    Args:
        library: with a model, if tiles are to be refined.
        width_nm: nodes of the uniform grid; likewise ``length_nm``.
        length_nm: see ``width_nm``.
        coefficients: shape (n_length + 2, n_width + 2, 2).
        missed: shape (n_length - 1, n_width - 1), what the spline misses in each cell.
    """
    allowed = SPLINE_SHARE * library.unit_cell.sweep.target_error
    cells = min(TILE, missed.shape[0]), min(TILE, missed.shape[1])
    firsts = [np.minimum(np.arange(0, n, k), n - k) for n, k in zip(missed.shape, cells, strict=True)]
    parts, start = (np.zeros((firsts[0].size, firsts[1].size), dtype=np.int64) for _ in range(2))
    own_missed = np.zeros(missed.shape)
    tables, end = [], 0
    for (a, i), (b, j) in product(enumerate(firsts[0].tolist()), enumerate(firsts[1].tolist())):
        inside = slice(i, i + cells[0]), slice(j, j + cells[1])
        table, miss, part = coefficients[i : i + cells[0] + 3, j : j + cells[1] + 3], missed[inside], 1
        if library.model is not None:
            finer = _finer(library.model, width_nm[j : j + cells[1] + 1], length_nm[i : i + cells[0] + 1])
            while miss.max() > allowed and part < FINEST:
                part, table, miss = next(finer)
        parts[a, b], start[a, b] = part, end
        tables.append(table.reshape(-1, 2))
        end += tables[-1].shape[0]
        own_missed[inside] = np.maximum(own_missed[inside], miss)
    row, column = (
        np.minimum(np.arange(n) // k, first.size - 1) for n, k, first in zip(missed.shape, cells, firsts, strict=True)
    )
    error = _stated(library, width_nm, length_nm) + own_missed
    table = np.concatenate(tables)
    return Tiles(cells, row, column, firsts[0], firsts[1], parts, start, table, error)


def _finer(
    model: SizeModel, width_nm: FloatArray, length_nm: FloatArray
) -> Iterator[tuple[int, ComplexArray, FloatArray]]:
    """Ever finer splines over one tile: steps for each cell, coefficients, and what is missed in each cell.

    Args:
        model: what they go through; it holds over its own ranges only, where the margin ends.
        width_nm: nodes of the uniform grid from edge to edge of the tile; likewise ``length_nm``.
        length_nm: see ``width_nm``.
    """
    part = 1
    while True:
        part *= 2
        (columns, left), (rows, low) = (
            _with_margin(_refined(axis, part), span)
            for axis, span in ((width_nm, model.x.width_nm), (length_nm, model.x.length_nm))
        )
        coefficients, missed = _spline(model, columns, rows)
        n_row, n_column = (part * (axis.size - 1) for axis in (length_nm, width_nm))
        table = coefficients[low : low + n_row + 3, left : left + n_column + 3]
        yield part, table, _cells(missed[low : low + n_row + 1, left : left + n_column + 1], part)


def _with_margin(axis_nm: FloatArray, span_nm: tuple[float, float]) -> tuple[FloatArray, int]:
    """An axis with up to ``MARGIN`` more nodes at both ends, within a span; and how many came before its own."""
    step = (axis_nm[-1] - axis_nm[0]) / (axis_nm.size - 1)
    before = min(MARGIN, int((axis_nm[0] - span_nm[0]) / step + 1e-6))
    after = min(MARGIN, int((span_nm[1] - axis_nm[-1]) / step + 1e-6))
    return axis_nm[0] + step * np.arange(-before, axis_nm.size + after), before


def _spline(model: SizeModel, width_nm: FloatArray, length_nm: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Coefficients of the spline through the model at the nodes, and what it misses around each of them."""
    fine = np.moveaxis(model.on_grid(_refined(width_nm, 2), _refined(length_nm, 2))[:2], 0, -1)
    coefficients = coefficients_of(fine[::2, ::2])
    return coefficients, spline_error(coefficients, fine)


def _stated(library: Library, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
    """The library's error in each cell of the uniform grid: the largest of the sizes around it."""
    stated = library.error_of_sizes
    if library.model_error is not None:
        stated = np.maximum(stated, library.model_error)
    cells = _cells(stated, 1)
    for axis, (fine, coarse) in enumerate(((length_nm, library.length_nm), (width_nm, library.width_nm))):
        cells = np.repeat(cells, (fine.size - 1) // (coarse.size - 1), axis=axis)
    return cells


def _cells(nodes: FloatArray, parts: int) -> FloatArray:
    """Largest value among the nodes of each cell, its edges included: shape (n p + 1, ...) -> (n, ...)."""
    windows = sliding_window_view(nodes, (parts + 1, parts + 1))[::parts, ::parts]
    return np.asarray(windows.max(axis=(-2, -1)), dtype=np.float64)


def _refined(axis_nm: FloatArray, steps: int) -> FloatArray:
    return np.linspace(axis_nm[0], axis_nm[-1], (axis_nm.size - 1) * steps + 1)
