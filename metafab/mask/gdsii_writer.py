"""GDSII (Stream format 6) by streaming: a structure a tile, a BOUNDARY a pillar, tiles placed by the top structure.

Plain boundaries open several times faster in viewers than one reference a pillar. A BOUNDARY of four corners is
64 bytes, 16 big-endian words, which makes a tile one array.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask.cells import TileCell, lens_name, tile_cell
from metafab.mask.copies import LensCopy, biases_dbu
from metafab.mask.hierarchy import IntArray

BOUNDARY_WORDS = 16

# A fixed date in every header, so that the same layout gives the same bytes: 2000-01-01 00:00:00.
_DATE = (2000, 1, 1, 0, 0, 0) * 2


class GdsiiWriter:
    """Writes tiles as they come; memory stays that of one tile.

    Args:
        stream: binary stream at its start.
        lattice: lattice of the tiles.
        size_dbu: shape (n_sizes + 1, 2), as :attr:`PillarMap.size_dbu`.
        top: name of the top structure.
        layer: layer of the pillars.
        datatype: datatype of the pillars.
        copies: lenses to place where there are several; without any, the top structure is the lens.

    Raises:
        InputError: the layout reaches beyond 32-bit coordinates.
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
        reach = max(n * p for n, p in zip(lattice.shape[::-1], lattice.period_dbu, strict=True)) // 2 + 1
        reach += max((max(abs(copy.x_dbu), abs(copy.y_dbu)) for copy in copies), default=0)
        if reach >= 2**31 or max(layer, datatype) >= 2**15:
            raise self._beyond(reach, f"{layer}/{datatype}")
        self._stream = stream
        self._lattice = lattice
        self._size_dbu = size_dbu
        self._top = top
        self._layer, self._datatype = layer, datatype
        self._copies = copies
        self._placed: dict[int, list[TileCell]] = {bias: [] for bias in biases_dbu(copies) or (0,)}
        unit_m = lattice.database_unit_nm * 1e-9
        stream.write(
            record(0x0002, struct.pack(">h", 600))
            + record(0x0102, struct.pack(">12h", *_DATE))
            + record(0x0206, text("METAFAB"))
            + record(0x0305, excess_64(unit_m / 1e-6) + excess_64(unit_m))
        )

    @staticmethod
    def _beyond(reach: int, layer: str) -> InputError:
        return InputError.single(
            "mask",
            "formats",
            "coordinates of 32 bits and layers below 32768 for 'gds'",
            f"{reach} database units, layer {layer}",
            "write 'oas', which has no such limits",
        )

    def encode(self, tile: PillarTile, dose_class: int = 0, bias_dbu: int = 0) -> tuple[int, TileCell, memoryview]:
        """The bias, the cell of the pillars of ``tile`` drawn with it, and the bytes of its elements.

        Safe to call from several threads.
        """
        cell = tile_cell(self._lattice, tile, dose_class, bias_dbu)
        fill = fill_boundaries if HAS_NUMBA else fill_boundaries_vectorised
        words = fill(
            np.ascontiguousarray(tile.size_index),
            self._size_dbu + np.int32(bias_dbu),
            self._lattice.period_dbu,
            (cell.first_x_dbu, cell.first_y_dbu),
            boundary_template(self._layer, self._datatype + dose_class),
        )
        return bias_dbu, cell, words.data.cast("B")

    def add(self, encoded: tuple[int, TileCell, memoryview]) -> None:
        """Append what :meth:`encode` returned as a structure."""
        bias_dbu, cell, elements = encoded
        self._placed[bias_dbu].append(cell)
        self._stream.write(_begin(cell.name))
        self._stream.write(elements)  # not copied: a tile has tens of megabytes
        self._stream.write(record(0x0700))

    def close(self, beside: Iterable[tuple[int, IntArray]] = ()) -> None:
        """Write the top structure, with (layer, rectangles) ``beside`` the pillars, and the end of the library.

        Raises:
            InputError: a rectangle reaches beyond 32-bit coordinates.
        """
        if self._copies:
            for bias_dbu in self._placed:
                self._stream.write(_begin(lens_name(bias_dbu, self._top)))
                self._place_tiles(bias_dbu)
                self._stream.write(record(0x0700))
        self._stream.write(_begin(self._top))
        if not self._copies:
            self._place_tiles(0)
        for copy in self._copies:
            self._place(lens_name(copy.bias_dbu, self._top), copy.x_dbu, copy.y_dbu)
        for layer, rectangles in beside:
            reach = int(np.abs(rectangles).sum(axis=1).max(initial=0))
            if max(reach, layer << 16) >= 2**31:
                raise self._beyond(reach, f"{layer}/0")
            words = np.tile(boundary_template(layer, 0), (len(rectangles), 1))
            low, high = rectangles[:, :2], rectangles[:, :2] + rectangles[:, 2:]
            words[:, 5:15:2] = np.stack([low, high, high, low, low], axis=1)[:, :, 0]
            words[:, 6:15:2] = np.stack([low, low, high, high, low], axis=1)[:, :, 1]
            self._stream.write(words.byteswap().tobytes())
        self._stream.write(record(0x0700) + record(0x0400))

    def _place_tiles(self, bias_dbu: int) -> None:
        for cell in self._placed[bias_dbu]:
            self._place(cell.name, cell.x_dbu, cell.y_dbu)

    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None:
        place = record(0x1003, struct.pack(">2i", x_dbu, y_dbu))
        self._stream.write(record(0x0A00) + record(0x1206, text(name)) + place + record(0x1100))


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
    data = (
        record(0x0800)
        + record(0x0D02, struct.pack(">h", layer))
        + record(0x0E02, struct.pack(">h", datatype))
        + record(0x1003, bytes(40))
        + record(0x1100)
    )
    return np.frombuffer(data, dtype=">i4").astype(np.int32)


