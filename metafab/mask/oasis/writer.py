"""OASIS (SEMI P39) by streaming: a cell a tile, one RECTANGLE a size with all its places as a repetition.

The records of a tile are deflated into one CBLOCK (:mod:`metafab.mask.oasis.records`). The file ends with a CRC-32, so
that readers can tell a damaged file.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from metafab.layout.pillars import PillarTile
from metafab.mask.drawing.cell_writer import MaskWriter, TileEncoder
from metafab.mask.drawing.cells import Stamp, TileCell
from metafab.mask.oasis import varints
from metafab.mask.oasis.records import DATATYPE_LAYER, RECTANGLE, H, W, X, Y, best_scan, deflate, rectangle_records
from metafab.mask.shapes.hierarchy import IntArray

MAGIC = b"%SEMI-OASIS\r\n"
START, END, CELL, XYRELATIVE, PLACEMENT, CBLOCK = 1, 2, 14, 16, 17, 34
_END_BYTES = 256


class OasisEncoder(TileEncoder):
    """Tiles as CBLOCKs."""

    def _content(self, tile: PillarTile, cell: TileCell, stamp: Stamp) -> NDArray[np.uint8]:
        drawn = (tile, self.drawing.lattice, stamp, cell)
        flat = self.drawing.flat
        records = rectangle_records(*drawn, best_scan(*drawn), absolute=flat)
        packed = deflate(records)
        block = bytes([CBLOCK, 0]) + varints.unsigned(len(records)) + varints.unsigned(len(packed)) + packed
        return np.frombuffer((b"" if flat else bytes([XYRELATIVE])) + block, dtype=np.uint8)


class OasisWriter(MaskWriter):
    """Writes OASIS."""

    def _begin_file(self) -> None:
        self._crc, self.encoder = 0, OasisEncoder(self._drawing)
        per_um = 1e3 / self._drawing.lattice.database_unit_nm
        self._write(MAGIC + bytes([START]) + varints.string("1.0") + _real(per_um) + bytes(13))

    def _begin_cell(self, name: str) -> None:
        self._write(bytes([CELL]) + varints.string(name))

    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None:
        place = varints.signed(x_dbu) + varints.signed(y_dbu)  # info byte CNXYRAAF: the cell by its name, x and y given
        self._write(bytes([PLACEMENT, 0b1011_0000]) + varints.string(name) + place)

    def _draw(self, layer: int, rectangles: IntArray) -> None:
        head = bytes([RECTANGLE, W | H | X | Y | DATATYPE_LAYER]) + varints.unsigned(layer) + varints.unsigned(0)
        for x, y, width, height in rectangles.tolist():
            size = varints.unsigned(width) + varints.unsigned(height)
            self._write(head + size + varints.signed(x) + varints.signed(y))

    def _end_cell(self) -> None:
        """A cell ends where another record than one of its contents begins."""

    def _end_file(self) -> None:
        padding = _END_BYTES - 1 - 2 - 1 - 4  # id, length of the padding, scheme, CRC
        self._write(bytes([END]) + varints.unsigned(padding) + bytes(padding) + bytes([1]))
        self._stream.write(struct.pack("<I", self._crc))

    def _write(self, data: bytes | memoryview) -> None:
        self._crc = zlib.crc32(data, self._crc)
        super()._write(data)


def _real(value: float) -> bytes:
    """A real: type 0 where it is whole, else type 7 (IEEE 754 double)."""
    whole = round(value)
    if abs(value - whole) < 1e-9 * value:
        return b"\x00" + varints.unsigned(whole)
    return b"\x07" + struct.pack("<d", value)
