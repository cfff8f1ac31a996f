"""Records of a GDSII file, one after the other, and runs of elements that differ in nothing but their coordinates."""

from __future__ import annotations

import struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.numeric.compiled import HAS_NUMBA, compiled

#: Bytes that are read at a time.
WINDOW = 1 << 22

REMEDY = "the file is damaged or not GDSII: write or export it again"


class Window:
    """Sequential reading of records through a window that moves along the file."""

    def __init__(self, stream: BinaryIO, size: int, source: str) -> None:
        self._stream, self._size, self._source = stream, size, source
        self._start, self._data = 0, b""

    def record(self, position: int) -> tuple[int, bytes, int]:
        """Kind and data of the record at ``position``, and where the next begins."""
        self._need(position, 4)
        length, kind = struct.unpack_from(">HH", self._data, position - self._start)
        if length < 4 or length % 2:
            raise self._fault("records of even length from 4", f"one of {length} bytes at byte {position}")
        self._need(position, length)
        inside = position - self._start
        return kind, self._data[inside + 4 : inside + length], position + length

    def repeats(self, start: int, stride: int, xy: tuple[int, int]) -> int:
        """How many elements from ``start`` on equal the first outside their coordinates; at least 1."""
        count = 0
        self._need(start, stride)
        first = np.frombuffer(self._data, np.uint16, stride // 2, start - self._start).copy()
        while True:
            here = start + count * stride
            if self._start + len(self._data) < here + stride:
                if here + stride > self._size:
                    return count
                self._need(here, stride)
            fit = (self._start + len(self._data) - here) // stride
            block = np.frombuffer(self._data, np.uint16, fit * stride // 2, here - self._start)
            same = _same(block.reshape(fit, stride // 2), first, xy[0] // 2, xy[0] // 2 + 2 * xy[1])
            count += same
            if same < fit:
                return count

    def _need(self, position: int, count: int) -> None:
        if self._start <= position and position + count <= self._start + len(self._data):
            return
        self._stream.seek(position)
        self._start, self._data = position, self._stream.read(max(WINDOW, count))
        if len(self._data) < count:
            raise self._fault("a file that ends with ENDLIB", f"one that ends at byte {self._size}, inside a record")

    def _fault(self, expected: str, got: str) -> InputError:
        return InputError.single(self._source, "file", expected, got, REMEDY)


def _same(rows: NDArray[np.uint16], first: NDArray[np.uint16], xy_start: int, xy_end: int) -> int:
    """Leading rows that equal ``first`` outside [xy_start, xy_end)."""
    if HAS_NUMBA:
        return int(_same_compiled(rows, first, xy_start, xy_end))
    differs = np.any(rows[:, :xy_start] != first[:xy_start], axis=1)
    differs |= np.any(rows[:, xy_end:] != first[xy_end:], axis=1)
    return int(np.argmax(differs)) if differs.any() else len(rows)


@compiled
def _same_compiled(rows: NDArray[np.uint16], first: NDArray[np.uint16], xy_start: int, xy_end: int) -> int:
    for row in range(rows.shape[0]):
        for column in range(xy_start):
            if rows[row, column] != first[column]:
                return row
        for column in range(xy_end, rows.shape[1]):
            if rows[row, column] != first[column]:
                return row
    return len(rows)
