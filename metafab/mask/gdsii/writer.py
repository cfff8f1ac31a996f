"""GDSII (Stream format 6) by streaming: a structure a tile, a BOUNDARY a pillar, tiles placed by the top structure.

Plain boundaries open several times faster in viewers than one reference a pillar. A BOUNDARY of four corners is
64 bytes, 16 big-endian words, which makes a tile one array.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.layout.pillars import PillarTile
from metafab.mask.drawing.cell_writer import EncodedTile, MaskWriter, TileEncoder
from metafab.mask.drawing.cells import Stamp, TileCell
from metafab.mask.oasis.records import Scan, sorted_by_size
from metafab.mask.shapes.hierarchy import IntArray

BOUNDARY_WORDS = 16
#: Of a reference to the cell of a size.
REFERENCE_WORDS = 10

# Polygons of a size are listed row by row.
_ROWS = Scan(along_y=False, strip_sites=1 << 16)

# A fixed date in every header, so that the same layout gives the same bytes: 2000-01-01 00:00:00.
_DATE = (2000, 1, 1, 0, 0, 0) * 2


@dataclass(frozen=True)
class GdsiiEncoder(TileEncoder):
    """Tiles as boundaries.

    Attributes:
        spare: memory of tiles that are written; fresh pages of the system cost as much time as the file.
    """

    spare: list[NDArray[np.int32]] = field(default_factory=list)

    def _content(self, tile: PillarTile, cell: TileCell, stamp: Stamp) -> NDArray[np.uint8]:
        if stamp.polygons is not None:
            return self._polygons(tile, cell, stamp)
        fill = fill_boundaries if HAS_NUMBA else fill_boundaries_vectorised
        if max(stamp.layer, stamp.datatype) >= 2**15:
            raise _beyond(0, f"{stamp.layer}/{stamp.datatype}")
        words = self._buffer(int(np.count_nonzero(tile.size_index)))
        fill(
            np.ascontiguousarray(tile.size_index),
            stamp.size_dbu,
            stamp.corner_dbu,
            self.drawing.lattice.period_dbu,
            (cell.first_x_dbu, cell.first_y_dbu),
            boundary_template(stamp.layer, stamp.datatype),
            words,
        )
        return words.reshape(-1).view(np.uint8)

    def _polygons(self, tile: PillarTile, cell: TileCell, stamp: Stamp) -> NDArray[np.uint8]:
        """References of size cells at all sites or, where the mask is flat, the polygons themselves; size by size."""
        assert stamp.polygons is not None
        row, column, end_of = sorted_by_size(tile.size_index, len(stamp.size_dbu), _ROWS)
        period = np.array(self.drawing.lattice.period_dbu)
        sites = np.stack([column, row], axis=1) * period + [cell.first_x_dbu, cell.first_y_dbu]
        elements = []
        for size in np.flatnonzero(np.diff(end_of, prepend=0)).tolist():
            places = sites[end_of[size - 1] : end_of[size]]
            if self.drawing.flat:
                corners = stamp.corner_dbu[size] + stamp.polygons[size]
                elements.append(_moved(boundary(corners, stamp.layer, stamp.datatype), 5, len(corners) + 1, places))
            else:
                elements.append(_moved(_reference(stamp, size), 7, 1, places))
        return np.concatenate([words.reshape(-1).view(np.uint8) for words in elements])

    def _cells(self, tile: PillarTile, stamp: Stamp) -> dict[str, bytes]:
        """A structure for each size that occurs."""
        if stamp.polygons is None:
            return {}
        cells = {}
        for size in np.unique(tile.size_index[tile.size_index > 0]).tolist():
            corners = stamp.corner_dbu[size] + stamp.polygons[size]
            polygon = boundary(corners, stamp.layer, stamp.datatype).astype(">i4").tobytes()
            name = _size_name(stamp, size)
            cells[name] = _structure(name) + polygon + record(0x0700)
        return cells

    def _buffer(self, pillars: int) -> NDArray[np.int32]:
        """Words for some pillars, shape (pillars, 16), in spare memory if there is a piece that is large enough."""
        with suppress(IndexError):
            spare = self.spare.pop()
            if len(spare) >= pillars:
                return spare[:pillars]
        return np.empty((pillars, BOUNDARY_WORDS), dtype=np.int32)


class GdsiiWriter(MaskWriter):
    """Writes GDSII; refuses what reaches beyond 32-bit coordinates."""

    def _begin_file(self) -> None:
        drawing = self._drawing
        lattice = drawing.lattice
        reach = max(n * p for n, p in zip(lattice.shape[::-1], lattice.period_dbu, strict=True)) // 2 + 1
        reach += max((max(abs(copy.x_dbu), abs(copy.y_dbu)) for copy in drawing.copies), default=0)
        if reach >= 2**31:
            raise _beyond(reach, "any")
        self._spare: list[NDArray[np.int32]] = []
        self.encoder = GdsiiEncoder(drawing, self._spare)
        unit_m = lattice.database_unit_nm * 1e-9
        self._write(
            record(0x0002, struct.pack(">h", 600))
            + record(0x0102, struct.pack(">12h", *_DATE))
            + record(0x0206, text("METAFAB"))
            + record(0x0305, excess_64(unit_m / 1e-6) + excess_64(unit_m))
        )

    def add(self, tile: EncodedTile) -> None:
        """Append the structure of a tile, and keep its memory for another if it was encoded in this process."""
        super().add(tile)
        bases = (piece.base for piece in tile.content)
        self._spare += [base for base in bases if isinstance(base, np.ndarray) and base.ndim == 2]

    def _begin_cell(self, name: str) -> None:
        self._write(_structure(name))

    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None:
        place = record(0x1003, struct.pack(">2i", x_dbu, y_dbu))
        self._write(record(0x0A00) + record(0x1206, text(name)) + place + record(0x1100))

    def _draw(self, layer: int, rectangles: IntArray) -> None:
        reach = int(np.abs(rectangles).sum(axis=1).max(initial=0))
        if max(reach, layer << 16) >= 2**31:
            raise _beyond(reach, f"{layer}/0")
        words = np.tile(boundary_template(layer, 0), (len(rectangles), 1))
        low, high = rectangles[:, :2], rectangles[:, :2] + rectangles[:, 2:]
        words[:, 5:15:2] = np.stack([low, high, high, low, low], axis=1)[:, :, 0]
        words[:, 6:15:2] = np.stack([low, low, high, high, low], axis=1)[:, :, 1]
        self._write(words.byteswap().tobytes())

    def _end_cell(self) -> None:
        self._write(record(0x0700))

    def _end_file(self) -> None:
        self._write(record(0x0400))


def _structure(name: str) -> bytes:
    """How a structure begins."""
    return record(0x0502, struct.pack(">12h", *_DATE)) + record(0x0606, text(name))


def _size_name(stamp: Stamp, size: int) -> str:
    """The cell of a polygon, by drawn width and length in database units, layer and datatype apart: 16 characters.

    Turned pillars of one size differ in angle: the size index and the drawn width, which differs by bias, name them.
    """
    width, length = stamp.size_dbu[size].tolist()
    if stamp.turned:
        return f"T{size:05d}W{width:06d}D{stamp.datatype % 100:02d}"
    return f"W{width:06d}L{length:05d}D{stamp.datatype % 100:02d}"


def _reference(stamp: Stamp, size: int) -> NDArray[np.int32]:
    """The words of a reference to a size's cell, coordinates zero, in native byte order."""
    data = record(0x0A00) + record(0x1206, text(_size_name(stamp, size))) + record(0x1003, bytes(8)) + record(0x1100)
    return np.frombuffer(data, dtype=">i4").astype(np.int32)


