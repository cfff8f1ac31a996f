"""Records of a GDSII file, runs of elements that differ only in their coordinates, and rings as rectangles."""

from __future__ import annotations

import struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.mask.shapes.hierarchy import IntArray

#: Bytes that are read at a time.
WINDOW = 1 << 21


def damaged(source: str, expected: str, got: str) -> InputError:
    """Return the error for a file that is not whole GDSII."""
    remedy = "the file is damaged or not GDSII: write or export it again"
    return InputError.single(source, "file", expected, got, remedy)


class Window:
    """Sequential reading of records through a window that moves along a file of ``size`` bytes.

    Its methods raise InputError, with the name ``source``, where the file is damaged.
    """

    def __init__(self, stream: BinaryIO, size: int, source: str) -> None:
        self._stream, self._size, self._source = stream, size, source
        self._start, self._data, self._buffer = 0, memoryview(b""), bytearray(WINDOW)

    def record(self, position: int) -> tuple[int, bytes, int]:
        """Kind and data of the record at ``position``, and the position of the next record."""
        self._load(position, 4)
        length, kind = struct.unpack_from(">HH", self._data, position - self._start)
        if length < 4 or length % 2:
            expected, got = "records of even length from 4", f"one of {length} bytes at byte {position}"
            raise damaged(self._source, expected, got)
        self._load(position, length)
        inside = position - self._start
        return kind, bytes(self._data[inside + 4 : inside + length]), position + length

    def repeats(self, start: int, stride: int, xy: tuple[int, int]) -> int:
        """Count the elements from ``start`` on that equal the first outside their coordinates; at least 1.

        Elements have ``stride`` bytes; ``xy`` is the offset of their coordinates in bytes, and the number of words.
        """
        count = 0
        self._load(start, stride)
        first = np.frombuffer(self._data, np.uint16, stride // 2, start - self._start).copy()
        while True:
            here = start + count * stride
            if self._start + len(self._data) < here + stride:
                if here + stride > self._size:
                    return count
                self._load(here, stride)
            fit = (self._start + len(self._data) - here) // stride
            block = np.frombuffer(self._data, np.uint16, fit * stride // 2, here - self._start)
            equal = int(_equal_rows(block.reshape(fit, stride // 2), first, xy[0] // 2, xy[0] // 2 + 2 * xy[1]))
            count += equal
            if equal < fit:
                return count

    def _load(self, position: int, count: int) -> None:
        """Move the window so that it holds ``count`` bytes from ``position`` on."""
        if self._start <= position and position + count <= self._start + len(self._data):
            return
        self._stream.seek(position)
        if count > len(self._buffer):
            self._buffer = bytearray(count)
        self._start, self._data = position, read_into(self._buffer, self._stream)
        if len(self._data) < count:
            got = f"one that ends at byte {self._size}, inside a record"
            raise damaged(self._source, "a file that ends with ENDLIB", got)


def read_into(buffer: bytearray | memoryview, stream: BinaryIO) -> memoryview:
    """Read as many bytes as fit into a buffer and return them; pages of fresh memory cost as much as the reading."""
    whole = memoryview(buffer)
    return whole[: stream.readinto(whole)].toreadonly()  # type: ignore[attr-defined]


@compiled
def _equal_rows(rows: NDArray[np.uint16], first: NDArray[np.uint16], xy_start: int, xy_end: int) -> int:
    """Number of leading rows that equal ``first`` outside [xy_start, xy_end)."""
    for row in range(rows.shape[0]):
        for column in range(xy_start):
            if rows[row, column] != first[column]:
                return row
        for column in range(xy_end, rows.shape[1]):
            if rows[row, column] != first[column]:
                return row
    return len(rows)


def rectangles_of(elements: NDArray[np.uint8], first: int) -> tuple[IntArray, NDArray[np.bool_]]:
    """Convert elements with rings of five points, shape (n, stride) bytes, to bounding boxes, shape (n, 4).

    ``first`` is the offset of the ten coordinates, big-endian words. Boxes are x, y, width and height. Also returns
    whether the ring, shape (n,), is an axis-parallel rectangle, in either sense and from any corner.
    """
    if first % 4 or elements.shape[1] % 4:
        elements, first = np.ascontiguousarray(elements[:, first : first + 40]), 0
    rectangles = np.empty((len(elements), 4), dtype=np.int64)
    is_rectangle = np.empty(len(elements), dtype=np.bool_)
    _rectangles(elements.view(np.uint32), first // 4, rectangles, is_rectangle)
    return rectangles, is_rectangle


@compiled
def _rectangles(words: NDArray[np.uint32], first: int, rectangles: IntArray, is_rectangle: NDArray[np.bool_]) -> None:
    p = np.empty(10, dtype=np.int64)
    for i in range(len(words)):
        for k in range(10):
            word = np.int64(words[i, first + k])
            word = (word >> 24) | ((word >> 8) & 0xFF00) | ((word << 8) & 0xFF0000) | ((word << 24) & 0xFF000000)
            p[k] = word - 0x100000000 if word >= 0x80000000 else word
        x_0, x_1, y_0, y_1 = p[0], p[0], p[1], p[1]
        for k in range(2, 10, 2):
            x_0, x_1 = min(x_0, p[k]), max(x_1, p[k])
            y_0, y_1 = min(y_0, p[k + 1]), max(y_1, p[k + 1])
        rectangles[i, 0], rectangles[i, 1], rectangles[i, 2], rectangles[i, 3] = x_0, y_0, x_1 - x_0, y_1 - y_0
        x_first = p[1] == p[3] and p[2] == p[4] and p[5] == p[7] and p[6] == p[0]
        y_first = p[0] == p[2] and p[3] == p[5] and p[4] == p[6] and p[7] == p[1]
        closed = p[0] == p[8] and p[1] == p[9]
        is_rectangle[i] = closed and (x_first or y_first) and x_1 > x_0 and y_1 > y_0