def fill_boundaries(
    size_index: NDArray[np.uint16],
    size_dbu: NDArray[np.int32],
    period_dbu: tuple[int, int],
    first_dbu: tuple[int, int],
    template: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Boundaries of all pillars of a tile, row by row, corners counter-clockwise from the lower left.

    Returns:
        Shape (n_pillars, 16), words whose bytes are already big-endian.
    """
    words = np.empty((np.count_nonzero(size_index), BOUNDARY_WORDS), dtype=np.int32)
    _fill(size_index, size_dbu, *period_dbu, *first_dbu, template.byteswap(), words)
    return words


@compiled
def _fill(
    size_index: NDArray[np.uint16],
    size_dbu: NDArray[np.int32],
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
            x_0 = first_x + column * period_x - width // 2
            y_0 = first_y + row * period_y - length // 2
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
    size_dbu: NDArray[np.int32],
    period_dbu: tuple[int, int],
    first_dbu: tuple[int, int],
    template: NDArray[np.int32],
) -> NDArray[np.int32]:
    """As :func:`fill_boundaries`, in NumPy alone."""
    row, column = np.nonzero(size_index)
    width, length = size_dbu[size_index[row, column]].T
    words = np.empty((row.size, BOUNDARY_WORDS), dtype=np.int32)
    words[:] = template
    left = first_dbu[0] + column * period_dbu[0] - width // 2
    bottom = first_dbu[1] + row * period_dbu[1] - length // 2
    words[:, 5] = words[:, 11] = words[:, 13] = left
    words[:, 7] = words[:, 9] = left + width
    words[:, 6] = words[:, 8] = words[:, 14] = bottom
    words[:, 10] = words[:, 12] = bottom + length
    return words.byteswap()


def _begin(name: str) -> bytes:
    return record(0x0502, struct.pack(">12h", *_DATE)) + record(0x0606, text(name))
