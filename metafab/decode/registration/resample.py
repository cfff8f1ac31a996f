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
from metafab.core.numeric.compiled import HAS_NUMBA, compiled_parallel, prange

_TAPS = 8
_KAISER_BETA = 4.5
#: Fractions of a pixel in the table of filters: the nearest is within 1e-3 of a pixel.
_STEPS = 512


@dataclass(frozen=True)
class Resampler:
    """A fixed map of one image onto a grid.

    Attributes:
        first_row: first row of the image that is needed.
        row: shape (n_x, n_y), place along y of each output pixel, counted from ``first_row``.
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
        return cls(first, np.ascontiguousarray((row - first).T, dtype=np.float32), on_rows)

    @property
    def nbytes(self) -> int:
        """Memory of the maps."""
        return self.row.nbytes + self.column.nbytes

    def within(self, rows: slice, columns: slice) -> Resampler:
        """The map of some of the output's rows and columns alone, from the same image."""
        row, reach, last = self.row[columns, rows], _TAPS // 2, self.column.shape[0]
        first = int(np.clip(np.floor(row.min()) - reach, 0, last - 1))
        end = int(np.clip(np.ceil(row.max()) + reach + 1, first + 1, last))
        return Resampler(
            self.first_row + first,
            np.ascontiguousarray(row - np.float32(first)),
            np.ascontiguousarray(self.column[first:end, columns]),
        )

    def __call__(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Resample an image: shape (n_y, n_x)."""
        rows = image[self.first_row : self.first_row + self.column.shape[0]]
        across = _across if HAS_NUMBA else _across_plain
        return across(across(rows, self.column, _TABLE), self.row, _TABLE)


def _table() -> NDArray[np.float32]:
    """Filters for fractions 0, 1/_STEPS, ..., 1: shape (_STEPS + 1, _TAPS), each of sum 1."""
    fraction = np.arange(_STEPS + 1) / _STEPS
    away = np.arange(_TAPS) - (_TAPS // 2 - 1) - fraction[:, None]
    inside = np.sqrt(np.maximum(1.0 - (away / (_TAPS / 2)) ** 2, 0.0))
    taps = np.sinc(away) * np.i0(_KAISER_BETA * inside)
    return np.asarray(taps / taps.sum(axis=1, keepdims=True), dtype=np.float32)


_TABLE = _table()


@compiled_parallel
def _across(image: NDArray[np.float32], place: NDArray[np.float32], table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Each row of an image filtered at the places given for it, as a column: shape (n_places, n_rows).

    The filter's eight products are written out: they are added in pairs, at once.
    """
    n_rows, n_places = place.shape
    last, steps = image.shape[1] - 1, np.float32(table.shape[0] - 1)
    out = np.empty((n_places, n_rows), dtype=np.float32)
    for i in prange(n_rows):
        for j in range(n_places):
            whole = np.floor(place[i, j])
            step = int((place[i, j] - whole) * steps + np.float32(0.5))
            at = int(whole) - 3
            if at >= 0 and at + 7 <= last:
                a = table[step, 0] * image[i, at] + table[step, 1] * image[i, at + 1]
                b = table[step, 2] * image[i, at + 2] + table[step, 3] * image[i, at + 3]
                c = table[step, 4] * image[i, at + 4] + table[step, 5] * image[i, at + 5]
                d = table[step, 6] * image[i, at + 6] + table[step, 7] * image[i, at + 7]
                out[j, i] = (a + b) + (c + d)
            else:
                total = np.float32(0.0)
                for k in range(8):
                    total += table[step, k] * image[i, min(max(at + k, 0), last)]
                out[j, i] = total
    return out


def _across_plain(
    image: NDArray[np.float32], place: NDArray[np.float32], table: NDArray[np.float32]
) -> NDArray[np.float32]:
    whole, step, last = *_split(place, table), image.shape[1] - 1
    out = np.zeros(place.shape, dtype=np.float32)
    for k in range(_TAPS):
        out += table[step, k] * np.take_along_axis(image, np.clip(whole - 3 + k, 0, last), axis=1)
    return np.ascontiguousarray(out.T)


def _split(place: NDArray[np.float32], table: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    whole = np.floor(place).astype(np.intp)
    return whole, ((place - whole) * (table.shape[0] - 1) + 0.5).astype(np.intp)
