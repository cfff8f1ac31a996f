"""Continuous evaluation: millions of sizes a second, each with its error.

The model (or, without one, the grid itself) is sampled on a fine, uniform grid once, and sizes are looked up there
by bicubic B-splines. The fine grid is halved until the spline's own error, measured between its nodes, is small
against the library's.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve as solve_dense
from scipy.ndimage import maximum_filter

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.executor import default_workers
from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.library.library import Library, SizeResponse

#: The spline may add this part of the library's target error, unless the finest grid is reached first.
SPLINE_SHARE = 0.1
#: A spline may miss so much more beside the places where its misses are measured.
BETWEEN = 1.25
#: Sizes that one thread evaluates at a time.
BLOCK = 1 << 16
#: Cells of the fine grid along each axis, at most.
LARGEST_GRID = 1024


@dataclass(frozen=True)
class Surface:
    """t_xx and t_yy of a library as functions of width and length, built once and evaluated often.

    Attributes:
        low_nm: smallest (width, length).
        step_nm: step of the fine grid along (width, length).
        coefficients: shape (n_length + 2, n_width + 2, 2), B-spline coefficients of t_xx and t_yy.
        error: shape (n_length, n_width), error at the fine grid's nodes: the library's and the spline's.
    """

    low_nm: tuple[float, float]
    step_nm: tuple[float, float]
    coefficients: ComplexArray
    error: FloatArray

    @classmethod
    def of(cls, library: Library) -> Surface:
        """Sample a library's model finely enough; without a model, its grid as it is.

        Raises:
            InputError: the library has fewer than four widths or lengths.
        """
        if min(library.width_nm.size, library.length_nm.size) < 4:
            got = f"{library.width_nm.size} widths and {library.length_nm.size} lengths"
            raise InputError.single("library", "sweep", "at least 4 sizes a side", got, "sweep a range of sizes")
        if library.model is None:
            t = np.stack([library.t_xx[0], library.t_yy[0]], axis=-1)
            missed = _grid_spline_error(t)
            return _surface(library, library.width_nm, library.length_nm, _coefficients(t), missed)
        steps, allowed = 2, SPLINE_SHARE * library.unit_cell.sweep.target_error
        while True:
            width_nm, length_nm = (_refined(axis, steps) for axis in (library.width_nm, library.length_nm))
            fine = np.moveaxis(library.model.on_grid(_refined(width_nm, 2), _refined(length_nm, 2))[:2], 0, -1)
            coefficients = _coefficients(fine[::2, ::2])
            missed = _spline_error(coefficients, fine)
            if missed.max() <= allowed or 2 * max(width_nm.size, length_nm.size) > LARGEST_GRID:
                return _surface(library, width_nm, length_nm, coefficients, missed)
            steps *= 2

    @property
    def nbytes(self) -> int:
        """Memory of the tables."""
        return int(self.coefficients.nbytes + self.error.nbytes)

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
            _evaluate(self.coefficients, self.error, column, row, t[block], error[block])

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
        """Refuse sizes outside the fine grid, NaN included."""
        n_length, n_width = self.error.shape
        faults = []
        for name, size, low, step, nodes in zip(
            ("width_nm", "length_nm"), (width_nm, length_nm), *self._grid, (n_width, n_length), strict=True
        ):
            high, slack = low + (nodes - 1) * step, 1e-9 * step
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


def _surface(
    library: Library, width_nm: FloatArray, length_nm: FloatArray, coefficients: ComplexArray, missed: FloatArray
) -> Surface:
    of_grid = np.broadcast_to(library.error, library.t_xx.shape)[0]
    stated = of_grid if library.model_error is None else np.maximum(of_grid, library.model_error)
    # A node's error is that of the grid's nearest sizes, the larger where it lies between two.
    for axis, (fine, coarse) in enumerate(((length_nm, library.length_nm), (width_nm, library.width_nm))):
        place = (fine - coarse[0]) / (coarse[1] - coarse[0])
        low = np.clip(np.floor(place + 1e-6).astype(int), 0, coarse.size - 1)
        high = np.clip(np.ceil(place - 1e-6).astype(int), 0, coarse.size - 1)
        stated = np.maximum(np.take(stated, low, axis=axis), np.take(stated, high, axis=axis))
    return Surface(
        low_nm=(float(width_nm[0]), float(length_nm[0])),
        step_nm=(float(width_nm[1] - width_nm[0]), float(length_nm[1] - length_nm[0])),
        coefficients=coefficients,
        error=stated + missed,
    )


def _refined(axis_nm: FloatArray, steps: int) -> FloatArray:
    return np.linspace(axis_nm[0], axis_nm[-1], (axis_nm.size - 1) * steps + 1)


def _coefficients(values: ComplexArray) -> ComplexArray:
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


def _spline_error(coefficients: ComplexArray, fine: ComplexArray) -> FloatArray:
    """Largest miss of a spline around each of its nodes, measured half-way between them in both directions.

    A cubic spline misses most near the middle of an interval, by symmetry exactly there for a fourth derivative that
    is constant; ``BETWEEN`` is for ridges so sharp that it is not.

    Args:
        coefficients: shape (n_length + 2, n_width + 2, 2).
        fine: shape (2 n_length - 1, 2 n_width - 1, 2), the truth at the nodes and half-way.
    """
    n_length, n_width = coefficients.shape[0] - 2, coefficients.shape[1] - 2
    row, column = np.meshgrid(*(0.5 * np.arange(2 * n - 1) for n in (n_length, n_width)), indexing="ij")
    held, unused = np.empty((row.size, 2), dtype=np.complex128), np.empty(row.size)
    _evaluate(coefficients, np.zeros((n_length, n_width)), column.ravel(), row.ravel(), held, unused)
    missed = np.abs(held.reshape(fine.shape) - fine).max(axis=-1)
    return np.asarray(BETWEEN * maximum_filter(missed, size=3, mode="nearest")[::2, ::2], dtype=np.float64)


def _grid_spline_error(t: ComplexArray) -> FloatArray:
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


def _evaluate_plain(
    coefficients: ComplexArray,
    node_error: FloatArray,
    column: FloatArray,
    row: FloatArray,
    t: ComplexArray,
    error: FloatArray,
) -> None:
    """Fill ``t`` and ``error`` at fractional grid positions (NumPy)."""
    n_length, n_width = node_error.shape
    i = np.clip(row.astype(np.int64), 0, n_length - 2)
    j = np.clip(column.astype(np.int64), 0, n_width - 2)
    w_row, w_column = _weights(row - i), _weights(column - j)
    t[:] = 0.0
    for a in range(4):
        for b in range(4):
            t += (w_row[a] * w_column[b])[:, None] * coefficients[i + a, j + b]
    error[:] = np.maximum(
        np.maximum(node_error[i, j], node_error[i + 1, j]), np.maximum(node_error[i, j + 1], node_error[i + 1, j + 1])
    )


def _weights(f: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The four cubic B-splines that reach a point at the fraction ``f`` of its interval."""
    g = 1.0 - f
    return (
        g * g * g / 6.0,
        (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0,
        (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0,
        f * f * f / 6.0,
    )


def _evaluate_loop(
    coefficients: FloatArray,
    node_error: FloatArray,
    column: FloatArray,
    row: FloatArray,
    t: ComplexArray,
    error: FloatArray,
) -> None:
    """The same, one size at a time (compiled); real and imaginary parts apart, which is 1.7 times faster."""
    n_length, n_width = node_error.shape
    for k in range(row.size):
        i = min(max(int(row[k]), 0), n_length - 2)
        j = min(max(int(column[k]), 0), n_width - 2)
        f, h = row[k] - i, column[k] - j
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
        for a in range(4):
            for b in range(4):
                weight = w[a] * v[b]
                x_re += weight * coefficients[i + a, j + b, 0]
                x_im += weight * coefficients[i + a, j + b, 1]
                y_re += weight * coefficients[i + a, j + b, 2]
                y_im += weight * coefficients[i + a, j + b, 3]
        t[k, 0] = complex(x_re, x_im)
        t[k, 1] = complex(y_re, y_im)
        error[k] = max(node_error[i, j], node_error[i + 1, j], node_error[i, j + 1], node_error[i + 1, j + 1])


_compiled_loop = compiled(_evaluate_loop)


def _evaluate_fast(
    coefficients: ComplexArray,
    node_error: FloatArray,
    column: FloatArray,
    row: FloatArray,
    t: ComplexArray,
    error: FloatArray,
) -> None:
    _compiled_loop(coefficients.view(np.float64), node_error, column, row, t, error)


_evaluate = _evaluate_fast if HAS_NUMBA else _evaluate_plain
