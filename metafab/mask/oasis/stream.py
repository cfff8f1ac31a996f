"""The elements that OASIS records are made of: integers, reals, strings, displacements, repetitions, point lists."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.mask.shapes.hierarchy import IntArray

# East, north, west, south, then the diagonals north-east, north-west, south-west, south-east.
_DIRECTIONS = ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1))
_LARGEST_REPETITION = 1 << 28


class DamagedError(Exception):
    """The bytes cannot be OASIS; the reader turns it into an InputError that names the file."""


class Stream:
    """A buffer and a position in it.

    Args:
        data: bytes of the file, or of an inflated block.
        position: where to start.
    """

    def __init__(self, data: NDArray[np.uint8], position: int = 0) -> None:
        self.data = data
        self.position = position

    @property
    def exhausted(self) -> bool:
        """Whether nothing is left."""
        return self.position >= self.data.size

    def byte(self) -> int:
        """One byte."""
        if self.exhausted:
            raise DamagedError("the data end inside a record")
        value = int(self.data[self.position])
        self.position += 1
        return value

    def bytes(self, count: int) -> bytes:
        """Some bytes."""
        if count > self.data.size - self.position:
            raise DamagedError("the data end inside a string or block")
        value = self.data[self.position : self.position + count].tobytes()
        self.position += count
        return value

    def unsigned(self) -> int:
        """An unsigned integer, below 2^63."""
        value, shift = 0, 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7
            if shift > 56:
                raise DamagedError("an integer of more than 63 bits")

    def signed(self) -> int:
        """A signed integer."""
        value = self.unsigned()
        return -(value >> 1) if value & 1 else value >> 1

    def real(self, kind: int | None = None) -> float:
        """A real of any of the eight types."""
        kind = self.unsigned() if kind is None else kind
        sign = -1.0 if kind in {1, 3, 5} else 1.0
        if kind < 2:
            return sign * self.unsigned()
        if kind < 4:
            return sign / self._divisor()
        if kind < 6:
            above = self.unsigned()
            return sign * above / self._divisor()
        if kind in {6, 7}:
            (value,) = struct.unpack("<f" if kind == 6 else "<d", self.bytes(4 if kind == 6 else 8))
            return float(value)
        raise DamagedError(f"a real of type {kind}")

    def string(self) -> str:
        """A string."""
        return self.bytes(self.unsigned()).decode("latin-1")

    def step(self) -> tuple[int, int]:
        """A g-delta: a displacement along one of eight directions, or any."""
        first = self.unsigned()
        if first & 1:
            x = first >> 2
            return (-x if first & 2 else x), self.signed()
        x, y = _DIRECTIONS[first >> 1 & 7]
        return x * (first >> 4), y * (first >> 4)

    def repetition(self, previous: IntArray | None) -> IntArray:
        """Offsets of all copies from the first, shape (m, 2), the first (0, 0); type 0 repeats ``previous``."""
        kind = self.unsigned()
        if kind == 0:
            if previous is None:
                raise DamagedError("a repetition that repeats none")
            return previous
        if kind in {1, 8}:
            columns, rows = self._count(), self._count()
            self._plausible(columns * rows)
            steps = ((self.unsigned(), 0), (0, self.unsigned())) if kind == 1 else (self.step(), self.step())
            fast, slow = np.array(steps, dtype=np.int64)
            grid = slow * np.arange(rows)[:, None, None] + fast * np.arange(columns)[:, None]
            return np.asarray(grid.reshape(-1, 2))
        if kind in {2, 3, 9}:
            count = self._count()
            step = self.step() if kind == 9 else (self.unsigned(), 0) if kind == 2 else (0, self.unsigned())
            return np.asarray(np.arange(count)[:, None] * np.array(step, dtype=np.int64))
        if kind in {4, 5, 6, 7, 10, 11}:
            count = self._count()
            unit = self.unsigned() if kind in {5, 7, 11} else 1
            offsets = np.zeros((count, 2), dtype=np.int64)
            form = 2 if kind >= 10 else kind // 6  # 0: along x, 1: along y, 2: displacements
            end = read_displacements(self.data, self.position, form, offsets)
            if end < 0:
                raise DamagedError("the data end inside a repetition")
            self.position = int(end)
            return offsets * unit
        raise DamagedError(f"a repetition of type {kind}")

    def points(self, closed: bool) -> IntArray:
        """A point list as vertices from (0, 0), shape (n, 2)."""
        kind, count = self.unsigned(), self.unsigned()
        self._plausible(count)
        if count > self.data.size - self.position:
            raise DamagedError("the data end inside a point list")
        if kind in {0, 1}:
            steps = [(self.signed(), 0) if (i + kind) % 2 == 0 else (0, self.signed()) for i in range(count)]
        elif kind in {2, 3}:
            steps = [self._direction(2 if kind == 2 else 3) for _ in range(count)]
        elif kind in {4, 5}:
            steps = [self.step() for _ in range(count)]
        else:
            raise DamagedError(f"a point list of type {kind}")
        moves = np.array(steps, dtype=np.int64).reshape(-1, 2)
        if kind == 5:
            moves = np.cumsum(moves, axis=0)
        vertices = np.concatenate([np.zeros((1, 2), dtype=np.int64), np.cumsum(moves, axis=0)])
        if closed and kind in {0, 1}:  # the last corner, at the crossing of the first and last edges, is implied
            last = [0, vertices[-1, 1]] if kind == 0 else [vertices[-1, 0], 0]
            vertices = np.concatenate([vertices, np.array([last], dtype=np.int64)])
        return vertices

    def _direction(self, bits: int) -> tuple[int, int]:
        value = self.unsigned()
        x, y = _DIRECTIONS[value & (1 << bits) - 1]
        return x * (value >> bits), y * (value >> bits)

    def _divisor(self) -> int:
        value = self.unsigned()
        if value == 0:
            raise DamagedError("a division by zero")
        return value

    def _count(self) -> int:
        count = self.unsigned() + 2
        self._plausible(count)
        return count

    @staticmethod
    def _plausible(count: int) -> None:
        if count > _LARGEST_REPETITION:
            raise DamagedError(f"a list of {count} items")


@compiled
def read_displacements(data: NDArray[np.uint8], position: int, form: int, offsets: IntArray) -> int:
    """Fill ``offsets`` from the second on; returns the position behind them, or -1 if the data end.

    ``form`` 0 and 1 are spacings along x and y, 2 displacements (g-deltas).
    """
    x, y = 0, 0
    for item in range(1, len(offsets)):
        step_x, step_y, position = read_displacement(data, position, form)
        if position < 0:
            return -1
        x += step_x
        y += step_y
        offsets[item, 0] = x
        offsets[item, 1] = y
    return position


@compiled
def read_displacement(data: NDArray[np.uint8], position: int, form: int) -> tuple[int, int, int]:
    """One displacement and the position behind it (-1 if the data end)."""
    first, position = read_unsigned(data, position)
    if position < 0:
        return 0, 0, -1
    if form == 0:
        return first, 0, position
    if form == 1:
        return 0, first, position
    if first & 1:
        second, position = read_unsigned(data, position)
        x, y = first >> 2, second >> 1
        return (-x if first & 2 else x), (-y if second & 1 else y), position
    length, direction = first >> 4, first >> 1 & 7
    x = length if direction in (0, 4, 7) else -length if direction in (2, 5, 6) else 0
    y = length if direction in (1, 4, 5) else -length if direction in (3, 6, 7) else 0
    return x, y, position


@compiled
def read_unsigned(data: NDArray[np.uint8], position: int) -> tuple[int, int]:
    """An unsigned integer and the position behind it (-1 if the data end or it has more than 63 bits)."""
    value, shift = 0, 0
    while position < len(data) and shift <= 56:
        byte = int(data[position])
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
    return 0, -1
