"""Pairs of rectangles that are near each other, of any lattice, in the memory of a few rows.

A sweep along x. Rectangles go into rows as high as a pillar's cell and the smallest gap, each sorted along x. A
rectangle can then be too near only to its successors in its own row, within its width and the gap, and to a few in the
row above. Rows are kept in bands. The shapes are read twice: counted first, which shows when all rectangles of a row
have come, then placed. A band that is complete, as is the row above it, is compared and released. A file that is
written tile by tile thus needs no more memory than the bands of two rows of tiles.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.drc.report import MARKERS
from metafab.layout.gaps import signed_square
from metafab.mask.shapes.hierarchy import IntArray

#: Rows of a band.
_BAND_ROWS = 128
#: Bands that wait to be compared; beyond, the reader waits.
_WAITING = 2


@dataclass(frozen=True, eq=False)
class Near:
    """Pairs of rectangles that are too near."""

    smallest_square: float  #: Smallest signed square of a distance over all pairs that were compared.
    counts: IntArray  #: Shape (3,), number of pairs too near, of these overlapping or touching, of these equal.
    one: IntArray  #: Shape (m, 4), x, y, width, length of the first rectangles of up to :data:`MARKERS` pairs.
    other: IntArray  #: Shape (m, 4), the second rectangles of these pairs.
    kind: IntArray  #: Shape (m,), 0 too near, 1 overlapping, 2 equal.


@dataclass
class _Band:
    """The rectangles of some rows, with room for those of the row above."""

    start: IntArray  #: Shape (rows + 2,), index of the first rectangle of each row; the last row is the row above.
    filled: IntArray  #: Shape (rows,), index after the last rectangle placed in each row.
    corner: NDArray[np.int32]  #: Shape (n, 2), x and y, file units.
    size: NDArray[np.uint16]  #: Shape (n, 2), width and length, file units.

    def sort(self) -> _Row:
        """Sort each row along x; return a copy of the first row, for the band below."""
        _sort(self.start[:-1], self.corner, self.size)
        end = self.start[1]
        return _Row(self.corner[:end].copy(), self.size[:end].copy())

    def add_above(self, row: _Row) -> None:
        """Append the row above."""
        first, end = self.start[-2:]
        self.corner[first:end], self.size[first:end] = row.corner, row.size


class _Row(NamedTuple):
    """A sorted row of a band: corners and sizes, shape (n, 2) each."""

    corner: NDArray[np.int32]
    size: NDArray[np.uint16]


class Rows:
    """Rectangles in rows: first counted, then placed and compared with their neighbours.

    Args:
        height: height of a row, in file units; at least that of any rectangle and the smallest gap together.
        gap: smallest distance; pairs below it are reported.
        executor: threads that sort and compare bands.
    """

    def __init__(self, height: int, gap: float, executor: Executor) -> None:
        self._height, self._gap, self._executor = height, gap, executor
        self._numbers: dict[int, IntArray] = {}
        self._last_chunk: dict[int, int] = {}
        self._counted = self._placed = 0
        self._bands: dict[int, _Band] = {}
        self._first_rows: dict[int, Future[_Row]] = {}
        self._jobs: deque[tuple[Future[Near], _Band]] = deque()
        # Memory of bands already compared, used again: bands differ in size, and fresh pages cost time.
        self._spare: list[_Band] = []

    def count(self, boxes: IntArray, shift: IntArray) -> None:
        """Count the rectangles (x, y, width, height) of a chunk by row: shape (n, 4), moved by ``shift``, (2,)."""
        self._counted += 1
        indices = self._bands_of(boxes, shift)
        numbers = np.zeros((len(indices), _BAND_ROWS), dtype=np.int64)
        _count(boxes, shift, self._height, indices.start * _BAND_ROWS, numbers.reshape(-1))
        for index, number in zip(indices, numbers, strict=True):
            if number.any():
                self._numbers[index] = self._numbers.get(index, 0) + number
                self._last_chunk[index] = self._counted

    def place(self, boxes: IntArray, shift: IntArray) -> Iterator[Near]:
        """Put the next chunk into its rows and yield the near pairs of complete bands.

        Boxes, shape (n, 4), come in the order of chunks of :meth:`count`; ``shift``, shape (2,), moves them.
        """
        self._placed += 1
        for index in self._bands_of(boxes, shift):
            if index in self._numbers and index not in self._first_rows:
                if index not in self._bands:
                    self._bands[index] = self._empty_band(index)
                band = self._bands[index]
                _place(boxes, shift, self._height, index * _BAND_ROWS, band.filled, band.corner, band.size)
        for index, band in self._bands.items():
            if self._last_chunk[index] <= self._placed and index not in self._first_rows:
                self._first_rows[index] = self._executor.submit(band.sort)
        for index in sorted(self._bands.keys() & self._first_rows.keys()):
            if index + 1 in self._first_rows or index + 1 not in self._numbers:
                band, above = self._bands.pop(index), self._first_rows.get(index + 1)
                job = self._executor.submit(_compare, band, self._first_rows[index], above, self._gap)
                self._jobs.append((job, band))
        while len(self._jobs) > _WAITING:
            yield self._compared()

    def finish(self) -> Iterator[Near]:
        """Yield the near pairs of the last bands, after every chunk is placed."""
        while self._jobs:
            yield self._compared()

    def _compared(self) -> Near:
        job, band = self._jobs.popleft()
        near = job.result()
        self._spare.append(band)
        return near

    def _empty_band(self, index: int) -> _Band:
        """Make room for the rectangles of a band and of the row above it, in spare memory if it is large enough."""
        numbers = self._numbers[index]
        above = self._numbers[index + 1][0] if index + 1 in self._numbers else 0
        start = np.concatenate([[0], np.cumsum(numbers), [numbers.sum() + above]])
        largest = max(int(band.sum()) for band in self._numbers.values()) + int(numbers.max()) if not self._spare else 0
        if self._spare and len(self._spare[-1].corner) >= start[-1]:
            spare = self._spare.pop()
            return _Band(start, start[:-2].copy(), spare.corner, spare.size)
        room = max(largest, int(start[-1]))
        return _Band(start, start[:-2].copy(), np.empty((room, 2), np.int32), np.empty((room, 2), np.uint16))

    def _bands_of(self, boxes: IntArray, shift: IntArray) -> range:
        """Bands to which rectangles may belong."""
        if not len(boxes):
            return range(0)
        band, bottom = self._height * _BAND_ROWS, boxes[:, 1]
        return range(int(bottom.min() + shift[1]) // band, int(bottom.max() + shift[1]) // band + 1)


def _compare(band: _Band, first_row: Future[_Row], above: Future[_Row] | None, gap: float) -> Near:
    """Near pairs of a band and the row above it; earlier calls sort both."""
    first_row.result()
    if above is not None:
        band.add_above(above.result())
    pairs, counts = np.empty((MARKERS, 3), dtype=np.int64), np.zeros(3, dtype=np.int64)
    square = _sweep(band.start, len(band.filled), band.corner, band.size, gap, pairs, counts)
    pairs = pairs[: min(int(counts[0]), MARKERS)]
    boxes = np.concatenate([band.corner[pairs[:, :2]], band.size[pairs[:, :2]]], axis=2).astype(np.int64)
    return Near(float(square), counts, boxes[:, 0], boxes[:, 1], pairs[:, 2])


@compiled
def _count(boxes: IntArray, shift: IntArray, height: int, first: int, number: IntArray) -> None:
    """Count the rectangles, moved by ``shift``, of each row from the row ``first`` on."""
    for i in range(len(boxes)):
        number[(boxes[i, 1] + shift[1]) // height - first] += 1


@compiled
def _place(
    boxes: IntArray,
    shift: IntArray,
    height: int,
    first: int,
    filled: IntArray,
    corner: NDArray[np.int32],
    size: NDArray[np.uint16],
) -> None:
    """Append the rectangles, moved by ``shift``, to their rows in the band whose first row is ``first``."""
    low, high = first * height, (first + len(filled)) * height
    for i in range(len(boxes)):
        y = boxes[i, 1] + shift[1]
        if low <= y < high:
            row = (y - low) // height
            place = filled[row]
            corner[place, 0], corner[place, 1] = boxes[i, 0] + shift[0], y
            size[place, 0], size[place, 1] = boxes[i, 2], boxes[i, 3]
            filled[row] = place + 1


@compiled
def _sort(start: IntArray, corner: NDArray[np.int32], size: NDArray[np.uint16]) -> None:
    """Sort the rectangles of each row by their left edge: bucket sort, then insertion sort in each bucket."""
    for row in range(len(start) - 1):
        begin, end = start[row], start[row + 1]
        count = end - begin
        if count < 2:
            continue
        left = np.int64(corner[begin:end, 0].min())
        width = (np.int64(corner[begin:end, 0].max()) - left) // count + 1
        following = np.zeros(count + 1, dtype=np.int64)
        for i in range(begin, end):
            following[(corner[i, 0] - left) // width + 1] += 1
        for bucket in range(count):
            following[bucket + 1] += following[bucket]
        start_of = following.copy()
        unsorted_corner, unsorted_size = corner[begin:end].copy(), size[begin:end].copy()
        for i in range(count):
            bucket = (unsorted_corner[i, 0] - left) // width
            place = begin + following[bucket]
            following[bucket] += 1
            x, y = unsorted_corner[i, 0], unsorted_corner[i, 1]
            w, length = unsorted_size[i, 0], unsorted_size[i, 1]
            # Earlier rectangles of the bucket that are farther right move up by one.
            while place > begin + start_of[bucket] and corner[place - 1, 0] > x:
                corner[place, 0], corner[place, 1] = corner[place - 1, 0], corner[place - 1, 1]
                size[place, 0], size[place, 1] = size[place - 1, 0], size[place - 1, 1]
                place -= 1
            corner[place, 0], corner[place, 1], size[place, 0], size[place, 1] = x, y, w, length


@compiled
def _sweep(
    start: IntArray,
    rows: int,
    corner: NDArray[np.int32],
    size: NDArray[np.uint16],
    gap: float,
    pairs: IntArray,
    counts: IntArray,
) -> float:
    """Compare near pairs of the first rows and the rows above them; return the smallest signed square of a distance.

    Corners and sizes have the shape (n, 2); ``start``, shape (rows + 2,), is that of a band. ``pairs``, shape (m, 3),
    is filled with both indices and the kind of the first pairs, ``counts``, shape (3,), as :attr:`Near.counts`.
    """
    reach = int(gap) + 2  # Includes pairs exactly at the limit, which may be the nearest.
    smallest = np.inf
    for one in range(rows):
        above, above_end = start[one + 1], start[one + 1]
        if one + 2 < len(start):
            above_end = start[one + 2]
        widest = np.int64(size[above:above_end, 0].max()) if above_end > above else np.int64(0)
        for i in range(start[one], start[one + 1]):
            left, low = np.int64(corner[i, 0]), np.int64(corner[i, 1])
            width, length = np.int64(size[i, 0]), np.int64(size[i, 1])
            while above < above_end and corner[above, 0] + widest + reach < left:
                above += 1
            for in_row_above in range(2):
                j = above if in_row_above else i + 1
                end = above_end if in_row_above else start[one + 1]
                while j < end and corner[j, 0] < left + width + reach:
                    x, y = np.int64(corner[j, 0]), np.int64(corner[j, 1])
                    gap_x = max(x - left - width, left - x - np.int64(size[j, 0]))
                    gap_y = max(y - low - length, low - y - np.int64(size[j, 1]))
                    square = signed_square(float(gap_x), float(gap_y))
                    smallest = min(smallest, square)
                    if square < gap * gap:
                        equal = x == left and y == low and size[j, 0] == width and size[j, 1] == length
                        kind = 2 if equal else int(square <= 0.0)
                        if counts[0] < len(pairs):
                            pairs[counts[0], 0], pairs[counts[0], 1], pairs[counts[0], 2] = i, j, kind
                        for level in range(kind + 1):
                            counts[level] += 1
                    j += 1
    return smallest
