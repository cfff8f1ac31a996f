"""OASIS (SEMI P39) -> cells, exactly and fast; every record of the standard is understood.

The file is parsed twice: once for cells, references and counts, and once, cell by cell, for the shapes. Runs of
RECTANGLE records, which hold nearly all of a mask, are parsed by a compiled loop; everything else in Python. The
first pass skips blocks that begin with a pillar, in the hope that they hold nothing but pillars; should the
second find anything else in one, it raises :class:`MixedBlockError` and the file is read again without skipping.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from deflate import DeflateError, deflate_decompress

from metafab.core.errors import InputError
from metafab.core.numeric.compiled import HAS_NUMBA
from metafab.core.parallel.progress import Progress, silent
from metafab.mask.oasis.records import POLYGON, RECTANGLE
from metafab.mask.oasis.rectangles import LARGEST_CHUNK, RUN, read_rectangles
from metafab.mask.oasis.shapes import SHAPES, Modal, read_shape
from metafab.mask.oasis.stream import DamagedError, Stream
from metafab.mask.oasis.writer import CBLOCK, END, MAGIC, PLACEMENT, START
from metafab.mask.shapes.hierarchy import Cell, Chunk, IntArray, Orientation, Other, Reference, box_of
from metafab.mask.shapes.known import RECTANGLES, KnownShapes

_REMEDY = "the file is damaged or not OASIS: write or export it again"
_END_BYTES = 256
_LARGEST_BLOCK = 1 << 31
_LARGEST_RATIO = 1032  # 258 bytes of two bits: no deflate data inflate to more
_ORIGIN = np.zeros((1, 2), dtype=np.int64)


class MixedBlockError(Exception):
    """A block that was taken for pillars holds something else."""


class OasisReader:
    """The cells of an OASIS file.

    Args:
        path: the file.
        layer: (layer, first datatype, last datatype) whose shapes are wanted.
        progress: told about bytes indexed.
        known: tells pillars from other shapes.
        skip_blocks: whether the index may skip blocks that begin with a rectangle, or with a polygon where these are
            pillars.

    Attributes:
        cells: by name.
        unit_nm: size of a database unit.

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
    ) -> None:
        self.skip_blocks = skip_blocks
        self.known = known
        self.pillar_kind = RECTANGLE if known.are_rectangles else POLYGON
        self._path = path
        self._layer = layer
        self._progress = progress
        with path.open("rb") as stream:
            # The mapping outlives the stream; arrays over it keep it open.
            self._data = np.frombuffer(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ), dtype=np.uint8)
        self.unit_nm = 0.0
        self.cells: dict[str, Cell] = {}
        self._names: dict[int, str] = {}
        try:
            self._check_end()
            for _ in _Pass(self, None):
                pass
        except DamagedError as error:
            raise self._fault(str(error)) from error
        self._resolve_names()
        if not self.unit_nm:
            raise self._fault("no START record")

    @property
    def layer(self) -> tuple[int, int, int]:
        """The wanted layer and its first and last datatype."""
        return self._layer

    def _check_end(self) -> None:
        if self._data[: len(MAGIC)].tobytes() != MAGIC:
            raise DamagedError("another beginning than %SEMI-OASIS")
        last = self._data[-_END_BYTES:]
        if self._data.size < len(MAGIC) + _END_BYTES or last[0] != END:
            raise DamagedError("no END record in the last 256 bytes: the file is truncated")
        # Validation scheme 1: a CRC-32 over everything before it closes the file.
        if last[-5] == 1:
            (stated,) = struct.unpack("<I", last[-4:].tobytes())
            if zlib.crc32(self._data[:-4].data) != stated:
                raise DamagedError("content that does not fit its checksum")

    def _resolve_names(self) -> None:
        """Cells and references by number get their names."""

        def name(key: str) -> str:
            """A cell's name, where ``key`` is a number that the tables know."""
            return self._names.get(int(key[1:]), key) if key.startswith("#") else key

        self.cells = {name(key): cell for key, cell in self.cells.items()}
        for cell in self.cells.values():
            cell.references = [Reference(name(r.cell), r.orientation, r.count, r.offsets) for r in cell.references]

    def shapes_at(self, place: tuple[int | None, int]) -> Iterator[Chunk]:
        """Shapes of the cell whose records begin at ``place`` (position of the CBLOCK or None, position)."""
        try:
            yield from _Pass(self, place)
        except DamagedError as error:
            raise self._fault(str(error)) from error

    def _fault(self, got: str) -> InputError:
        return InputError.single(str(self._path), "file", "a whole OASIS file", got, _REMEDY)


