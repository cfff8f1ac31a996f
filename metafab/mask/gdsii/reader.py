"""GDSII (Stream format) -> cells, exactly and fast.

Elements that follow one another and differ in nothing but their coordinates (the boundaries of a tile, the
references to one cell) form a run: the first is parsed record by record, the others by comparing whole blocks of
the file. So a file of 25 million boundaries costs little more than reading it twice, in windows of a few MB.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.mask.gdsii.rectangles import rectangles_of
from metafab.mask.gdsii.window import REMEDY, WINDOW, Window
from metafab.mask.shapes.hierarchy import Cell, Chunk, IntArray, Orientation, Other, Reference, box_of
from metafab.mask.shapes.known import RECTANGLES, KnownShapes

_HEADER, _UNITS, _ENDLIB, _BGNSTR, _STRNAME, _ENDSTR = 0x0002, 0x0305, 0x0400, 0x0502, 0x0606, 0x0700
_BOUNDARY, _PATH, _SREF, _AREF, _TEXT, _NODE, _BOX = 0x0800, 0x0900, 0x0A00, 0x0B00, 0x0C00, 0x1500, 0x2D00
_LAYER, _XY, _ENDEL, _SNAME, _COLROW = 0x0D02, 0x1003, 0x1100, 0x1206, 0x1302
_WIDTH, _STRANS, _MAG, _ANGLE, _PATHTYPE = 0x0F03, 0x1A01, 0x1B05, 0x1C05, 0x2102
_DATATYPES = {0x0E02, 0x1602, 0x2A02, 0x2E02}
_PROPERTIES = {0x2B02, 0x2C06}
# All that may stand in an element: also flags, extensions of paths, and the presentation and string of texts.
_IN_ELEMENTS = {_LAYER, _XY, _SNAME, _COLROW, _WIDTH, _STRANS, _MAG, _ANGLE, _PATHTYPE, *_DATATYPES, *_PROPERTIES}
_IN_ELEMENTS |= {0x2601, 0x2F03, 0x3003, 0x3103, 0x1701, 0x1906}
# All that may stand between them.
_BETWEEN = {_HEADER, _UNITS, _ENDLIB, _BGNSTR, _STRNAME, _ENDSTR, 0x0102, 0x0206, 0x1F06, 0x2006, 0x2202, 0x2306}
_BETWEEN |= {0x3202, 0x3302, 0x3401, 0x3602, 0x3706, 0x3800, 0x3902, 0x3A06, 0x3B02}
_ELEMENTS = {_BOUNDARY: "polygon", _PATH: "path", _TEXT: "text", _NODE: "node", _BOX: "box"}


@dataclass(frozen=True)
class _Run:
    """Elements that differ in their coordinates only.

    Attributes:
        start: file offset of the first.
        count: how many.
        stride: bytes of one.
        xy: offset of the coordinates in an element, and their number of words.
    """

    start: int
    count: int
    stride: int
    xy: tuple[int, int]


class GdsiiReader:
    """The cells of a GDSII file.

    Args:
        path: the file.
        layer: (layer, first datatype, last datatype) whose shapes are wanted.
        progress: told about bytes indexed.
        known: tells pillars from other shapes.

    Attributes:
        cells: by name.
        unit_nm: size of a database unit.

    Raises:
        InputError: the file is truncated, damaged or foreign.
    """

    def __init__(
        self, path: Path, layer: tuple[int, int, int], progress: Progress = silent, *, known: KnownShapes = RECTANGLES
    ) -> None:
        self._path = path
        self._known = known
        self._layer = layer
        self.unit_nm = 0.0
        self.cells: dict[str, Cell] = {}
        self._size = path.stat().st_size
        with path.open("rb", buffering=0) as stream:
            self._index(Window(stream, self._size, str(path)), progress)

    def _index(self, window: Window, progress: Progress) -> None:
        position, cell, runs = 0, None, list[_Run]()
        kind = 0
        while kind != _ENDLIB:
            kind, data, following = window.record(position)
            if position == 0 and kind != _HEADER:
                raise self._fault("a GDSII header", f"a record of type {kind:#06x}")
            if kind == _UNITS:
                self.unit_nm = float(f"{_real(data[8:16]) * 1e9:.12g}")  # reals of 56 bits are only nearly decimal
                if not 0.0 < self.unit_nm < 1e6:
                    raise self._fault("a database unit", f"{self.unit_nm} nm")
            elif kind == _STRNAME:
                name = data.rstrip(b"\0").decode("latin-1")
                if name in self.cells:
                    raise self._fault("cells of different names", f"two of the name {name!r}")
                cell, runs = Cell(), []
                self.cells[name] = cell
                # Bound now: `runs` is another list in the next cell.
                cell.shapes = lambda runs=runs: self._shapes(runs)  # type: ignore[misc]
            elif kind in _ELEMENTS or kind in {_SREF, _AREF}:
                if cell is None:
                    raise self._fault("elements inside structures", f"one at byte {position}")
                following = self._element(window, position, kind, cell, runs)
            elif kind not in _BETWEEN:
                raise self._fault("records of GDSII where they belong", f"one of type {kind:#06x} at byte {position}")
            elif cell is not None and kind != _ENDSTR:
                raise self._fault("structures that end", f"one without an end before byte {position}")
            elif kind == _ENDSTR:
                cell = None
                progress("indexing", position, self._size)
            position = following
        if not self.unit_nm:
            raise self._fault("a database unit", "a library without UNITS")

    def _element(self, window: Window, start: int, kind: int, cell: Cell, runs: list[_Run]) -> int:
        """Take in the element at ``start`` and all that follow it and differ in coordinates only."""
        fields: dict[int, bytes] = {}
        position, xy = start, (0, 0)
        record = kind
        while record != _ENDEL:
            record, data, following = window.record(position)
            if record == _XY:
                xy = (position + 4 - start, len(data) // 4)
            elif record in {kind, _ENDEL}:
                if data or (record == kind) != (position == start):
                    raise self._fault("elements that begin and end", f"another at byte {start}")
            elif record not in _IN_ELEMENTS:
                raise self._fault("elements that end", f"one at byte {start} that holds a record of type {record:#06x}")
            if record in fields and record not in _PROPERTIES:
                raise self._fault("each record once in an element", f"{record:#06x} twice at byte {start}")
            fields[record] = data
            position = following
        if xy[1] == 0 or xy[1] % 2 or len(fields[_XY]) % 8:
            raise self._fault("elements with coordinates", f"one without at byte {start}")
        run = _Run(start, window.repeats(start, position - start, xy), position - start, xy)
        if kind in {_SREF, _AREF}:
            cell.references.append(self._reference(kind, fields, run))
        else:
            if len(fields.get(_LAYER, b"")) != 2 or not fields.keys() & _DATATYPES:
                raise self._fault("elements with layer and datatype", f"one without at byte {start}")
            layer = _short(fields, {_LAYER}), _short(fields, _DATATYPES)
            wanted, first, last = self._layer
            if layer[0] == wanted and first <= layer[1] <= last and kind != _TEXT:
                cell.shape_count += run.count
                runs.append(run)
            else:
                cell.other_layers[f"{layer[0]}/{layer[1]}" + (" text" if kind == _TEXT else "")] += run.count
        return run.start + run.count * run.stride

    def _reference(self, kind: int, fields: dict[int, bytes], run: _Run) -> Reference:
        if _SNAME not in fields:
            raise self._fault("references with a name", f"one without at byte {run.start}")
        strans = int.from_bytes(fields.get(_STRANS, b"\0\0")[:2], "big")
        magnified = _MAG in fields and not math.isclose(_real(fields[_MAG]), 1.0, rel_tol=1e-12)
        quarters = _real(fields[_ANGLE]) / 90.0 if _ANGLE in fields else 0.0
        exact = not magnified and abs(quarters - round(quarters)) < 1e-9
        orientation = Orientation(bool(strans & 0x8000), round(quarters) % 4) if exact else None
        columns, rows = 1, 1
        if kind == _AREF:
            if len(fields.get(_COLROW, b"")) != 4 or run.xy[1] != 6:
                raise self._fault("arrays with columns, rows and three points", f"another at byte {run.start}")
            columns, rows = struct.unpack(">2h", fields[_COLROW])
            if columns < 1 or rows < 1:
                raise self._fault("arrays of at least one", f"{columns} x {rows} at byte {run.start}")

        def offsets() -> Iterator[IntArray]:
            """Origins of all placements, a window of the run at a time."""
            for points in self._coordinates(run):
                if kind == _SREF:
                    yield points[:, 0]
                    continue
                for origin, end_column, end_row in points:
                    step_column, rest_column = np.divmod(end_column - origin, columns)
                    step_row, rest_row = np.divmod(end_row - origin, rows)
                    if np.any(rest_column) or np.any(rest_row):
                        raise self._fault("arrays with whole steps", f"another at byte {run.start}")
                    grid = step_row * np.arange(rows)[:, None, None] + step_column * np.arange(columns)[:, None]
                    yield (origin + grid).reshape(-1, 2)

        name = fields[_SNAME].rstrip(b"\0").decode("latin-1")
        return Reference(name, orientation, run.count * rows * columns, offsets)

    def _blocks(self, run: _Run) -> Iterator[NDArray[np.uint8]]:
        """The elements of a run as bytes, shape (m, stride), a window at a time."""
        at_a_time = max(1, WINDOW // run.stride)
        with self._path.open("rb", buffering=0) as stream:
            stream.seek(run.start)
            for start in range(0, run.count, at_a_time):
                count = min(at_a_time, run.count - start)
                data = stream.read(count * run.stride)
                if len(data) < count * run.stride:
                    raise self._fault("a file that stays as it is", "one that shrank while it was read")
                yield np.frombuffer(data, dtype=np.uint8).reshape(count, run.stride)

    def _coordinates(self, run: _Run) -> Iterator[IntArray]:
        """Coordinates of the elements of a run, shape (m, n_points, 2)."""
        first, words = run.xy
        for block in self._blocks(run):
            points = np.ascontiguousarray(block[:, first : first + 4 * words]).view(">i4")
            yield points.reshape(len(block), words // 2, 2).astype(np.int64)

    def _shapes(self, runs: list[_Run]) -> Iterator[Chunk]:
        for run in runs:
            kind = int.from_bytes(self._bytes(run.start + 2, 2), "big")
            if kind not in {_BOUNDARY, _BOX} or run.xy[1] != 10 or not self._known.are_rectangles:
                for points in self._coordinates(run):
                    yield self._slow(kind, run, points)
                continue
            for block in self._blocks(run):
                rectangles, is_rectangle = rectangles_of(block, run.xy[0])
                if is_rectangle.all():
                    yield Chunk(rectangles)
                    continue
                others = (Other(_ELEMENTS[kind], box) for box in rectangles[~is_rectangle])
                yield Chunk(rectangles[is_rectangle], tuple(others))

    def _slow(self, kind: int, run: _Run, points: IntArray) -> Chunk:
        """Paths, and boundaries of any other number of corners, one by one."""
        if kind != _PATH:
            return self._polygons(kind, points)
        rectangles, others = [], []
        for corners in points:
            found = self._path_rectangle(run, corners) if self._known.are_rectangles else None
            if found is None:
                others.append(Other(_ELEMENTS[kind], box_of(corners)))
            else:
                rectangles.append(found)
        return Chunk(np.array(rectangles, dtype=np.int64).reshape(-1, 4), tuple(others))

    def _polygons(self, kind: int, points: IntArray) -> Chunk:
        """Closed rings, shape (n, n_points, 2): equal ones, wherever they stand, are judged once."""
        at = points[:, 0]
        shapes, which = np.unique((points - at[:, None]).reshape(len(points), -1), axis=0, return_inverse=True)
        corners = shapes.reshape(len(shapes), -1, 2)
        found = [self._known(ring, self.unit_nm) for ring in corners]
        boxes = np.array([box_of(ring) if box is None else box for ring, box in zip(corners, found, strict=True)])
        is_pillar = np.array([box is not None for box in found])[which]
        placed = boxes[which] + np.concatenate([at, np.zeros_like(at)], axis=1)
        return Chunk(placed[is_pillar], tuple(Other(_ELEMENTS[kind], box) for box in placed[~is_pillar]))

    def _path_rectangle(self, run: _Run, points: IntArray) -> IntArray | None:
        """A straight path along x or y with flush or half-width ends, as a rectangle."""
        fields, position = {}, 0
        element = self._bytes(run.start, run.stride)
        while position < run.stride:
            length, kind = struct.unpack_from(">HH", element, position)
            fields[kind] = element[position + 4 : position + length]
            position += length
        width = int.from_bytes(fields.get(_WIDTH, b"")[:4], "big", signed=True)
        ends = int.from_bytes(fields.get(_PATHTYPE, b"")[:2], "big")
        step = points[-1] - points[0]
        if len(points) != 2 or width <= 0 or width % 2 or ends not in {0, 2} or np.count_nonzero(step) != 1:
            return None
        across = np.where(step == 0, width // 2, width // 2 if ends == 2 else 0)
        low = points.min(axis=0) - across
        return np.concatenate([low, points.max(axis=0) + across - low])

    def _bytes(self, start: int, count: int) -> bytes:
        with self._path.open("rb") as stream:
            stream.seek(start)
            return stream.read(count)

    def _fault(self, expected: str, got: str) -> InputError:
        return InputError.single(str(self._path), "file", expected, got, REMEDY)


def _short(fields: dict[int, bytes], kinds: set[int]) -> int:
    return next((int.from_bytes(fields[kind][:2], "big", signed=True) for kind in kinds if kind in fields), 0)


def _real(data: bytes) -> float:
    """An 8-byte real: sign, exponent of 16 in excess 64, mantissa of 56 bits."""
    if len(data) != 8:
        return 0.0
    (word,) = struct.unpack(">Q", data)
    value = math.ldexp(word & (1 << 56) - 1, 4 * ((word >> 56 & 0x7F) - 64) - 56)
    return -value if word >> 63 else value
