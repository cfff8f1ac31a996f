"""OASIS (SEMI P39) by streaming: a cell a tile, one RECTANGLE a size with all its places as a repetition.

Repetition type 11 lists displacements in steps of a grid, here the lattice; the records of a tile are deflated
into one CBLOCK. The file ends with a CRC-32, so that readers can tell a damaged file.
"""

from __future__ import annotations

import math
import struct
import zlib
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask import varints
from metafab.mask.cells import TileCell, tile_cell

MAGIC = b"%SEMI-OASIS\r\n"
START, END, CELL, PLACEMENT, RECTANGLE, CBLOCK = 1, 2, 14, 17, 20, 34
_END_BYTES = 256
_DEFLATE_LEVEL = 3

# Info byte of RECTANGLE, SWHXYRDL from the top bit: what is given explicitly.
_WHXY, _REPETITION, _DATATYPE_LAYER = 0b0111_1000, 0b100, 0b011
_ARBITRARY_ON_GRID = 11


class OasisWriter:
    """Writes tiles as they come; memory stays that of one tile.

    Args:
        stream: binary stream at its start.
        lattice: lattice of the tiles.
        size_dbu: shape (n_sizes + 1, 2), as :attr:`PillarMap.size_dbu`.
        top: name of the top cell.
        layer: layer of the pillars.
        datatype: datatype of the pillars.
    """

    def __init__(
        self, stream: BinaryIO, lattice: Lattice, size_dbu: NDArray[np.int32], top: str, layer: int, datatype: int
    ) -> None:
        self._stream = stream
        self._lattice = lattice
        self._size_dbu = size_dbu.astype(np.int64)
        self._top = top
        self._layer_datatype = (layer, datatype)
        self._placed: list[TileCell] = []
        self._crc = 0
        self._write(MAGIC + bytes([START]) + varints.string("1.0") + _real(1e3 / lattice.database_unit_nm) + bytes(13))

    def encode(self, tile: PillarTile) -> tuple[TileCell, bytes]:
        """The cell of ``tile`` and its bytes; safe to call from several threads."""
        cell = tile_cell(self._lattice, tile)
        records = rectangle_records(tile, self._lattice, self._size_dbu, cell, self._layer_datatype)
        packed = _deflate(records)
        block = bytes([CBLOCK, 0]) + varints.unsigned(len(records)) + varints.unsigned(len(packed)) + packed
        return cell, bytes([CELL]) + varints.string(cell.name) + block

    def add(self, encoded: tuple[TileCell, bytes]) -> None:
        """Append what :meth:`encode` returned."""
        cell, data = encoded
        self._placed.append(cell)
        self._write(data)

    def close(self, extra: bytes = b"") -> None:
        """Write the top cell, with ``extra`` records in it, and the end of the file."""
        self._write(bytes([CELL]) + varints.string(self._top))
        for cell in self._placed:  # info byte CNXYRAAF: the cell by its name, x and y given
            place = varints.signed(cell.x_dbu) + varints.signed(cell.y_dbu)
            self._write(bytes([PLACEMENT, 0b1011_0000]) + varints.string(cell.name) + place)
        self._write(extra)
        padding = _END_BYTES - 1 - 2 - 1 - 4  # id, length of the padding, scheme, CRC
        self._write(bytes([END]) + varints.unsigned(padding) + bytes(padding) + bytes([1]))
        self._stream.write(struct.pack("<I", self._crc))

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
    """The RECTANGLE records of a tile, by size, not yet deflated."""
    if not HAS_NUMBA:
        return rectangle_records_vectorised(tile, lattice, size_dbu, cell, layer_datatype)
    row, column, size = _sorted_by_size(tile.size_index)
    # No displacement in a tile takes more than 12 bytes, no head of a record more than 64.
    out = np.empty(12 * size.size + 64 * len(size_dbu), dtype=np.uint8)
    first_dbu = (cell.first_x_dbu, cell.first_y_dbu)
    end = _write_records(row, column, size, size_dbu, lattice.period_dbu, first_dbu, layer_datatype, out)
    return out[:end].tobytes()


