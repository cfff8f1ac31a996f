"""Elements of OASIS records, written and read: integers, reals, strings, displacements, repetitions, point lists.

An integer has seven bits per byte, the least significant first; the top bit is set on all bytes but the last. A signed
integer is the magnitude shifted left, with the sign in bit 0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.mask.shapes.hierarchy import IntArray

ByteArray = NDArray[np.uint8]

#: Form of a repetition whose copies stand at equal steps; the other forms are those of :func:`read_displacement`.
REGULAR = 3

_LARGEST_REPETITION = 1 << 28
#: Largest coordinate (database units), a kilometre: sums over nested cells stay below 2^63.
_LARGEST_PLACE = 1 << 40
#: Copies and bytes that are handled at a time.
_BLOCK = 1 << 16
#: Bytes that a place of a repetition and a corner of a point list take while they are read: two and three pairs.
_BYTES_OF_A_PLACE, _BYTES_OF_A_CORNER = 32, 48


class DamagedError(Exception):
    """The bytes cannot be OASIS; the reader turns it into an InputError that names the file."""


def unsigned(value: int) -> bytes:
    """Encode an unsigned integer."""
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def signed(value: int) -> bytes:
    """Encode a signed integer."""
    return unsigned(abs(value) << 1 | (value < 0))


def string(text: str) -> bytes:
    """Encode a string: its length and its characters."""
    data = text.encode("ascii")
    return unsigned(len(data)) + data


def real(value: float) -> bytes:
    """Encode a positive real: type 0 if it is whole, else type 7 (IEEE 754 double)."""
    whole = round(value)
    if abs(value - whole) < 1e-9 * value:
        return b"\x00" + unsigned(whole)
    return b"\x07" + struct.pack("<d", value)


@compiled
def put(out: ByteArray, position: int, value: int) -> int:
    """Write an unsigned integer to ``out``, shape (n,), at ``position``; return the position after it."""
    while value >= 0x80:
        out[position] = value & 0x7F | 0x80
        value >>= 7
        position += 1
    out[position] = value
    return position + 1


@compiled
def put_signed(out: ByteArray, position: int, value: int) -> int:
    """Write a signed integer to ``out``, shape (n,), at ``position``; return the position after it."""
    return put(out, position, abs(value) << 1 | (value < 0))


@compiled
def read_unsigned(data: ByteArray, position: int) -> tuple[int, int]:
    """Read an unsigned integer from ``data``, shape (n,), at ``position``; return it and the position after it.

    The position is -1 if the data end or the integer has more than 63 bits.
    """
    value, shift = 0, 0
    while position < len(data) and shift <= 56:
        byte = int(data[position])
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
    return 0, -1


@compiled
def read_displacement(data: ByteArray, position: int, form: int) -> tuple[int, int, int]:
    """Read a displacement from ``data``, shape (n,), at ``position``; return x, y and the position after it.

    ``form`` is 0 for a spacing along x, 1 along y, 2 for a g-delta (one of eight directions, or any). The position is
    -1 if the data end.
    """
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
    x, y = _along(first >> 1 & 7, first >> 4)
    return x, y, position


@compiled
def _along(direction: int, length: int) -> tuple[int, int]:
    """x, y of a step east, north, west or south, or along the diagonals from north-east counter-clockwise."""
    x = length if direction in (0, 4, 7) else -length if direction in (2, 5, 6) else 0
    y = length if direction in (1, 4, 5) else -length if direction in (3, 6, 7) else 0
    return x, y


@compiled
def read_moves(data: ByteArray, position: int, kind: int, moves: IntArray) -> int:
    """Read the displacements of a point list into ``moves``, shape (m, 2); return the position after it, -1 at the end.

    Kinds 0 and 1 of lists alternate between x and y, 2 and 3 have four and eight directions, 4 and 5 are g-deltas.
    """
    for item in range(len(moves)):
        if kind > 3:
            x, y, position = read_displacement(data, position, 2)
        else:
            value, position = read_unsigned(data, position)
            if kind > 1:
                x, y = _along(value & ((1 << kind) - 1), value >> kind)
            else:
                step = -(value >> 1) if value & 1 else value >> 1
                x, y = (step, 0) if (item + kind) % 2 == 0 else (0, step)
        if position < 0:
            return -1
        moves[item, 0], moves[item, 1] = x, y
    return position


@compiled
def read_displacements(data: ByteArray, position: int, form: int, offsets: IntArray) -> int:
    """Read the list of a repetition into ``offsets``, shape (m, 2), from its second row on; its first row is left.

    ``form`` is that of :func:`read_displacement`. Return the position after the list; -1 if the data end.
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