def _moved(element: NDArray[np.int32], first: int, points: int, places: IntArray) -> NDArray[np.int32]:
    """An element at each of some places, shape (n, words), bytes big-endian; its points begin at word ``first``."""
    words = np.repeat(element[None], len(places), axis=0)
    for axis in (0, 1):
        words[:, first + axis : first + 2 * points : 2] += places[:, axis, None].astype(np.int32)
    return words.byteswap()


def boundary(corners: IntArray, layer: int, datatype: int) -> NDArray[np.int32]:
    """The words of a BOUNDARY, in native byte order; its points begin at word 5."""
    closed = np.concatenate([corners, corners[:1]]).astype(">i4").tobytes()
    data = (
        record(0x0800)
        + record(0x0D02, struct.pack(">h", layer))
        + record(0x0E02, struct.pack(">h", datatype))
        + record(0x1003, closed)
        + record(0x1100)
    )
    return np.frombuffer(data, dtype=">i4").astype(np.int32)


def _beyond(reach: int, layer: str) -> InputError:
    return InputError.single(
        "mask",
        "formats",
        "coordinates of 32 bits and layers below 32768 for 'gds'",
        f"{reach} database units, layer {layer}",
        "write 'oas', which has no such limits",
    )


def record(kind: int, data: bytes = b"") -> bytes:
    """A record: length, kind (record and data type), data."""
    return struct.pack(">HH", len(data) + 4, kind) + data


