"""GDSII by streaming: one structure per tile, one BOUNDARY per pillar; the top structure places the tiles.

Plain boundaries open several times faster in viewers than one reference per pillar. A BOUNDARY of four corners is
64 bytes, 16 big-endian words, which makes a tile one array.

Datatypes may be doses in thousandths of the base dose. Raith's dialect has 1000 times the dose factor in the record
DATATYPE of every element (toolbox Raith_GDSII of the National Research Council of Canada, version 1.2); NanoMaker has
the dose in tenths of a percent there.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.storage.files import whole_file
from metafab.layout.pillars import PillarTile
from metafab.mask.drawing.cell_writer import EncodedTile, MaskWriter, TileEncoder
from metafab.mask.drawing.cells import Stamp, TileCell
from metafab.mask.drawing.scan import Scan, sorted_by_size
from metafab.mask.gdsii import records
from metafab.mask.gdsii.records import real, record, text
from metafab.mask.shapes.hierarchy import IntArray

#: Words of a BOUNDARY with four corners.
BOUNDARY_WORDS = 16
#: Words of a reference to the structure of a size.
REFERENCE_WORDS = 10
# First coordinate of a BOUNDARY and of such a reference, in words.
_BOUNDARY_XY, _REFERENCE_XY = 5, 7

# Polygons of a size are listed row by row.
_ROWS = Scan(along_y=False, strip_sites=1 << 16)

# A fixed date in every header, so that equal layouts give equal bytes: 2000-01-01 00:00:00, twice.
_DATE = struct.pack(">12h", *(2000, 1, 1, 0, 0, 0) * 2)
#: Datatype of the base dose, and the largest datatype of a signed word.
_BASE, _LARGEST = 1000, 2**15 - 1


@dataclass(frozen=True)
class GdsiiEncoder(TileEncoder):
    """Encodes tiles as boundaries."""

    #: Memory of tiles already written, of any shape; fresh pages from the system cost as much time as the file.
    spare: list[NDArray[np.int32]] = field(default_factory=list)

    def _content(self, parts: Sequence[tuple[PillarTile, Stamp]], cell: TileCell) -> Iterable[NDArray[np.uint8]]:
        return (self._boundaries(tile, cell, stamp) for tile, stamp in parts)

    def _boundaries(self, tile: PillarTile, cell: TileCell, stamp: Stamp) -> NDArray[np.uint8]:
        """Boundaries or references of one stamp."""
        if stamp.polygons is not None:
            return self._polygons(tile, cell, stamp)
        words = self._buffer(int(np.count_nonzero(tile.size_index)))
        fill_boundaries(
            np.ascontiguousarray(tile.size_index),
            stamp.size_dbu,
            stamp.corner_dbu,
            self.drawing.lattice.period_dbu,
            (cell.first_x_dbu, cell.first_y_dbu),
            boundary_template(stamp.layer, stamp.datatype).byteswap(),
            words,
        )
        return words.reshape(-1).view(np.uint8)

    def _polygons(self, tile: PillarTile, cell: TileCell, stamp: Stamp) -> NDArray[np.uint8]:
        """References to the structure of each size, size by size; in a flat mask, the polygons themselves."""
        assert stamp.polygons is not None
        row, column, end_of = sorted_by_size(tile.size_index, len(stamp.size_dbu), _ROWS)
        period = np.array(self.drawing.lattice.period_dbu)
        sites = np.stack([column, row], axis=1) * period + [cell.first_x_dbu, cell.first_y_dbu]
        elements = []
        for size in np.flatnonzero(np.diff(end_of, prepend=0)).tolist():
            places = sites[end_of[size - 1] : end_of[size]]
            if self.drawing.flat:
                corners = stamp.corner_dbu[size] + stamp.polygons[size]
                polygon = boundary(corners, stamp.layer, stamp.datatype)
                elements.append(_repeated(polygon, _BOUNDARY_XY, len(corners) + 1, places))
            else:
                elements.append(_repeated(_reference(stamp, size), _REFERENCE_XY, 1, places))
        return np.concatenate([words.reshape(-1).view(np.uint8) for words in elements])

    def _cells(self, tile: PillarTile, stamp: Stamp) -> dict[str, bytes]:
        """A structure for each size that occurs."""
        if stamp.polygons is None:
            return {}
        cells = {}
        for size in np.unique(tile.size_index[tile.size_index > 0]).tolist():
            corners = stamp.corner_dbu[size] + stamp.polygons[size]
            polygon = boundary(corners, stamp.layer, stamp.datatype).byteswap().tobytes()
            name = _size_name(stamp, size)
            cells[name] = _structure(name) + polygon + record(records.ENDSTR)
        return cells

    def _buffer(self, pillars: int) -> NDArray[np.int32]:
        """Words for some pillars, shape (pillars, 16), in spare memory if a piece is large enough."""
        with suppress(IndexError):
            spare = self.spare.pop()
            if len(spare) >= pillars:
                return spare[:pillars]
        return np.empty((pillars, BOUNDARY_WORDS), dtype=np.int32)


class GdsiiWriter(MaskWriter):
    """Writes GDSII; refuses coordinates beyond 32 bits."""

    def _begin_file(self) -> None:
        drawing = self._drawing
        lattice = drawing.lattice
        reach = max(n * p for n, p in zip(lattice.shape[::-1], lattice.period_dbu, strict=True)) // 2 + 1
        reach += max((max(abs(copy.x_dbu), abs(copy.y_dbu)) for copy in drawing.copies), default=0)
        _require_reach(reach)
        self._spare: list[NDArray[np.int32]] = []
        self.encoder = GdsiiEncoder(drawing, self._spare)
        unit_m = lattice.database_unit_nm * 1e-9
        self._write(
            record(records.HEADER, struct.pack(">h", 600))
            + record(records.BGNLIB, _DATE)
            + record(records.LIBNAME, text("METAFAB"))
            + record(records.UNITS, real(unit_m / 1e-6) + real(unit_m))
        )

    def add(self, tile: EncodedTile) -> None:
        """Append the structure of a tile; keep its memory for another tile if it was encoded in this process."""
        super().add(tile)
        bases = (piece.base for piece in tile.content)
        self._spare += [base for base in bases if isinstance(base, np.ndarray) and base.ndim == 2]

    def _begin_cell(self, name: str) -> None:
        self._write(_structure(name))

    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None:
        place = record(records.XY, struct.pack(">2i", x_dbu, y_dbu))
        self._write(record(records.SREF) + record(records.SNAME, text(name)) + place + record(records.ENDEL))

    def _draw(self, layer: int, rectangles: IntArray) -> None:
        reach = int(np.abs(rectangles).sum(axis=1).max(initial=0))
        _require_reach(reach)
        for x, y, width, height in rectangles.tolist():
            corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
            self._write(boundary(corners, layer, 0).byteswap().tobytes())

    def _draw_polygon(self, layer: int, datatype: int, corners: IntArray) -> None:
        reach = int(np.abs(corners).max())
        _require_reach(reach)
        self._write(boundary(corners, layer, datatype).byteswap().tobytes())

    def _add_text(self, layer: int, kind: int, at_dbu: tuple[int, int], words: str) -> None:
        _require_reach(max(map(abs, at_dbu)))
        _require_layer(layer, kind)
        of = record(records.LAYER, struct.pack(">H", layer)) + record(records.TEXTTYPE, struct.pack(">H", kind))
        place = record(records.XY, struct.pack(">2i", *at_dbu)) + record(records.STRING, text(words))
        self._write(record(records.TEXT) + of + place + record(records.ENDEL))

    def _end_cell(self) -> None:
        self._write(record(records.ENDSTR))

    def _end_file(self) -> None:
        self._write(record(records.ENDLIB))


def _structure(name: str) -> bytes:
    """Beginning of a structure."""
    return record(records.BGNSTR, _DATE) + record(records.STRNAME, text(name))


def _size_name(stamp: Stamp, size: int) -> str:
    """Structure name of a polygon by drawn width, length (database units) and datatype: 16 characters.

    Turned pillars of one size differ in angle: their names hold the size index in place of the length.
    """
    width, length = stamp.size_dbu[size].tolist()
    if stamp.turned:
        return f"T{size:05d}W{width:06d}D{_two_characters(stamp.datatype)}"
    return f"W{width:06d}L{length:05d}D{_two_characters(stamp.datatype)}"


def _two_characters(datatype: int) -> str:
    """Datatype in two characters: digits below 100, then a letter and a letter or digit."""
    if datatype < 100:
        return f"{datatype:02d}"
    first, second = divmod((datatype - 100) % 936, 36)
    return "ABCDEFGHIJKLMNOPQRSTUVWXYZ"[first] + "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"[second]


def _reference(stamp: Stamp, size: int) -> NDArray[np.int32]:
    """Words of a reference to the structure of a size, coordinates zero, in native byte order."""
    name = record(records.SNAME, text(_size_name(stamp, size)))
    data = record(records.SREF) + name + record(records.XY, bytes(8)) + record(records.ENDEL)
    return np.frombuffer(data, dtype=">i4").astype(np.int32)


def _repeated(element: NDArray[np.int32], first: int, points: int, places: IntArray) -> NDArray[np.int32]:
    """Repeat an element at each place, shape (n, words), bytes big-endian; its points begin at word ``first``."""
    words = np.repeat(element[None], len(places), axis=0)
    for axis in (0, 1):
        words[:, first + axis : first + 2 * points : 2] += places[:, axis, None].astype(np.int32)
    return words.byteswap()


def boundary(corners: IntArray, layer: int, datatype: int) -> NDArray[np.int32]:
    """Words of a BOUNDARY in native byte order, shape (n_words,); its points begin at word 5.

    Corners have the shape (n, 2) and are not closed. InputError for a layer or datatype beyond 15 bits.
    """
    _require_layer(layer, datatype)
    closed = np.concatenate([corners, corners[:1]]).astype(">i4").tobytes()
    data = (
        record(records.BOUNDARY)
        + record(records.LAYER, struct.pack(">h", layer))
        + record(records.DATATYPE, struct.pack(">h", datatype))
        + record(records.XY, closed)
        + record(records.ENDEL)
    )
    return np.frombuffer(data, dtype=">i4").astype(np.int32)


def boundary_template(layer: int, datatype: int) -> NDArray[np.int32]:
    """Words of a BOUNDARY with four corners, shape (16,), coordinates zero, in native byte order."""
    return boundary(np.zeros((4, 2), dtype=np.int64), layer, datatype)


def _require_reach(reach_dbu: int) -> None:
    """InputError for coordinates that GDSII does not hold."""
    if reach_dbu >= 2**31:
        raise _beyond_gdsii("coordinates of 32 bits", f"{reach_dbu} database units")


def _require_layer(layer: int, datatype: int) -> None:
    """InputError for a layer or datatype that GDSII does not hold."""
    if max(layer, datatype) > _LARGEST:
        raise _beyond_gdsii(f"layers and datatypes of at most {_LARGEST}", f"layer {layer}/{datatype}")


def _beyond_gdsii(expected: str, got: str) -> InputError:
    return InputError.single("mask", "formats", f"{expected} for 'gds'", got, "write 'oas', which has no such limits")


@compiled
def fill_boundaries(
    size_index: NDArray[np.uint16],
    size_dbu: NDArray[np.int64],
    corner_dbu: NDArray[np.int64],
    period_dbu: tuple[int, int],
    first_dbu: tuple[int, int],
    swapped: NDArray[np.int32],
    words: NDArray[np.int32],
) -> None:
    """Write the boundaries of all pillars of a tile, row by row, corners counter-clockwise from the lower left.

    Args:
        size_index: shape (n_y, n_x), as :attr:`PillarTile.size_index`.
        size_dbu: shape (n_sizes + 1, 2), width and length.
        corner_dbu: shape (n_sizes + 1, 2), from the site to the lower left corner.
        period_dbu: (x, y) pitch.
        first_dbu: (x, y) of the first site.
        swapped: shape (16,), a :func:`boundary_template` with big-endian bytes.
        words: shape (n_pillars, 16), filled with words whose bytes are big-endian.
    """
    pillar = 0
    for row in range(size_index.shape[0]):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                continue
            width, length = int(size_dbu[size, 0]), int(size_dbu[size, 1])
            x_0 = first_dbu[0] + column * period_dbu[0] + corner_dbu[size, 0]
            y_0 = first_dbu[1] + row * period_dbu[1] + corner_dbu[size, 1]
            x_1, y_1 = _swap_bytes(x_0 + width), _swap_bytes(y_0 + length)
            x_0, y_0 = _swap_bytes(x_0), _swap_bytes(y_0)
            out = words[pillar]
            for word in range(5):
                out[word] = swapped[word]
            out[5], out[6], out[7], out[8], out[9], out[10] = x_0, y_0, x_1, y_0, x_1, y_1
            out[11], out[12], out[13], out[14], out[15] = x_0, y_1, x_0, y_0, swapped[15]
            pillar += 1


@compiled
def _swap_bytes(value: int) -> int:
    word = value & 0xFFFFFFFF
    swapped = (word >> 24) | ((word >> 8) & 0xFF00) | ((word << 8) & 0xFF0000) | ((word << 24) & 0xFF000000)
    return swapped - 0x100000000 if swapped >= 0x80000000 else swapped


def write_dose_datatypes(source: Path, target: Path, layer: int, doses: Mapping[int, float]) -> None:
    """Copy a GDSII file; the datatypes of one layer become their doses in thousandths, those of all others 1000.

    Args:
        source: the file.
        target: the copy.
        layer: layer whose datatypes have doses.
        doses: dose of each datatype relative to the base dose.

    Raises:
        InputError: a dose is above 32.767 or below 0.0005.
    """
    table = np.zeros(_LARGEST + 1, dtype=np.int64)
    for datatype, dose in doses.items():
        table[datatype] = round(_BASE * dose)
        if not 1 <= table[datatype] <= _LARGEST:
            expected = "doses from 0.0005 to 32.767 of the base dose, as thousandths in two bytes"
            raise InputError.single("mask", "dose datatypes", expected, f"{dose:g}")
    with whole_file(target) as part:
        shutil.copyfile(source, part)
        content = np.memmap(part, dtype=np.uint8, mode="r+")
        _replace(content, layer, table)
        content.flush()
        del content  # Closes the map.


@compiled
def _replace(content: NDArray[np.uint8], layer: int, table: NDArray[np.int64]) -> None:
    """Replace the datatypes in the bytes of a GDSII file, shape (n,), by ``table``, shape (32768,)."""
    at, here = 0, False
    while at + 6 <= content.size:
        length = content[at] * 256 + content[at + 1]
        if length < 4:
            return
        kind = content[at + 2] * 256 + content[at + 3]
        value = content[at + 4] * 256 + content[at + 5]
        if kind == records.LAYER:
            here = value == layer
        elif kind == records.DATATYPE:
            value = table[value] if here else _BASE
            content[at + 4], content[at + 5] = value // 256, value % 256
        at += length
