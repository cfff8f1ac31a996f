"""The y image on the x image's grid: two passes of a short filter, along columns and then along rows.

The map from one grid to the other is smooth and turns by far less than a right angle, so that it can be done one axis
after the other. The filter is a sinc under a Kaiser window: it errs by 0.5 % at most up to 0.3 cycles a pixel, which
hold all that the lens passes but a few per cent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numerics import HAS_NUMBA, compiled_parallel, prange

_TAPS = 8
_KAISER_BETA = 4.5
#: Fractions of a pixel in the table of filters: the nearest is within 1e-3 of a pixel.
_STEPS = 512


@dataclass(frozen=True)
class Resampler:
    """A fixed map of one image onto a grid.

    Attributes:
        first_row: first row of the image that is needed.
        row: shape (n_y, n_x), place along y of each output pixel, counted from ``first_row``.
        column: shape (n_rows, n_x), place along x of each output column on each needed row.
    """

    first_row: int
    row: NDArray[np.float32]
    column: NDArray[np.float32]

    @classmethod
    def of(cls, row: FloatArray, column: FloatArray, image_shape: tuple[int, int]) -> Resampler:
        """The map that takes pixel [i, j] from the place (row[i, j], column[i, j]) of an image.

        Args:
            row: shape (n_y, n_x), rising along the first axis.
            column: the same shape.
            image_shape: shape of the images; what lies beyond an edge has the edge's value.
        """
        reach = _TAPS // 2
        first = int(np.clip(np.floor(row.min()) - reach, 0, image_shape[0] - 1))
        last = int(np.clip(np.ceil(row.max()) + reach, first, image_shape[0] - 1))
        needed = np.arange(first, last + 1, dtype=np.float64)
        on_rows = np.empty((needed.size, row.shape[1]), dtype=np.float32)
        for j in range(row.shape[1]):
            on_rows[:, j] = np.interp(needed, row[:, j], column[:, j])
        if row.shape[0] > 1:  # the filter reaches beyond the first and the last row: go on as there
            for edge, beside in ((0, 1), (-1, -2)):
                slope = (column[edge] - column[beside]) / (row[edge] - row[beside])
                beyond = needed[:, None] - row[edge]
                beyond = np.minimum(beyond, 0.0) if edge == 0 else np.maximum(beyond, 0.0)
                on_rows += (beyond * slope).astype(np.float32)
        return cls(first, np.asarray(row - first, dtype=np.float32), on_rows)

    @property
    def nbytes(self) -> int:
        """Memory of the maps."""
        return self.row.nbytes + self.column.nbytes

    def __call__(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Resample an image: shape (n_y, n_x)."""
        rows = image[self.first_row : self.first_row + self.column.shape[0]]
        along = _along_rows if HAS_NUMBA else _along_rows_plain
        down = _down_columns if HAS_NUMBA else _down_columns_plain
        return down(along(rows, self.column, _TABLE), self.row, _TABLE)


def _table() -> NDArray[np.float32]:
    """Filters for fractions 0, 1/_STEPS, ..., 1: shape (_STEPS + 1, _TAPS), each of sum 1."""
    fraction = np.arange(_STEPS + 1) / _STEPS
    away = np.arange(_TAPS) - (_TAPS // 2 - 1) - fraction[:, None]
    inside = np.sqrt(np.maximum(1.0 - (away / (_TAPS / 2)) ** 2, 0.0))
    taps = np.sinc(away) * np.i0(_KAISER_BETA * inside)
    return np.asarray(taps / taps.sum(axis=1, keepdims=True), dtype=np.float32)


_TABLE = _table()


@compiled_parallel
def _along_rows(
    image: NDArray[np.float32], column: NDArray[np.float32], table: NDArray[np.float32]
) -> NDArray[np.float32]:
    n_rows, n_x = column.shape
    last, taps, steps = image.shape[1] - 1, table.shape[1], table.shape[0] - 1
    reach = taps // 2 - 1
    out = np.empty((n_rows, n_x), dtype=np.float32)
    for i in prange(n_rows):
        for j in range(n_x):
            place = column[i, j]
            whole = int(np.floor(place))
            step = int((place - whole) * steps + 0.5)
            total = np.float32(0.0)
            if whole >= reach and whole + taps - reach <= last + 1:
                for k in range(taps):
                    total += table[step, k] * image[i, whole - reach + k]
            else:
                for k in range(taps):
                    total += table[step, k] * image[i, min(max(whole - reach + k, 0), last)]
            out[i, j] = total
    return out


@compiled_parallel
def _down_columns(
    image: NDArray[np.float32], row: NDArray[np.float32], table: NDArray[np.float32]
) -> NDArray[np.float32]:
    n_y, n_x = row.shape
    last, taps, steps = image.shape[0] - 1, table.shape[1], table.shape[0] - 1
    reach = taps // 2 - 1
    out = np.empty((n_y, n_x), dtype=np.float32)
    for i in prange(n_y):
        for j in range(n_x):
            place = row[i, j]
            whole = int(np.floor(place))
            step = int((place - whole) * steps + 0.5)
            total = np.float32(0.0)
            if whole >= reach and whole + taps - reach <= last + 1:
                for k in range(taps):
                    total += table[step, k] * image[whole - reach + k, j]
            else:
                for k in range(taps):
                    total += table[step, k] * image[min(max(whole - reach + k, 0), last), j]
            out[i, j] = total
    return out


def _along_rows_plain(
    image: NDArray[np.float32], column: NDArray[np.float32], table: NDArray[np.float32]
) -> NDArray[np.float32]:
    return _along_axis_plain(image, column, table, 1)


def _down_columns_plain(
    image: NDArray[np.float32], row: NDArray[np.float32], table: NDArray[np.float32]
) -> NDArray[np.float32]:
    return _along_axis_plain(image, row, table, 0)


def _along_axis_plain(
    image: NDArray[np.float32], place: NDArray[np.float32], table: NDArray[np.float32], axis: int
) -> NDArray[np.float32]:
    whole, step, last = *_split(place, table), image.shape[axis] - 1
    out = np.zeros(place.shape, dtype=np.float32)
    for k in range(table.shape[1]):
        at = np.clip(whole - (table.shape[1] // 2 - 1) + k, 0, last)
        out += table[step, k] * np.take_along_axis(image, at, axis=axis)
    return out


def _split(place: NDArray[np.float32], table: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    whole = np.floor(place).astype(np.intp)
    return whole, ((place - whole) * (table.shape[0] - 1) + 0.5).astype(np.intp)