@compiled
def _write_records(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    size: NDArray[np.uint16],
    size_dbu: NDArray[np.int64],
    period: tuple[int, int],
    first_dbu: tuple[int, int],
    layer_datatype: tuple[int, int],
    out: varints.ByteArray,
) -> int:
    grid = math.gcd(period[0], period[1])
    step_x, step_y = period[0] // grid, period[1] // grid
    end, here = 0, 0
    while here < len(size):
        behind = here + 1
        while behind < len(size) and size[behind] == size[here]:
            behind += 1
        count = behind - here
        width, length = size_dbu[size[here], 0], size_dbu[size[here], 1]
        info = _WHXY | (_REPETITION if count > 1 else 0) | (_DATATYPE_LAYER if here == 0 else 0)
        end = varints.put(out, varints.put(out, end, RECTANGLE), info)
        if here == 0:
            end = varints.put(out, varints.put(out, end, layer_datatype[0]), layer_datatype[1])
        end = varints.put(out, varints.put(out, end, width), length)
        x = first_dbu[0] + column[here] * period[0] - width // 2
        y = first_dbu[1] + row[here] * period[1] - length // 2
        end = varints.put(out, end, abs(x) << 1 | (x < 0))
        end = varints.put(out, end, abs(y) << 1 | (y < 0))
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
    row, column, size = _sorted_by_size(tile.size_index)

    first = np.flatnonzero(np.diff(size, prepend=np.uint16(0)))
    count = np.diff(np.append(first, size.size))
    width, length = size_dbu[size[first]].T
    header = np.empty((first.size, 9), dtype=np.int64)
    header[:, 0] = RECTANGLE
    header[:, 1] = np.where(count > 1, _WHXY | _REPETITION, _WHXY)
    header[:, 2], header[:, 3] = width, length
    header[:, 4] = _zigzag(cell.first_x_dbu + column[first] * lattice.period_dbu[0] - width // 2)
    header[:, 5] = _zigzag(cell.first_y_dbu + row[first] * lattice.period_dbu[1] - length // 2)
    header[:, 6], header[:, 7], header[:, 8] = _ARBITRARY_ON_GRID, count - 2, grid

    # Displacements from the previous pillar of the same size: along x or y alone (form 1) or both (form 2).
    delta_x, delta_y = np.diff(column, prepend=0) * step_x, np.diff(row, prepend=0) * step_y
    along_x, along_y = delta_y == 0, delta_x == 0
    direction = np.where(along_x, np.where(delta_x < 0, 2, 0), np.where(delta_y < 0, 3, 1))
    form_1 = (np.abs(delta_x + delta_y) << 4) | (direction << 1)
    form_2 = (np.abs(delta_x) << 2) | ((delta_x < 0) << 1) | 1
    single = along_x | along_y

    tokens_of = np.where(single, 1, 2)
    tokens_of[first] = np.where(count > 1, 9, 6)
    end = np.cumsum(tokens_of)
    start = end - tokens_of
    tokens = np.empty(int(end[-1]), dtype=np.int64)
    inner = np.ones(size.size, dtype=bool)
    inner[first] = False
    one, two = inner & single, inner & ~single
    tokens[start[one]] = form_1[one]
    tokens[start[two]] = form_2[two]
    tokens[start[two] + 1] = _zigzag(delta_y[two])
    for field in range(9):
        has = count > 1 if field >= 6 else slice(None)
        tokens[start[first[has]] + field] = header[has, field]
    # Layer and datatype are modal: the first record of the cell sets them, after its info byte.
    tokens[1] |= _DATATYPE_LAYER
    return varints.encode_vectorised(np.insert(tokens, 2, layer_datatype).view(np.uint64))


def _sorted_by_size(size_index: NDArray[np.uint16]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint16]]:
    """Row, column and size of each pillar, by size and then along the axis on which neighbours agree more often."""
    along_x = np.count_nonzero(size_index[:, 1:] == size_index[:, :-1])
    along_y = np.count_nonzero(size_index[1:] == size_index[:-1])
    scanned = size_index.T if along_y > along_x else size_index
    flat = scanned.ravel()
    order = np.argsort(flat, kind="stable")[np.count_nonzero(flat == 0) :]
    slow, fast = np.divmod(order, scanned.shape[1])
    return (fast, slow, flat[order]) if along_y > along_x else (slow, fast, flat[order])


def _zigzag(value: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((np.abs(value) << 1) | (value < 0))
