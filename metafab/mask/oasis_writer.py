"""OASIS (SEMI P39) by streaming: a cell a tile, one RECTANGLE a size with all its places as a repetition.

Repetition type 11 lists displacements in steps of a grid, here the lattice. A record states only what differs
from the one before (modal width, height and layer, relative positions); those of a tile are deflated into one
CBLOCK. The file ends with a CRC-32, so that readers can tell a damaged file.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterable, Sequence
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask import varints
from metafab.mask.cells import TileCell, lens_name, tile_cell
from metafab.mask.copies import LensCopy, biases_dbu
from metafab.mask.hierarchy import IntArray

MAGIC = b"%SEMI-OASIS\r\n"
START, END, CELL, XYRELATIVE, PLACEMENT, RECTANGLE, CBLOCK = 1, 2, 14, 16, 17, 20, 34
_END_BYTES = 256

# Of the paper's 25.6 million pillars: level 3 makes 23.4 MB, 5 makes 22.1 in 1.4 times and 6 21.4 in twice the time.
_DEFLATE_LEVEL = 5

# Info byte of RECTANGLE, SWHXYRDL from the top bit: what is given explicitly.
_W, _H, _X, _Y, _REPETITION, _DATATYPE_LAYER = 0b100_0000, 0b10_0000, 0b1_0000, 0b1000, 0b100, 0b011
_ARBITRARY_ON_GRID = 11

# Places of one size are listed strip by strip: displacements then take fewer bytes, and the lists of like sizes
# resemble one another more closely, which is what deflating lives on.
_STRIP_SITES = 238


class OasisWriter:
    """Writes tiles as they come; memory stays that of one tile.

    Args:
        stream: binary stream at its start.
        lattice: lattice of the tiles.
        size_dbu: shape (n_sizes + 1, 2), as :attr:`PillarMap.size_dbu`.
        top: name of the top cell.
        layer: layer of the pillars.
        datatype: datatype of the pillars.
        copies: lenses to place where there are several; without any, the top cell is the lens.
    """

    def __init__(
        self,
        stream: BinaryIO,
        lattice: Lattice,
        size_dbu: NDArray[np.int32],
        top: str,
        layer: int,
        datatype: int,
        copies: Sequence[LensCopy] = (),
    ) -> None:
        self._stream = stream
        self._lattice = lattice
        self._size_dbu = size_dbu.astype(np.int64)
        self._top = top
        self._layer_datatype = (layer, datatype)
        self._copies = copies
        self._placed: dict[int, list[TileCell]] = {bias: [] for bias in biases_dbu(copies) or (0,)}
        self._crc = 0
        self._write(MAGIC + bytes([START]) + varints.string("1.0") + _real(1e3 / lattice.database_unit_nm) + bytes(13))

    def encode(self, tile: PillarTile, dose_class: int = 0, bias_dbu: int = 0) -> tuple[int, TileCell, bytes]:
        """The bias, the cell of the pillars of ``tile`` drawn with it, and its bytes.

        Safe to call from several threads.
        """
        cell = tile_cell(self._lattice, tile, dose_class, bias_dbu)
        layer, datatype = self._layer_datatype
        records = rectangle_records(
            tile, self._lattice, self._size_dbu + bias_dbu, cell, (layer, datatype + dose_class)
        )
        packed = _deflate(records)
        block = bytes([CBLOCK, 0]) + varints.unsigned(len(records)) + varints.unsigned(len(packed)) + packed
        return bias_dbu, cell, bytes([CELL]) + varints.string(cell.name) + bytes([XYRELATIVE]) + block

    def add(self, encoded: tuple[int, TileCell, bytes]) -> None:
        """Append what :meth:`encode` returned."""
        bias_dbu, cell, data = encoded
        self._placed[bias_dbu].append(cell)
        self._write(data)

    def close(self, beside: Iterable[tuple[int, IntArray]] = ()) -> None:
        """Write the top cell, with (layer, rectangles) ``beside`` the pillars in it, and the end of the file."""
        if self._copies:
            for bias_dbu in self._placed:
                self._write(bytes([CELL]) + varints.string(lens_name(bias_dbu, self._top)))
                self._place_tiles(bias_dbu)
        self._write(bytes([CELL]) + varints.string(self._top))
        if not self._copies:
            self._place_tiles(0)
        for copy in self._copies:
            self._place(lens_name(copy.bias_dbu, self._top), copy.x_dbu, copy.y_dbu)
        for layer, rectangles in beside:
            for x, y, width, height in rectangles.tolist():
                size = (
                    varints.unsigned(layer) + varints.unsigned(0) + varints.unsigned(width) + varints.unsigned(height)
                )
                info = _W | _H | _X | _Y | _DATATYPE_LAYER
                self._write(bytes([RECTANGLE, info]) + size + varints.signed(x) + varints.signed(y))
        padding = _END_BYTES - 1 - 2 - 1 - 4  # id, length of the padding, scheme, CRC
        self._write(bytes([END]) + varints.unsigned(padding) + bytes(padding) + bytes([1]))
        self._stream.write(struct.pack("<I", self._crc))

    def _place_tiles(self, bias_dbu: int) -> None:
        for cell in self._placed[bias_dbu]:
            self._place(cell.name, cell.x_dbu, cell.y_dbu)

    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None:
        place = varints.signed(x_dbu) + varints.signed(y_dbu)  # info byte CNXYRAAF: the cell by its name, x and y given
        self._write(bytes([PLACEMENT, 0b1011_0000]) + varints.string(name) + place)

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._stream.write(data)


def _real(value: float) -> bytes:
    """A real: type 0 where it is whole, else type 7 (IEEE 754 double)."""
    whole = round(value)
    if abs(value - whole) < 1e-9 * value:
        return b"\x00" + varints.unsigned(whole)
    return b"\x07" + struct.pack("<d", value)


def _deflate(data: bytes) -> bytes:
    packer = zlib.compressobj(_DEFLATE_LEVEL, zlib.DEFLATED, -15)
    return packer.compress(data) + packer.flush()


def rectangle_records(
    tile: PillarTile,
    lattice: Lattice,
    size_dbu: NDArray[np.int64],
    cell: TileCell,
    layer_datatype: tuple[int, int],
) -> bytes:
    """The RECTANGLE records of a tile, by size, positions relative to the record before; not yet deflated."""
    if not HAS_NUMBA:
        return rectangle_records_vectorised(tile, lattice, size_dbu, cell, layer_datatype)
    row, column, end_of = _sorted_by_size(tile.size_index, len(size_dbu), _fast_along_y(tile.size_index))
    # No displacement in a tile takes more than 12 bytes, no head of a record more than 64.
    out = np.empty(12 * row.size + 64 * len(size_dbu), dtype=np.uint8)
    first_dbu = (cell.first_x_dbu, cell.first_y_dbu)
    end = _write_records(row, column, end_of, size_dbu, lattice.period_dbu, first_dbu, layer_datatype, out)
    return out[:end].tobytes()


@compiled
def _write_records(
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    end_of: NDArray[np.int64],
    size_dbu: NDArray[np.int64],
    period: tuple[int, int],
    first_dbu: tuple[int, int],
    layer_datatype: tuple[int, int],
    out: varints.ByteArray,
) -> int:
    grid = math.gcd(period[0], period[1])
    step_x, step_y = period[0] // grid, period[1] // grid
    end, here = 0, 0
    modal = np.array([-1, -1, 0, 0], dtype=np.int64)
    for size in range(1, len(size_dbu)):
        behind = end_of[size]
        if behind == here:
            continue
        count = behind - here
        width, length = size_dbu[size, 0], size_dbu[size, 1]
        x = first_dbu[0] + column[here] * period[0] - width // 2
        y = first_dbu[1] + row[here] * period[1] - length // 2
        info = (_REPETITION if count > 1 else 0) | (_DATATYPE_LAYER if here == 0 else 0)
        info |= (_W if width != modal[0] else 0) | (_H if length != modal[1] else 0)
        info |= (_X if x != modal[2] else 0) | (_Y if y != modal[3] else 0)
        end = varints.put(out, varints.put(out, end, RECTANGLE), info)
        if here == 0:
            end = varints.put(out, varints.put(out, end, layer_datatype[0]), layer_datatype[1])
        if info & _W:
            end = varints.put(out, end, width)
        if info & _H:
            end = varints.put(out, end, length)
        if info & _X:
            end = varints.put(out, end, abs(x - modal[2]) << 1 | (x < modal[2]))
        if info & _Y:
            end = varints.put(out, end, abs(y - modal[3]) << 1 | (y < modal[3]))
        modal[0], modal[1], modal[2], modal[3] = width, length, x, y
        if count > 1:
            end = varints.put(out, varints.put(out, end, _ARBITRARY_ON_GRID), count - 2)
            end = varints.put(out, end, grid)
        for pillar in range(here + 1, behind):
            right = (column[pillar] - column[pillar - 1]) * step_x
            up = (row[pillar] - row[pillar - 1]) * step_y
            if up == 0:
                end = varints.put(out, end, abs(right) << 4 | (4 if right < 0 else 0))
            elif right == 0:
                end = varints.put(out, end, abs(up) << 4 | (6 if up < 0 else 2))
            else:
                end = varints.put(out, end, abs(right) << 2 | (right < 0) << 1 | 1)
                end = varints.put(out, end, abs(up) << 1 | (up < 0))
        here = behind
    return end


def rectangle_records_vectorised(
    tile: PillarTile,
    lattice: Lattice,
    size_dbu: NDArray[np.int64],
    cell: TileCell,
    layer_datatype: tuple[int, int],
) -> bytes:
    """As :func:`rectangle_records`, in NumPy alone: every byte is an unsigned integer, ids and flags included."""
    grid = math.gcd(*lattice.period_dbu)
    step_x, step_y = (period // grid for period in lattice.period_dbu)
    row, column, end_of = sorted_by_size_vectorised(tile.size_index, len(size_dbu), _fast_along_y(tile.size_index))
    start_of = np.append(0, end_of[:-1])
    used = np.flatnonzero(end_of > start_of)
    first, count = start_of[used], (end_of - start_of)[used]

    # Each column of the head, and where it is given: layer and datatype once, lists only for two and more.
    size = size_dbu[used]
    corner = np.stack([column[first] * lattice.period_dbu[0], row[first] * lattice.period_dbu[1]], axis=1)
    corner += np.array([cell.first_x_dbu, cell.first_y_dbu]) - size // 2
    modal = np.concatenate([size, corner], axis=1)
    before = np.concatenate([[[-1, -1, 0, 0]], modal[:-1]])
    changed = modal != before
    opens, several = np.arange(used.size) == 0, count > 1
    info = changed @ np.array([_W, _H, _X, _Y]) + _REPETITION * several + _DATATYPE_LAYER * opens
    steps = _zigzag((modal - before)[:, 2:])
    constants = np.broadcast_to([RECTANGLE, *layer_datatype, _ARBITRARY_ON_GRID, grid], (used.size, 5))
    head = np.column_stack(
        [constants[:, 0], info, constants[:, 1:3], size, steps, constants[:, 3], count - 2, constants[:, 4]]
    )
    always = np.ones(used.size, dtype=bool)
    given = np.column_stack([always, always, opens, opens, changed, several, several, several])

    # Displacements from the previous pillar of the same size: along x or y alone (form 1) or both (form 2).
    delta_x, delta_y = np.diff(column, prepend=0) * step_x, np.diff(row, prepend=0) * step_y
    along_x, along_y = delta_y == 0, delta_x == 0
    direction = np.where(along_x, np.where(delta_x < 0, 2, 0), np.where(delta_y < 0, 3, 1))
    form_1 = (np.abs(delta_x + delta_y) << 4) | (direction << 1)
    form_2 = (np.abs(delta_x) << 2) | ((delta_x < 0) << 1) | 1
    single = along_x | along_y

    tokens_of = np.where(single, 1, 2)
    tokens_of[first] = given.sum(axis=1)
    end = np.cumsum(tokens_of)
    start = end - tokens_of
    tokens = np.empty(int(end[-1]), dtype=np.int64)
    inner = np.ones(row.size, dtype=bool)
    inner[first] = False
    one, two = inner & single, inner & ~single
    tokens[start[one]] = form_1[one]
    tokens[start[two]] = form_2[two]
    tokens[start[two] + 1] = _zigzag(delta_y[two])
    tokens[(start[first][:, None] + np.cumsum(given, axis=1) - 1)[given]] = head[given]
    return varints.encode_vectorised(tokens.view(np.uint64))


def _fast_along_y(size_index: NDArray[np.uint16]) -> bool:
    """Whether neighbours agree more often along y than along x."""
    along_x = np.count_nonzero(size_index[:, 1:] == size_index[:, :-1])
    return bool(np.count_nonzero(size_index[1:] == size_index[:-1]) > along_x)


@compiled
def _sorted_by_size(
    size_index: NDArray[np.uint16], sizes: int, fast_along_y: bool
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Row and column of each pillar, by size, strip and line; and where each size ends in the list."""
    n_y, n_x = size_index.shape
    end_of = np.zeros(sizes, dtype=np.int64)
    for i in range(n_y):
        for j in range(n_x):
            end_of[size_index[i, j]] += 1
    end_of[0] = 0
    end_of = np.cumsum(end_of)
    row, column = np.empty(end_of[-1], dtype=np.int32), np.empty(end_of[-1], dtype=np.int32)
    following = np.append(np.int64(0), end_of[:-1])
    slow, fast = (n_x, n_y) if fast_along_y else (n_y, n_x)
    for strip in range(0, fast, _STRIP_SITES):
        for i in range(slow):
            for j in range(strip, min(strip + _STRIP_SITES, fast)):
                size = size_index[j, i] if fast_along_y else size_index[i, j]
                if size:
                    place = following[size]
                    row[place], column[place] = (j, i) if fast_along_y else (i, j)
                    following[size] = place + 1
    return row, column, end_of


def sorted_by_size_vectorised(
    size_index: NDArray[np.uint16], sizes: int, fast_along_y: bool
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """As the compiled sorting, in NumPy alone."""
    places: NDArray[np.int32] = np.arange(size_index.size, dtype=np.int32).reshape(size_index.shape)
    scanned = places.T if fast_along_y else places
    strips = [scanned[:, k : k + _STRIP_SITES].ravel() for k in range(0, scanned.shape[1], _STRIP_SITES)]
    place = np.concatenate(strips)
    size = size_index.ravel()[place]
    count = np.bincount(size, minlength=sizes)
    order = np.argsort(size, kind="stable")[count[0] :]
    count[0] = 0
    row, column = np.divmod(place[order], np.int32(size_index.shape[1]))
    return row, column, np.cumsum(count)


def _zigzag(value: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((np.abs(value) << 1) | (value < 0))
