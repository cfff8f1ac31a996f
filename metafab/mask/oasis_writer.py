"""OASIS (SEMI P39) by streaming: a cell a tile, one RECTANGLE a size with all its places as a repetition.

The records of a tile are deflated into one CBLOCK (:mod:`metafab.mask.oasis_records`). The file ends with a CRC-32, so
that readers can tell a damaged file.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask import varints
from metafab.mask.cells import TileCell, lens_name, tile_cell
from metafab.mask.copies import LensCopy, biases_dbu
from metafab.mask.hierarchy import IntArray
from metafab.mask.oasis_records import DATATYPE_LAYER, RECTANGLE, H, W, X, Y, best_scan, deflate, rectangle_records

MAGIC = b"%SEMI-OASIS\r\n"
START, END, CELL, XYRELATIVE, PLACEMENT, CBLOCK = 1, 2, 14, 16, 17, 34
_END_BYTES = 256


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
        drawn = (tile, self._lattice, self._size_dbu + bias_dbu, cell, (layer, datatype + dose_class))
        records = rectangle_records(*drawn, best_scan(*drawn))
        packed = deflate(records)
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
                info = W | H | X | Y | DATATYPE_LAYER
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