class _Pass:
    """One pass over the records: of the whole file for the index, or of one cell for its shapes."""

    def __init__(self, reader: OasisReader, place: tuple[int | None, int] | None) -> None:
        self._reader = reader
        self._indexing = place is None
        self._pillars_only = False
        self._block_at: int | None = None
        self._outer: Stream | None = None
        self._stream = Stream(reader._data, len(MAGIC))
        self._modal = Modal()
        self._cell: Cell | None = None if place is None else Cell()
        self._implicit_names = 0
        self._rectangles: list[IntArray] = []
        self._others: list[Other] = []
        if place is not None:
            block, position = place
            if block is not None:
                self._stream = Stream(reader._data, block + 1)
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
            if kind == RECTANGLE == self._reader.pillar_kind and HAS_NUMBA and self._run_of_rectangles():
                yield from self._flush(1)
                continue
            self._stream.position += 1
            if kind == END:
                break
            if not self._record(kind):
                break
            yield from self._flush(LARGEST_CHUNK)
        yield from self._flush(1)

    def _flush(self, at_least: int) -> Iterator[Chunk]:
        """Hand on what has gathered, once it is enough."""
        if self._indexing or sum(map(len, self._rectangles)) + len(self._others) < at_least:
            return
        rectangles = self._rectangles or [np.empty((0, 4), dtype=np.int64)]
        yield Chunk(np.concatenate(rectangles) if len(rectangles) > 1 else rectangles[0], tuple(self._others))
        self._rectangles, self._others = [], []

    # --- records ---------------------------------------------------------------------------------------------

    def _record(self, kind: int) -> bool:
        """Take in one record; False when the cell of this pass ends."""
        stream = self._stream
        if self._pillars_only and kind not in SHAPES:
            raise MixedBlockError
        if kind in {13, 14}:
            if not self._indexing:
                return False
            self._begin_cell(f"#{stream.unsigned()}" if kind == 13 else stream.string())
        elif kind in {15, 16}:
            self._modal.relative = kind == 16
        elif kind in {PLACEMENT, 18}:
            self._placement(kind)
        elif kind == 19:
            self._text()
        elif kind in SHAPES:
            self._geometry(kind)
        elif kind == CBLOCK:
            self._enter_block()
        elif kind in {28, 29, 32}:
            self._properties(kind)
        elif 1 <= kind <= 12 or kind in {30, 31}:
            if not self._indexing:
                return False
            self._cell = None
            self._table(kind)
        elif kind != 0:
            raise DamagedError(f"a record of type {kind}")
        return True

    def _enter_block(self) -> None:
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
        try:
            first = zlib.decompressobj(-15).decompress(content[:1024], 1)
            self._pillars_only = first == bytes([self._reader.pillar_kind]) and self._reader.skip_blocks
            if self._pillars_only and self._indexing and self._cell is not None:
                # A pillar takes at least one byte where it is one of a list.
                self._cell.shape_count += size
                self._pillars_only = False
                return
            data = deflate_decompress(content, size)
        except (zlib.error, DeflateError) as error:
            raise DamagedError(f"a CBLOCK that cannot be inflated ({error})") from error
        if len(data) != size:
            raise DamagedError("a CBLOCK of another length than it says")
        self._outer, self._stream = stream, Stream(np.frombuffer(data, dtype=np.uint8))

    def _begin_cell(self, key: str) -> None:
        reader = self._reader
        if key in reader.cells:
            raise DamagedError(f"two cells of the name {key!r}")
        cell = Cell()
        place = (self._block_at if self._outer is not None else None, self._stream.position)
        cell.shapes = lambda: reader.shapes_at(place)
        reader.cells[key] = cell
        self._cell, self._modal = cell, Modal()
        position = self._stream.position if self._outer is None else self._outer.position
        reader._progress("indexing", position, reader._data.size)

    def _table(self, kind: int) -> None:
        """START and the name tables; only cell names matter."""
        stream, reader = self._stream, self._reader
        if kind == START:
            stream.string()
            per_um = stream.real()
            if not 0.0 < per_um < 1e9:
                raise DamagedError(f"{per_um} grid steps a micrometre")
            reader.unit_nm = 1e3 / per_um
            if stream.unsigned() == 0:
                for _ in range(12):
                    stream.unsigned()
            return
        if kind in {30, 31}:
            stream.unsigned()
        name = stream.string()
        if kind == 3:
            reader._names[self._implicit_names] = name
            self._implicit_names += 1
        elif kind == 4:
            reader._names[stream.unsigned()] = name
        elif kind in {6, 8, 10, 31}:
            stream.unsigned()
        elif kind in {11, 12}:
            for _ in range(2):
                for _ in range({0: 0, 1: 1, 2: 1, 3: 1, 4: 2}.get(stream.unsigned(), 0)):
                    stream.unsigned()

    def _properties(self, kind: int) -> None:
        """Skip a property or an extension element."""
        stream = self._stream
        if kind == 29:
            return
        if kind == 32:
            stream.unsigned()
            stream.string()
            return
        info = stream.byte()
        if info & 0b100:
            if info & 0b10:
                stream.unsigned()
            else:
                stream.string()
        if info & 0b1000:
            return
        count = info >> 4
        for _ in range(stream.unsigned() if count == 15 else count):
            value = stream.unsigned()
            if value < 8:
                stream.real(value)
            elif value in {10, 11, 12}:
                stream.string()
            else:
                stream.unsigned()

    # --- contents of a cell ----------------------------------------------------------------------------------

    def _inside(self) -> Cell:
        if self._cell is None:
            raise DamagedError("shapes outside cells")
        return self._cell

    def _place(self, info: int, last: tuple[int, int], bits: tuple[int, int]) -> tuple[int, int]:
        values = list(last)
        for axis, bit in enumerate(bits):
            if info & bit:
                value = self._stream.signed()
                values[axis] = values[axis] + value if self._modal.relative else value
        return values[0], values[1]

    def _repetition(self, present: bool) -> IntArray:
        modal = self._modal
        if not present:
            return _ORIGIN
        if modal.unread is not None:
            data, position = modal.unread
            modal.repetition, modal.unread = Stream(data, position).repetition(None), None
        modal.repetition = self._stream.repetition(modal.repetition)
        return modal.repetition

    def _placement(self, kind: int) -> None:
        stream, modal, cell = self._stream, self._modal, self._inside()
        info = stream.byte()
        if info & 0b1000_0000:
            modal.cell = f"#{stream.unsigned()}" if info & 0b0100_0000 else stream.string()
        if modal.cell is None:
            raise DamagedError("a placement of no cell")
        quarters: float = info >> 1 & 3
        magnified = False
        if kind == 18:
            magnified = bool(info & 0b100) and stream.real() != 1.0
            quarters = stream.real() / 90.0 if info & 0b10 else 0.0
        modal.placement = self._place(info, modal.placement, (0b10_0000, 0b1_0000))
        offsets = self._repetition(bool(info & 0b1000)) + np.array(modal.placement, dtype=np.int64)
        if not self._indexing:
            return
        exact = not magnified and abs(quarters - round(quarters)) < 1e-9
        orientation = Orientation(bool(info & 1), round(quarters) % 4) if exact else None
        cell.references.append(Reference(modal.cell, orientation, len(offsets), lambda: iter((offsets,))))

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
        modal.text = self._place(info, modal.text, (0b1_0000, 0b1000))
        count = len(self._repetition(bool(info & 0b100)))
        cell.other_layers["{}/{} text".format(*modal.text_layer)] += count

    def _geometry(self, kind: int) -> None:
        stream, modal, cell = self._stream, self._modal, self._inside()
        info = stream.byte()
        if kind == 33:
            stream.unsigned()
        modal.layer = stream.unsigned() if info & 1 else modal.layer
        modal.datatype = stream.unsigned() if info & 2 else modal.datatype
        shape, name = read_shape(kind, info, stream, modal)
        modal.geometry = self._place(info, modal.geometry, (0b1_0000, 0b1000))
        offsets = self._repetition(bool(info & 0b100))
        wanted, first, last = self._reader.layer
        if modal.layer != wanted or not first <= modal.datatype <= last:
            if self._pillars_only:
                raise MixedBlockError
            cell.other_layers[f"{modal.layer}/{modal.datatype}"] += len(offsets)
            return
        cell.shape_count += len(offsets)
        if self._indexing:
            return
        origin = np.concatenate([modal.geometry, [0, 0]])
        rectangle = self._reader.known(shape, self._reader.unit_nm) if name != "circle" else None
        box = (box_of(shape) if rectangle is None else rectangle) + origin
        boxes = np.concatenate([box[:2] + offsets, np.broadcast_to(box[2:], (len(offsets), 2))], axis=1)
        if rectangle is None:
            self._others += [Other(name, one) for one in boxes]
        else:
            self._rectangles.append(boxes)

    def _run_of_rectangles(self) -> bool:
        """Parse rectangles as far as the compiled loop goes; False if it cannot take the first."""
        stream, modal, cell = self._stream, self._modal, self._inside()
        state = np.array(
            [modal.layer, modal.datatype, *modal.geometry, modal.width, modal.height, -1, modal.relative],
            dtype=np.int64,
        )
        capacity = LARGEST_CHUNK if self._indexing else RUN
        out = np.empty((0 if self._indexing else capacity, 4), dtype=np.int64)
        end, count = read_rectangles(stream.data, stream.position, state, self._reader.layer, out, capacity)
        if end == stream.position:
            return False
        stream.position = int(end)
        modal.layer, modal.datatype, x, y, modal.width, modal.height, repetition, _ = state.tolist()
        modal.geometry = (x, y)
        if repetition >= 0:
            modal.unread = (stream.data, repetition)
        cell.shape_count += count
        if not self._indexing:
            self._rectangles.append(out[:count])
        return True