class Repetition(NamedTuple):
    """A repetition up to its list of displacements, if it has one."""

    copies: int  #: Number of copies.
    columns: int  #: Copies of a row, along the fast step.
    grid: int  #: Factor of the displacements of a list.
    form: int  #: :data:`REGULAR`, or form of the displacements of a list.
    fast_x: int  #: x of the step within a row.
    fast_y: int  #: y of the step within a row.
    slow_x: int  #: x of the step between rows.
    slow_y: int  #: y of the step between rows.
    end: int  #: Position after what was read; -1 if the data end, the type is unknown or a count is implausible.


@compiled
def read_repetition(data: ByteArray, position: int) -> Repetition:
    """Read a repetition of type 1 to 11 from ``data``, shape (n,), at ``position``, up to its list."""
    kind, here = read_unsigned(data, position)
    columns, rows, grid, form = 1, 1, 1, REGULAR
    fast_x, fast_y, slow_x, slow_y = 0, 0, 0, 0
    if kind < 1 or kind > 11:
        here = -1
    if here >= 0:
        value, here = read_unsigned(data, here)
        columns = value + 2
    if here >= 0 and kind in (1, 8):
        value, here = read_unsigned(data, here)
        rows = value + 2
    if columns > _LARGEST_REPETITION or rows > _LARGEST_REPETITION:
        here = -1
    if kind in (4, 5, 6, 7, 10, 11):
        form = 2 if kind >= 10 else kind // 6
        if here >= 0 and kind in (5, 7, 11):
            grid, here = read_unsigned(data, here)
    elif here >= 0:
        step_form = 0 if kind in (1, 2) else 1 if kind == 3 else 2
        fast_x, fast_y, here = read_displacement(data, here, step_form)
        if here >= 0 and rows > 1:
            slow_x, slow_y, here = read_displacement(data, here, 1 if kind == 1 else 2)
    return Repetition(columns * rows, columns, grid, form, fast_x, fast_y, slow_x, slow_y, here)


