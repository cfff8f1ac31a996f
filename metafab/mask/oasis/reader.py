"""OASIS -> cells, exactly and fast; every record of the standard is read.

The file is parsed twice: once for cells, references and counts, and once, cell by cell, for the shapes. Runs of
RECTANGLE records, which hold nearly all of a mask, are parsed by a compiled loop, all other records in Python. The
first pass skips blocks that begin with a pillar, on the assumption that they hold only pillars, at most one a byte.
If the second pass finds anything else in such a block, it raises :class:`MixedBlockError`, and the file is read again
without skipping. So it is if a cell is magnified or obliquely turned, whose shapes no second pass counts.
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from deflate import DeflateError, deflate_decompress

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.scratch import release
from metafab.mask.budget import Budget
from metafab.mask.oasis.elements import Copies, DamagedError, Stream
from metafab.mask.oasis.records import POLYGON, RECTANGLE
from metafab.mask.oasis.rectangles import LARGEST_CHUNK, RUN, read_rectangles
from metafab.mask.oasis.shapes import SHAPES, Modal, read_shape
from metafab.mask.oasis.writer import CBLOCK, CELL, END, END_BYTES, MAGIC, PLACEMENT, START, XYRELATIVE
from metafab.mask.shapes.hierarchy import Cell, Chunk, IntArray, Orientation, Other, Reference, box_of
from metafab.mask.shapes.recover import RECTANGLES, KnownShapes

_CELL_BY_NUMBER, _XYABSOLUTE, _PLACEMENT_TURNED, _TEXT, _EXTENSION_GEOMETRY = 13, 15, 18, 19, 33
_PROPERTIES = {28, 29, 32}
_TABLES = {START, *range(3, 13), 30, 31}
_ENDS_OF_A_CELL = {_CELL_BY_NUMBER, CELL, *_TABLES}

_REMEDY = "the file is damaged or not OASIS: write or export it again"
_LARGEST_BLOCK = 1 << 31
#: Bytes of the file after which its pages are given back.
_RELEASED = 1 << 26
#: Estimated processor time of a record in Python, s, by its kind: cells and blocks take the longest.
_SECONDS_OF_A_RECORD = {
    _XYABSOLUTE: 2e-6, XYRELATIVE: 2e-6, 28: 5e-6, 29: 2.2e-6, 32: 5e-6, _TEXT: 4.5e-6, PLACEMENT: 5e-6,
    _CELL_BY_NUMBER: 2.5e-5, CELL: 2.5e-5, CBLOCK: 4e-5, **dict.fromkeys(_TABLES, 4e-6),
}  # fmt: skip
_SECONDS_OF_A_SHAPE = 1.2e-5
#: Estimated additional time of a repetition, s.
_SECONDS_OF_A_REPETITION = 6e-6
#: Estimated additional time of a run of placements, s.
_SECONDS_OF_A_REFERENCE = 1e-5
#: Estimated additional time of a shape that is compared with the pillars, s.
_SECONDS_OF_A_PILLAR = 4e-5
#: Estimated processor time, s, of a compiled run, and of each rectangle in it.
_SECONDS_OF_A_RUN, _SECONDS_OF_A_RECTANGLE = 8e-6, 5e-9
_LARGEST_RATIO = 1032  # Deflate needs at least two bits for 258 bytes.


class MixedBlockError(Exception):
    """A block that was assumed to hold only pillars, at most one a byte, holds something else, or must be counted."""


class OasisReader:
    """The cells of an OASIS file.

    Args:
        path: the file.
        layer: (layer, first datatype, last datatype) of the wanted shapes.
        progress: callback with the number of indexed bytes.
        known: distinguishes pillars from other shapes.
        skip_blocks: whether the index may skip blocks that begin with a rectangle, or with a polygon if pillars are
            polygons.
        budget: what all passes may take; by default that of a lens of 1.4 mm.

    Attributes:
        cells: cells by name.
        unit_nm: size of a database unit.
        is_counted: whether the numbers of shapes are exact: no block was skipped.

    Raises:
        InputError: the file is truncated, damaged or foreign.
    """

    def __init__(
        self,
        path: Path,
        layer: tuple[int, int, int],
        progress: Progress = silent,
        *,
        known: KnownShapes = RECTANGLES,
        skip_blocks: bool = True,
        budget: Budget | None = None,
    ) -> None:
        self.budget = budget or Budget(path)
        self.skip_blocks = skip_blocks
        self.is_counted = True
        self.known = known
        self.pillar_kind = RECTANGLE if known.are_rectangles else POLYGON
        self.layer = layer
        self.progress = progress
        with path.open("rb") as stream:
            # The mapping outlives the stream; arrays over it keep it open.
            self.data = np.frombuffer(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ), dtype=np.uint8)
        self.unit_nm = 0.0
        self.cells: dict[str, Cell] = {}
        self.names: dict[int, str] = {}
        self._path = path
        self._passed = 0
        try:
            self._check_end()
            for _ in _Pass(self, None):
                pass
        except DamagedError as error:
            raise self._damaged(str(error)) from error
        self._resolve_names()
        if not self.unit_nm:
            raise self._damaged("no START record")

    def _check_end(self) -> None:
        """Check the beginning, the END record and the checksum."""
        if self.data[: len(MAGIC)].tobytes() != MAGIC:
            raise DamagedError("another beginning than %SEMI-OASIS")
        last = self.data[-END_BYTES:]
        if self.data.size < len(MAGIC) + END_BYTES or last[0] != END:
            raise DamagedError("no END record in the last 256 bytes: the file is truncated")
        # Validation scheme 1: a CRC-32 over all bytes before it ends the file.
        if last[-5] == 1:
            (stated,), found = struct.unpack("<I", last[-4:].tobytes()), 0
            for start in range(0, self.data.size - 4, _RELEASED):
                found = zlib.crc32(self.data[start : min(start + _RELEASED, self.data.size - 4)].data, found)
                release(self.data)
            if found != stated:
                raise DamagedError("content that does not fit its checksum")

    def _resolve_names(self) -> None:
        """Replace the numbers of cells and references by names."""

        def name(key: str) -> str:
            """Name of a cell, if ``key`` is a number in the name tables."""
            return self.names.get(int(key[1:]), key) if key.startswith("#") else key

        self.cells = {name(key): cell for key, cell in self.cells.items()}
        for cell in self.cells.values():
            cell.references = [Reference(name(r.cell), r.orientation, r.count, r.offsets) for r in cell.references]

    def shapes_at(self, place: tuple[int | None, int]) -> Iterator[Chunk]:
        """Yield the shapes of the cell whose records begin at ``place`` (position of the CBLOCK or None, position)."""
        try:
            yield from _Pass(self, place)
        except DamagedError as error:
            raise self._damaged(str(error)) from error

    def passed(self, byte_count: int) -> None:
        """Count bytes of the file that have been read, and give its pages back every :data:`_RELEASED` bytes."""
        self._passed += byte_count
        if self._passed >= _RELEASED:
            self._passed = 0
            release(self.data)

    def _damaged(self, got: str) -> InputError:
        return InputError.single(str(self._path), "file", "a whole OASIS file", got, _REMEDY)


class _Pass:
    """One pass over the records: over the whole file for the index, or over one cell for its shapes."""

    def __init__(self, reader: OasisReader, place: tuple[int | None, int] | None) -> None:
        self._reader = reader
        self._indexing = place is None
        self._pillars_only = False
        self._block_at: int | None = None
        self._outer: Stream | None = None
        self._stream = Stream(reader.data, len(MAGIC), reader.budget.inflate)
        self._modal = Modal()
        self._cell: Cell | None = None if place is None else Cell()
        self._implicit_names = 0
        self._rectangles: list[IntArray] = []
        self._others: dict[str, list[IntArray]] = {}
        self._collected = 0  # shapes in both
        self._unplaced: Iterator[None] = iter(())  # places the copies of the last shape, a block at a time
        #: Cell, orientation, and x and y of the placements that are not yet among the references.
        self._placed: tuple[str, Orientation | None, array[int]] | None = None
        self._passed = self._stream.position
        if place is not None:
            block, position = place
            self._passed = position if block is None else block
            if block is not None:
                self._stream = Stream(reader.data, block + 1, reader.budget.inflate)
                self._enter_block()
            self._stream.position = position

    def __iter__(self) -> Iterator[Chunk]:
        while True:
            if self._stream.exhausted:
                if self._outer is None:
                    raise DamagedError("the data end without an END record")
                self._stream, self._outer, self._block_at = self._outer, None, None
                self._pillars_only = False
                continue
            kind = int(self._stream.data[self._stream.position])
            if kind == RECTANGLE == self._reader.pillar_kind and self._run_of_rectangles():
                yield from self._flush(1)
                continue
            self._stream.position += 1
            if kind == END or not self._record(kind):
                break
            for _ in self._unplaced:
                yield from self._flush(LARGEST_CHUNK)
        self._add_reference()
        yield from self._flush(1)

    def _flush(self, at_least: int) -> Iterator[Chunk]:
        """Yield the collected shapes if there are enough of them."""
        self._count_bytes()
        if self._indexing or self._collected < at_least:
            return
        rectangles = self._rectangles or [np.empty((0, 4), dtype=np.int64)]
        boxes = {name: np.concatenate(parts) for name, parts in self._others.items()}
        others = tuple(Other(name, all_of_them, len(all_of_them)) for name, all_of_them in boxes.items())
        yield Chunk(np.concatenate(rectangles) if len(rectangles) > 1 else rectangles[0], others)
        self._rectangles, self._others, self._collected = [], {}, 0

    def _count_bytes(self) -> None:
        """Count the bytes of the file that were read since the last call."""
        position = (self._outer or self._stream).position
        self._reader.passed(position - self._passed)
        self._passed = position

    def _record(self, kind: int) -> bool:
        """Read one record; return False when the cell of this pass ends."""
        stream = self._stream
        if kind == 0:
            stream.skip_padding()
            return True
        self._reader.budget.work(_SECONDS_OF_A_RECORD.get(kind, _SECONDS_OF_A_SHAPE))
        if self._pillars_only and kind not in SHAPES:
            raise MixedBlockError
        if kind in _ENDS_OF_A_CELL and not self._indexing:
            return False
        if kind in {_CELL_BY_NUMBER, CELL}:
            self._begin_cell(stream.string() if kind == CELL else f"#{stream.unsigned()}")
        elif kind in {_XYABSOLUTE, XYRELATIVE}:
            self._modal.relative = kind == XYRELATIVE
        elif kind in {PLACEMENT, _PLACEMENT_TURNED}:
            self._placement(kind)
        elif kind == _TEXT:
            self._text()
        elif kind in SHAPES:
            self._geometry(kind)
        elif kind == CBLOCK:
            self._enter_block()
        elif kind in _PROPERTIES:
            stream.skip_property(kind)
        elif kind in _TABLES:
            self._add_reference()
            self._cell = None
            self._start() if kind == START else self._name(kind)
        else:
            raise DamagedError(f"a record of type {kind}")
        return True

    def _enter_block(self) -> None:
        """Inflate a CBLOCK and continue in it; the index skips blocks of pillars."""
        stream = self._stream
        if self._outer is not None:
            raise DamagedError("a CBLOCK inside a CBLOCK")
        self._block_at = stream.position - 1
        if stream.unsigned() != 0:
            raise DamagedError("a CBLOCK of unknown compression")
        size, packed = stream.unsigned(), stream.unsigned()
        if size > min(_LARGEST_BLOCK, _LARGEST_RATIO * packed):
            raise DamagedError(f"a CBLOCK of {size} bytes in {packed}")
        content = stream.bytes(packed)
        self._count_bytes()
        try:
            first = zlib.decompressobj(-15).decompress(content[:1024], 1)
            self._pillars_only = first == bytes([self._reader.pillar_kind]) and self._reader.skip_blocks
            if self._pillars_only and self._indexing and self._cell is not None:
                # An upper bound: a pillar of a list takes at least one byte, and the pass over the cell tests it.
                self._cell.shape_count += size
                self._reader.is_counted = False
                self._pillars_only = False
                return
            self._reader.budget.inflate(size)
            data = deflate_decompress(content, size)
        except (zlib.error, DeflateError) as error:
            raise DamagedError(f"a CBLOCK that cannot be inflated ({error})") from error
        if len(data) != size:
            raise DamagedError("a CBLOCK of another length than stated")
        self._outer, self._stream = stream, Stream(np.frombuffer(data, dtype=np.uint8), 0, stream.spend)

    def _begin_cell(self, key: str) -> None:
        reader = self._reader
        self._add_reference()
        if key in reader.cells:
            raise DamagedError(f"two cells of the name {key!r}")
        cell = Cell()
        place = (self._block_at if self._outer is not None else None, self._stream.position)
        cell.shapes = lambda: reader.shapes_at(place)
        reader.cells[key] = cell
        self._cell, self._modal = cell, Modal()
        position = self._stream.position if self._outer is None else self._outer.position
        reader.progress("indexing", position, reader.data.size)

    def _start(self) -> None:
        """Read the START record: version, unit, and offsets of the tables, which are not needed."""
        stream = self._stream
        stream.string()
        per_um = stream.real()
        if not 1e-3 < per_um < 1e9:
            raise DamagedError(f"{per_um} grid steps per micrometre")
        self._reader.unit_nm = 1e3 / per_um
        if stream.unsigned() == 0:
            for _ in range(12):
                stream.unsigned()

    def _name(self, kind: int) -> None:
        """Read an entry of the name tables; only cell names (3, 4) are kept."""
        stream, names = self._stream, self._reader.names
        if kind in {30, 31}:
            stream.unsigned()
        name = stream.string()
        if kind == 3:
            names[self._implicit_names] = name
            self._implicit_names += 1
        elif kind == 4:
            names[stream.unsigned()] = name
        elif kind in {6, 8, 10, 31}:
            stream.unsigned()
        elif kind in {11, 12}:
            for _ in range(2):
                for _ in range({0: 0, 1: 1, 2: 1, 3: 1, 4: 2}.get(stream.unsigned(), 0)):
                    stream.unsigned()

    def _inside(self) -> Cell:
        """The current cell."""
        if self._cell is None:
            raise DamagedError("shapes outside cells")
        return self._cell

    def _placement(self, kind: int) -> None:
        stream, modal, cell = self._stream, self._modal, self._inside()
        info = stream.byte()
        if info & 0b1000_0000:
            modal.cell = f"#{stream.unsigned()}" if info & 0b0100_0000 else stream.string()
        if modal.cell is None:
            raise DamagedError("a placement of no cell")
        quarters: float = info >> 1 & 3
        magnified = False
        if kind == _PLACEMENT_TURNED:
            magnified = bool(info & 0b100) and stream.real() != 1.0
            quarters = stream.real() / 90.0 if info & 0b10 else 0.0
        modal.placement = modal.read_position(stream, modal.placement, bool(info & 0b10_0000), bool(info & 0b1_0000))
        if not math.isfinite(quarters):
            raise DamagedError(f"a placement that is turned by {90.0 * quarters} degrees")
        copies = self._repetition(bool(info & 0b1000))
        if not self._indexing:
            return
        exact = not magnified and abs(quarters - round(quarters)) < 1e-9
        orientation = Orientation(bool(info & 1), round(quarters) % 4) if exact else None
        if self._placed is None or copies.count > 1 or (modal.cell, orientation) != self._placed[:2]:
            self._add_reference()
            self._placed = modal.cell, orientation, array("q")
        if copies.count == 1:
            self._placed[2].extend(modal.placement)
            return
        self._reader.budget.work(_SECONDS_OF_A_REFERENCE)
        origin, self._placed = np.array(modal.placement, dtype=np.int64), None
        cell.references.append(
            Reference(modal.cell, orientation, copies.count, lambda: (block + origin for block in copies.blocks()))
        )

    def _add_reference(self) -> None:
        """Add the single placements of one cell that stand next to each other in the file as one reference."""
        if self._placed is None or self._cell is None:
            return
        self._reader.budget.work(_SECONDS_OF_A_REFERENCE)
        name, orientation, origins = self._placed
        offsets = np.frombuffer(origins, dtype=np.int64).reshape(-1, 2)
        self._cell.references.append(Reference(name, orientation, len(offsets), lambda: iter((offsets,))))
        self._placed = None

    def _text(self) -> None:
        stream, modal, cell = self._stream, self._modal, self._inside()
        info = stream.byte()
        if info & 0b0100_0000:
            if info & 0b0010_0000:
                stream.unsigned()
            else:
                stream.string()
        layer, kind = modal.text_layer
        layer = stream.unsigned() if info & 1 else layer
        modal.text_layer = (layer, stream.unsigned() if info & 2 else kind)
        modal.text = modal.read_position(stream, modal.text, bool(info & 0b1_0000), bool(info & 0b1000))
        count = self._repetition(bool(info & 0b100)).count
        cell.other_layers["{}/{} text".format(*modal.text_layer)] += count

    def _geometry(self, kind: int) -> None:
        stream, modal, cell, start = self._stream, self._modal, self._inside(), self._stream.position
        info = stream.byte()
        if kind == _EXTENSION_GEOMETRY:
            stream.unsigned()
        modal.layer = stream.unsigned() if info & 1 else modal.layer
        modal.datatype = stream.unsigned() if info & 2 else modal.datatype
        shape, name = read_shape(kind, info, stream, modal)
        modal.geometry = modal.read_position(stream, modal.geometry, bool(info & 0b1_0000), bool(info & 0b1000))
        copies = self._repetition(bool(info & 0b100))
        if self._pillars_only and copies.count > stream.position - start:
            raise MixedBlockError
        wanted, first, last = self._reader.layer
        if modal.layer != wanted or not first <= modal.datatype <= last:
            if self._pillars_only:
                raise MixedBlockError
            cell.other_layers[f"{modal.layer}/{modal.datatype}"] += copies.count
            return
        cell.shape_count += copies.count
        if self._indexing:
            return
        self._reader.budget.work(_SECONDS_OF_A_PILLAR)
        self._unplaced = self._copied(shape, name, np.concatenate([modal.geometry, [0, 0]]), copies)

    def _copied(self, shape: IntArray, name: str, origin: IntArray, copies: Copies) -> Iterator[None]:
        """Collect all copies of a shape, and pause after each block of them."""
        rectangle = self._reader.known(shape, self._reader.unit_nm) if name != "circle" else None
        box = (box_of(shape) if rectangle is None else rectangle) + origin
        for offsets in copies.blocks():
            boxes = np.concatenate([box[:2] + offsets, np.broadcast_to(box[2:], (len(offsets), 2))], axis=1)
            self._collected += len(boxes)
            if rectangle is None:
                self._others.setdefault(name, []).append(boxes)
            else:
                self._rectangles.append(boxes)
            yield

    def _repetition(self, is_stated: bool) -> Copies:
        """The places of a record that may state a repetition."""
        if is_stated:
            self._reader.budget.work(_SECONDS_OF_A_REPETITION)
        return self._modal.read_repetition(self._stream, is_stated)

    def _run_of_rectangles(self) -> bool:
        """Parse rectangles as far as the compiled loop goes; return False if it cannot read the first."""
        stream, modal, cell = self._stream, self._modal, self._inside()
        self._reader.budget.work(_SECONDS_OF_A_RUN)
        position = [modal.layer, modal.datatype, *modal.geometry]
        state = np.array([*position, modal.width, modal.height, -1, modal.relative], dtype=np.int64)
        capacity = LARGEST_CHUNK if self._indexing else RUN
        out = np.empty((0 if self._indexing else capacity, 4), dtype=np.int64)
        end, count = read_rectangles(stream.data, stream.position, state, self._reader.layer, out, capacity)
        if end == stream.position:
            return False
        if self._pillars_only and count > end - stream.position:
            raise MixedBlockError
        stream.position = int(end)
        modal.layer, modal.datatype, x, y, modal.width, modal.height, repetition, _ = state.tolist()
        modal.geometry = (x, y)
        if repetition >= 0:
            modal.unread = Stream(stream.data, repetition, stream.spend)
        cell.shape_count += count
        self._reader.budget.work(_SECONDS_OF_A_RECTANGLE * int(count))
        if not self._indexing:
            # A short run gives back what it did not fill: a view would keep all of it.
            self._rectangles.append(out[:count] if 2 * count > capacity else out[:count].copy())
            self._collected += int(count)
        return True