def text(value: str) -> bytes:
    """A string padded to whole words."""
    data = value.encode("ascii")
    return data + b"\0" * (len(data) % 2)


def excess_64(value: float) -> bytes:
    """A positive 8-byte real: exponent of 16 in excess 64, mantissa of 56 bits."""
    exponent = 64
    while value >= 1.0:
        value /= 16.0
        exponent += 1
    while value < 1.0 / 16.0:
        value *= 16.0
        exponent -= 1
    mantissa = round(value * 2.0**56)
    return struct.pack(">Q", exponent << 56 | mantissa)


def boundary_template(layer: int, datatype: int) -> NDArray[np.int32]:
    """The 16 words of a BOUNDARY with four corners, coordinates zero, in native byte order."""
    return boundary(np.zeros((4, 2), dtype=np.int64), layer, datatype)


def fill_boundaries(
    size_index: NDArray[np.uint16],
    size_dbu: NDArray[np.int64],
    corner_dbu: NDArray[np.int64],
    period_dbu: tuple[int, int],
    first_dbu: tuple[int, int],
    template: NDArray[np.int32],
    words: NDArray[np.int32],
) -> None:
    """Boundaries of all pillars of a tile, row by row, corners counter-clockwise from the lower left.

    Args:
        size_index: shape (n_y, n_x), as :attr:`PillarTile.size_index`.
        size_dbu: shape (n_sizes + 1, 2), width and length.
        corner_dbu: shape (n_sizes + 1, 2), lower left corner from the centre of the site.
        period_dbu: (x, y) pitch.
        first_dbu: (x, y) of the first site.
        template: what :func:`boundary_template` returns.
        words: filled; shape (n_pillars, 16), words whose bytes are big-endian.
    """
    _fill(size_index, size_dbu, corner_dbu, *period_dbu, *first_dbu, template.byteswap(), words)


@compiled
def _fill(
    size_index: NDArray[np.uint16],
    size_dbu: NDArray[np.int64],
    corner_dbu: NDArray[np.int64],
    period_x: int,
    period_y: int,
    first_x: int,
    first_y: int,
    swapped: NDArray[np.int32],
    words: NDArray[np.int32],
) -> None:
    pillar = 0
    for row in range(size_index.shape[0]):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                continue
            width, length = int(size_dbu[size, 0]), int(size_dbu[size, 1])
            x_0 = first_x + column * period_x + corner_dbu[size, 0]
            y_0 = first_y + row * period_y + corner_dbu[size, 1]
            x_1, y_1 = _swap(x_0 + width), _swap(y_0 + length)
            x_0, y_0 = _swap(x_0), _swap(y_0)
            out = words[pillar]
            for word in range(5):
                out[word] = swapped[word]
            out[5], out[6], out[7], out[8], out[9], out[10] = x_0, y_0, x_1, y_0, x_1, y_1
            out[11], out[12], out[13], out[14], out[15] = x_0, y_1, x_0, y_0, swapped[15]
            pillar += 1


@compiled
def _swap(value: int) -> int:
    word = value & 0xFFFFFFFF
    swapped = (word >> 24) | ((word >> 8) & 0xFF00) | ((word << 8) & 0xFF0000) | ((word << 24) & 0xFF000000)
    return swapped - 0x100000000 if swapped >= 0x80000000 else swapped


def fill_boundaries_vectorised(
    size_index: NDArray[np.uint16],
    size_dbu: NDArray[np.int64],
    corner_dbu: NDArray[np.int64],
    period_dbu: tuple[int, int],
    first_dbu: tuple[int, int],
    template: NDArray[np.int32],
    words: NDArray[np.int32],
) -> None:
    """As :func:`fill_boundaries`, in NumPy alone."""
    row, column = np.nonzero(size_index)
    size = size_index[row, column]
    width, length = size_dbu[size].T
    words[:] = template
    left = first_dbu[0] + column * period_dbu[0] + corner_dbu[size, 0]
    bottom = first_dbu[1] + row * period_dbu[1] + corner_dbu[size, 1]
    words[:, 5] = words[:, 11] = words[:, 13] = left
    words[:, 7] = words[:, 9] = left + width
    words[:, 6] = words[:, 8] = words[:, 14] = bottom
    words[:, 10] = words[:, 12] = bottom + length
    words.byteswap(inplace=True)
