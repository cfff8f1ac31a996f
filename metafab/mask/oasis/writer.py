"""OASIS by streaming: one cell per tile, one RECTANGLE per size with all its places as a repetition.

The records of a tile, dose class by dose class, are deflated into one CBLOCK. The file ends with a CRC-32, by which
readers detect damage.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from metafab.layout.pillars import PillarTile
from metafab.mask.drawing.cell_writer import MaskWriter, TileEncoder
from metafab.mask.drawing.cells import Stamp, TileCell
from metafab.mask.oasis.elements import real, signed, string, unsigned
from metafab.mask.oasis.records import (
    DATATYPE_LAYER,
    POINTS,
    POLYGON,
    RECTANGLE,
    H,
    W,
    X,
    Y,
    best_scan,
    deflate,
    pillar_records,
    point_list,
)
from metafab.mask.shapes.hierarchy import IntArray

MAGIC = b"%SEMI-OASIS\r\n"
START, END, CELL, XYRELATIVE, PLACEMENT, TEXT, CBLOCK = 1, 2, 14, 16, 17, 19, 34
#: Length of the END record.
END_BYTES = 256


class OasisEncoder(TileEncoder):
    """Encodes tiles as CBLOCKs."""

    def _content(self, parts: Sequence[tuple[PillarTile, Stamp]], cell: TileCell) -> Iterable[NDArray[np.uint8]]:
        drawn, flat = (parts, self.drawing.lattice, cell), self.drawing.flat
        records = pillar_records(*drawn, best_scan(*drawn), absolute=flat)
        packed = deflate(records)
        block = bytes([CBLOCK, 0]) + unsigned(len(records)) + unsigned(len(packed)) + packed
        return (np.frombuffer((b"" if flat else bytes([XYRELATIVE])) + block, dtype=np.uint8),)


class OasisWriter(MaskWriter):
    """Writes OASIS."""

    def _begin_file(self) -> None:
        self._crc, self.encoder = 0, OasisEncoder(self._drawing)
        per_um = 1e3 / self._drawing.lattice.database_unit_nm
        self._write(MAGIC + bytes([START]) + string("1.0") + real(per_um) + bytes(13))

    def _begin_cell(self, name: str) -> None:
        self._write(bytes([CELL]) + string(name))

    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None:
        info = 0b1011_0000  # CNXYRAAF: the cell by its name, x and y given
        self._write(bytes([PLACEMENT, info]) + string(name) + signed(x_dbu) + signed(y_dbu))

    def _draw(self, layer: int, rectangles: IntArray) -> None:
        head = bytes([RECTANGLE, W | H | X | Y | DATATYPE_LAYER]) + unsigned(layer) + unsigned(0)
        for x, y, width, height in rectangles.tolist():
            self._write(head + unsigned(width) + unsigned(height) + signed(x) + signed(y))

    def _draw_polygon(self, layer: int, datatype: int, corners: IntArray) -> None:
        head = bytes([POLYGON, POINTS | X | Y | DATATYPE_LAYER]) + unsigned(layer) + unsigned(datatype)
        points = point_list((corners - corners[0]).tobytes())
        self._write(head + points + signed(int(corners[0, 0])) + signed(int(corners[0, 1])))

    def _add_text(self, layer: int, kind: int, at_dbu: tuple[int, int], words: str) -> None:
        info = 0b0101_1011  # 0CNXYRTL: the words, x and y, text type and layer given
        place = signed(at_dbu[0]) + signed(at_dbu[1])
        self._write(bytes([TEXT, info]) + string(words) + unsigned(layer) + unsigned(kind) + place)

    def _end_cell(self) -> None:
        """A cell ends where the next cell or the END record begins."""

    def _end_file(self) -> None:
        padding = END_BYTES - 1 - 2 - 1 - 4  # Without record type, length of the padding, validation scheme and CRC.
        self._write(bytes([END]) + unsigned(padding) + bytes(padding) + bytes([1]))
        self._stream.write(struct.pack("<I", self._crc))

    def _write(self, data: bytes | memoryview) -> None:
        self._crc = zlib.crc32(data, self._crc)
        super()._write(data)