@dataclass(frozen=True)
class Copies:
    """Places of the copies of a record, relative to the first; expanded a block at a time."""

    count: int  #: Number of copies.
    read: Repetition | None = None  #: The repetition whose copies stand at equal steps.
    listed: IntArray | None = None  #: Places of all copies, shape (n, 2); None for equal steps.

    def blocks(self) -> Iterator[IntArray]:
        """Places, shape (m, 2) each, the first (0, 0)."""
        for start in range(0, self.count, _BLOCK):
            stop = min(start + _BLOCK, self.count)
            if self.listed is not None:
                yield self.listed[start:stop]
                continue
            copy, read = np.arange(start, stop)[:, None], self.read
            if read is None:
                yield np.zeros((stop - start, 2), dtype=np.int64)
                continue
            fast, slow = np.array([read.fast_x, read.fast_y]), np.array([read.slow_x, read.slow_y])
            yield np.asarray(copy % read.columns * fast + copy // read.columns * slow)


def checked_place(x: int, y: int) -> tuple[int, int]:
    """Return a position, (x, y) in database units; DamagedError if it lies farther out than any mask reaches."""
    if max(abs(x), abs(y)) > _LARGEST_PLACE:
        raise DamagedError(f"a position at {x}, {y} database units")
    return x, y


class Stream:
    """The bytes of a file or of an inflated block, and a position in them; each method reads an element and moves on.

    DamagedError from its methods, where the data end or hold no such element.

    Args:
        data: shape (n,).
        position: of the first element.
        spend: gets the bytes that a list takes before it is read.
    """

    def __init__(self, data: ByteArray, position: int = 0, spend: Callable[[int], None] = lambda size: None) -> None:
        self.data = data
        self.position = position
        self.spend = spend

    @property
    def exhausted(self) -> bool:
        """Whether nothing is left."""
        return self.position >= self.data.size

    def byte(self) -> int:
        """Read one byte."""
        if self.exhausted:
            raise DamagedError("the data end inside a record")
        value = int(self.data[self.position])
        self.position += 1
        return value

    def bytes(self, count: int) -> bytes:
        """Read ``count`` bytes."""
        if count > self.data.size - self.position:
            raise DamagedError("the data end inside a string or block")
        value = self.data[self.position : self.position + count].tobytes()
        self.position += count
        return value

    def unsigned(self) -> int:
        """Read an unsigned integer below 2^63."""
        value, end = read_unsigned(self.data, self.position)
        if end < 0:
            raise DamagedError("an integer that is cut short or has more than 63 bits")
        self.position = int(end)
        return int(value)

    def signed(self) -> int:
        """Read a signed integer."""
        value = self.unsigned()
        return -(value >> 1) if value & 1 else value >> 1

    def real(self, kind: int | None = None) -> float:
        """Read a real of any of the eight types; ``kind`` if the type has been read."""
        kind = self.unsigned() if kind is None else kind
        sign = -1.0 if kind in {1, 3, 5} else 1.0
        if kind < 2:
            return sign * self.unsigned()
        if kind < 6:
            above = self.unsigned() if kind > 3 else 1
            below = self.unsigned()
            if below == 0:
                raise DamagedError("a division by zero")
            return sign * above / below
        if kind in {6, 7}:
            (value,) = struct.unpack("<f" if kind == 6 else "<d", self.bytes(4 if kind == 6 else 8))
            return float(value)
        raise DamagedError(f"a real of type {kind}")

    def string(self) -> str:
        """Read a string."""
        return self.bytes(self.unsigned()).decode("latin-1")

    def skip_padding(self) -> None:
        """Skip the zeros up to the next record."""
        size = 64
        while not self.exhausted:
            part = self.data[self.position : self.position + size]
            zeros = int(np.argmax(part != 0))
            if part[zeros]:
                self.position += zeros
                return
            self.position += len(part)
            size = min(2 * size, _BLOCK)

    def repetition(self, previous: Copies | None) -> Copies:
        """Read the places of all copies of a record; type 0 repeats ``previous``."""
        start = self.position
        if self.unsigned() == 0:
            if previous is None:
                raise DamagedError("a repetition that repeats none")
            return previous
        read = read_repetition(self.data, start)
        if read.end < 0 or read.copies > _LARGEST_REPETITION:
            raise DamagedError("a repetition that is cut short, too long or of unknown type")
        self.position = int(read.end)
        if read.form == REGULAR:
            steps = max(abs(step) for step in (read.fast_x, read.fast_y, read.slow_x, read.slow_y))
            if steps * read.copies > _LARGEST_PLACE:
                raise DamagedError(f"a repetition that reaches {steps * read.copies} database units")
            return Copies(int(read.copies), read)
        if read.copies - 1 > self.data.size - self.position:
            raise DamagedError("the data end inside a repetition")
        self.spend(_BYTES_OF_A_PLACE * read.copies)
        offsets = np.zeros((read.copies, 2), dtype=np.int64)
        end = read_displacements(self.data, self.position, read.form, offsets)
        if end < 0:
            raise DamagedError("the data end inside a repetition")
        self.position = int(end)
        if int(np.abs(offsets).max()) * read.grid > _LARGEST_PLACE:
            raise DamagedError("a repetition that reaches farther than any mask")
        return Copies(int(read.copies), listed=offsets * read.grid)

    def points(self, closed: bool) -> IntArray:
        """Read a point list as vertices from (0, 0), shape (n, 2); ``closed`` for polygons."""
        kind, count = self.unsigned(), self.unsigned()
        if count > self.data.size - self.position:
            raise DamagedError("the data end inside a point list")
        if kind > 5:
            raise DamagedError(f"a point list of type {kind}")
        self.spend(_BYTES_OF_A_CORNER * count)
        moves = np.zeros((count, 2), dtype=np.int64)
        end = read_moves(self.data, self.position, kind, moves)
        if end < 0:
            raise DamagedError("the data end inside a point list")
        self.position = int(end)
        if kind == 5:
            moves = np.cumsum(moves, axis=0)
        vertices = np.concatenate([np.zeros((1, 2), dtype=np.int64), np.cumsum(moves, axis=0)])
        if closed and kind in {0, 1}:  # The last corner is implied: the crossing of the first and last edges.
            last = [0, vertices[-1, 1]] if kind == 0 else [vertices[-1, 0], 0]
            vertices = np.concatenate([vertices, np.array([last], dtype=np.int64)])
        return vertices

    def skip_property(self, kind: int) -> None:
        """Skip the content of a property (28, 29) or of an extension element (32)."""
        if kind == 29:
            return
        if kind == 32:
            self.unsigned()
            self.string()
            return
        info = self.byte()
        if info & 0b100:
            if info & 0b10:
                self.unsigned()
            else:
                self.string()
        if info & 0b1000:
            return
        count = info >> 4
        for _ in range(self.unsigned() if count == 15 else count):
            value = self.unsigned()
            if value < 8:
                self.real(value)
            elif value in {10, 11, 12}:
                self.string()
            else:
                self.unsigned()
