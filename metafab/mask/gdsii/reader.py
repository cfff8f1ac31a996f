"""GDSII -> cells, exactly and fast.

Consecutive elements that differ only in their coordinates (the boundaries of a tile, the references to one cell) form a
run. The first element of a run is parsed record by record, the others by comparing whole blocks of the file. A file of
25 million boundaries therefore costs little more than reading it twice, in windows of a few MB.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.mask.budget import Budget
from metafab.mask.gdsii import records
from metafab.mask.gdsii.records import read_real
from metafab.mask.gdsii.runs import WINDOW, Window, damaged, read_into, rectangles_of
from metafab.mask.shapes.hierarchy import Cell, Chunk, IntArray, Orientation, Other, Reference
from metafab.mask.shapes.recover import RECTANGLES, KnownShapes

_SHAPES = {
    records.BOUNDARY: "polygon",
    records.PATH: "path",
    records.TEXT: "text",
    records.NODE: "node",
    records.BOX: "box",
}
#: Estimated processor time of a run of elements, s: of its index, and of its shapes.
_SECONDS_OF_A_RUN, _SECONDS_OF_SHAPES = 3e-5, 5e-5
#: Estimated processor time of an empty cell, s.
_SECONDS_OF_A_CELL = 2e-5
#: Estimated processor time, s, of a coordinate of a polygon, and of a distinct polygon.
_SECONDS_OF_A_COORDINATE, _SECONDS_OF_A_RING = 2e-8, 5e-6
#: Placements of an array that are expanded at a time.
_PLACEMENTS = 1 << 16
_REFERENCES = {records.SREF, records.AREF}


@dataclass(frozen=True)
class _Run:
    """Elements that differ only in their coordinates."""

    kind: int  #: Kind of the elements.
    start: int  #: File offset of the first element.
    count: int  #: Number of elements.
    stride: int  #: Bytes of one element.
    xy: tuple[int, int]  #: Offset of the coordinates in an element in bytes, and their number of words.
    width: int  #: Width of paths.
    path_type: int  #: Ends of paths: 0 flush, 2 extended by half the width.


class GdsiiReader:
    """The cells of a GDSII file.

    Args:
        path: the file.
        layer: (layer, first datatype, last datatype) of the wanted shapes.
        progress: callback with the number of indexed bytes.
        known: distinguishes pillars from other shapes.
        budget: processor time that elements may take; by default that of a lens of 1.4 mm.

    Attributes:
        cells: cells by name.
        unit_nm: size of a database unit.
        budget: what all passes may take.
        is_counted: whether the numbers of shapes are exact, which they are.

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
        budget: Budget | None = None,
    ) -> None:
        self.budget = budget or Budget(path)
        self.is_counted = True
        self._path = path
        self._known = known
        self.layer = layer
        self.unit_nm = 0.0
        self.cells: dict[str, Cell] = {}
        self._size = path.stat().st_size
        self._spare: list[bytearray] = []
        with path.open("rb", buffering=0) as stream:
            self._index(Window(stream, self._size, str(path)), progress)

    def _index(self, window: Window, progress: Progress) -> None:
        """Find all cells, their references and runs of shapes."""
        position, kind = 0, 0
        cell, runs = None, list[_Run]()
        while kind != records.ENDLIB:
            kind, data, following = window.record(position)
            if position == 0 and kind != records.HEADER:
                raise self._damaged("a GDSII header", f"a record of type {kind:#06x}")
            if kind == records.UNITS:
                self.unit_nm = float(f"{read_real(data[8:16]) * 1e9:.12g}")  # Reals of 56 bits are not decimal.
                if not 0.0 < self.unit_nm < 1e6:
                    raise self._damaged("a database unit", f"{self.unit_nm} nm")
            elif kind == records.STRNAME:
                self.budget.work(_SECONDS_OF_A_CELL)
                name = data.rstrip(b"\0").decode("latin-1")
                if name in self.cells:
                    raise self._damaged("cells of different names", f"two of the name {name!r}")
                cell, runs = Cell(), []
                self.cells[name] = cell
                # Bound now: `runs` is another list in the next cell.
                cell.shapes = lambda runs=runs: self._shapes(runs)  # type: ignore[misc]
            elif kind in _SHAPES or kind in _REFERENCES:
                if cell is None:
                    raise self._damaged("elements inside structures", f"one at byte {position}")
                following = self._element(window, position, kind, cell, runs)
            elif kind not in records.BETWEEN_ELEMENTS:
                raise self._damaged("records of GDSII where they belong", f"one of type {kind:#06x} at byte {position}")
            elif cell is not None and kind != records.ENDSTR:
                raise self._damaged("structures that end", f"one without an end before byte {position}")
            elif kind == records.ENDSTR:
                cell = None
                progress("indexing", position, self._size)
            position = following
        if not self.unit_nm:
            raise self._damaged("a database unit", "a library without UNITS")

    def _element(self, window: Window, start: int, kind: int, cell: Cell, runs: list[_Run]) -> int:
        """Add the run of elements that begins at ``start`` to a cell; return the position after the run."""
        self.budget.work(_SECONDS_OF_A_RUN)
        fields: dict[int, bytes] = {}
        position, xy = start, (0, 0)
        record = kind
        while record != records.ENDEL:
            record, data, following = window.record(position)
            if record == records.XY:
                xy = (position + 4 - start, len(data) // 4)
            elif record in {kind, records.ENDEL}:
                if data or (record == kind) != (position == start):
                    raise self._damaged("elements that begin and end", f"another at byte {start}")
            elif record not in records.IN_ELEMENTS:
                got = f"one at byte {start} that holds a record of type {record:#06x}"
                raise self._damaged("elements that end", got)
            if record in fields and record not in records.PROPERTIES:
                raise self._damaged("each record once in an element", f"{record:#06x} twice at byte {start}")
            fields[record] = data
            position = following
        if xy[1] == 0 or xy[1] % 2 or len(fields[records.XY]) % 8:
            raise self._damaged("elements with coordinates", f"one without at byte {start}")
        stride = position - start
        count = window.repeats(start, stride, xy)
        width = int.from_bytes(fields.get(records.WIDTH, b"")[:4], "big", signed=True)
        path_type = int.from_bytes(fields.get(records.PATHTYPE, b"")[:2], "big")
        run = _Run(kind, start, count, stride, xy, width, path_type)
        if kind in _REFERENCES:
            cell.references.append(self._reference(fields, run))
        else:
            if len(fields.get(records.LAYER, b"")) != 2 or not fields.keys() & records.DATATYPES:
                raise self._damaged("elements with layer and datatype", f"one without at byte {start}")
            layer = int.from_bytes(fields[records.LAYER], "big", signed=True)
            kinds = (fields[kind] for kind in records.DATATYPES if kind in fields)
            datatype = int.from_bytes(next(kinds)[:2], "big", signed=True)
            wanted, first, last = self.layer
            if layer == wanted and first <= datatype <= last and kind != records.TEXT:
                cell.shape_count += count
                runs.append(run)
            else:
                cell.other_layers[f"{layer}/{datatype}" + (" text" if kind == records.TEXT else "")] += count
        return start + count * stride

    def _reference(self, fields: dict[int, bytes], run: _Run) -> Reference:
        """The references of a run, whose first element has these records."""
        if records.SNAME not in fields:
            raise self._damaged("references with a name", f"one without at byte {run.start}")
        strans = int.from_bytes(fields.get(records.STRANS, b"\0\0")[:2], "big")
        magnified = records.MAG in fields and not math.isclose(read_real(fields[records.MAG]), 1.0, rel_tol=1e-12)
        quarters = read_real(fields[records.ANGLE]) / 90.0 if records.ANGLE in fields else 0.0
        exact = not magnified and abs(quarters - round(quarters)) < 1e-9
        orientation = Orientation(bool(strans & 0x8000), round(quarters) % 4) if exact else None
        columns, rows = 1, 1
        if run.kind == records.AREF:
            if len(fields.get(records.COLROW, b"")) != 4 or run.xy[1] != 6:
                raise self._damaged("arrays with columns, rows and three points", f"another at byte {run.start}")
            columns, rows = struct.unpack(">2h", fields[records.COLROW])
            if columns < 1 or rows < 1:
                raise self._damaged("arrays of at least one", f"{columns} x {rows} at byte {run.start}")

        def offsets() -> Iterator[IntArray]:
            """Origins of all placements, a window of the run at a time."""
            for points in self._coordinates(run):
                if run.kind == records.SREF:
                    yield points[:, 0]
                    continue
                for origin, end_column, end_row in points:
                    step_column, rest_column = np.divmod(end_column - origin, columns)
                    step_row, rest_row = np.divmod(end_row - origin, rows)
                    if np.any(rest_column) or np.any(rest_row):
                        raise self._damaged("arrays with whole steps", f"another at byte {run.start}")
                    along = step_column * np.arange(columns)[:, None]
                    block = max(1, _PLACEMENTS // columns)
                    for first in range(0, rows, block):
                        row = np.arange(first, min(first + block, rows))[:, None, None]
                        yield (origin + step_row * row + along).reshape(-1, 2)

        name = fields[records.SNAME].rstrip(b"\0").decode("latin-1")
        return Reference(name, orientation, run.count * rows * columns, offsets)

    def _blocks(self, run: _Run) -> Iterator[NDArray[np.uint8]]:
        """Bytes of the elements of a run, shape (m, stride), a window at a time; the next window overwrites them."""
        at_a_time = max(1, WINDOW // run.stride)
        buffer = self._buffer(at_a_time * run.stride)
        with self._path.open("rb", buffering=0) as stream:
            stream.seek(run.start)
            for start in range(0, run.count, at_a_time):
                count = min(at_a_time, run.count - start)
                data = read_into(memoryview(buffer)[: count * run.stride], stream)
                if len(data) < count * run.stride:
                    raise self._damaged("a file that stays as it is", "one that shrank while it was read")
                yield np.frombuffer(data, dtype=np.uint8).reshape(count, run.stride)
        self._spare.append(buffer)

    def _buffer(self, size: int) -> bytearray:
        """Memory of at least ``size`` bytes: that of a run already read, or fresh."""
        with suppress(IndexError):  # another thread may take the last one
            if len(buffer := self._spare.pop()) >= size:
                return buffer
        return bytearray(max(size, WINDOW))

    def _coordinates(self, run: _Run) -> Iterator[IntArray]:
        """Coordinates of the elements of a run, shape (m, n_points, 2), a window at a time."""
        first, words = run.xy
        for block in self._blocks(run):
            points = np.ascontiguousarray(block[:, first : first + 4 * words]).view(">i4")
            yield points.reshape(len(block), words // 2, 2).astype(np.int64)

    def _shapes(self, runs: list[_Run]) -> Iterator[Chunk]:
        for run in runs:
            self.budget.work(_SECONDS_OF_SHAPES)
            if run.kind == records.PATH:
                yield from (_paths(run, points, self._known) for points in self._coordinates(run))
            elif run.kind not in {records.BOUNDARY, records.BOX} or run.xy[1] != 10 or not self._known.are_rectangles:
                yield from (self._polygons(run.kind, points) for points in self._coordinates(run))
            else:
                for block in self._blocks(run):
                    boxes, is_rectangle = rectangles_of(block, run.xy[0])
                    yield _divided(run.kind, boxes, is_rectangle)

    def _polygons(self, kind: int, points: IntArray) -> Chunk:
        """Shapes of closed rings, shape (n, n_points, 2); rings that differ only in place are compared once."""
        at = points[:, 0]
        rings = points - at[:, None]
        # Rows are compared as bytes: `np.unique` along an axis compares number by number, at a hundred times the time.
        _, first, which = np.unique(
            rings.reshape(len(rings), -1).view(f"V{rings[0].nbytes}").ravel(), return_index=True, return_inverse=True
        )
        rings = rings[first]
        self.budget.work(_SECONDS_OF_A_COORDINATE * points.size + _SECONDS_OF_A_RING * len(rings))
        low = rings.min(axis=1)
        boxes = np.concatenate([low, rings.max(axis=1) - low], axis=1)
        pillars = [self._known(ring, self.unit_nm) for ring in rings]
        for box, pillar in zip(boxes, pillars, strict=True):
            box[:] = box if pillar is None else pillar
        is_pillar = np.array([pillar is not None for pillar in pillars])[which]
        return _divided(kind, boxes[which] + np.concatenate([at, np.zeros_like(at)], axis=1), is_pillar)

    def _damaged(self, expected: str, got: str) -> InputError:
        return damaged(str(self._path), expected, got)


def _divided(kind: int, boxes: IntArray, is_pillar: NDArray[np.bool_]) -> Chunk:
    """Chunk of the pillars among some boxes, shape (n, 4), and of the others."""
    if is_pillar.all():
        return Chunk(boxes)
    others = boxes[~is_pillar]
    return Chunk(boxes[is_pillar], (Other(_SHAPES[kind], others, len(others)),))


def _paths(run: _Run, points: IntArray, known: KnownShapes) -> Chunk:
    """Shapes of paths, shape (n, n_points, 2): straight ones along x or y with flush or half-width ends are rectangles.

    A path is a pillar only where pillars are rectangles.
    """
    steps = points[:, -1] - points[:, 0]
    straight = points.shape[1] == 2 and run.width > 0 and run.width % 2 == 0 and run.path_type in {0, 2}
    low, high = points.min(axis=1), points.max(axis=1)
    is_rectangle = (np.count_nonzero(steps, axis=1) == 1) & (straight and known.are_rectangles)
    half = run.width // 2
    margin = np.where(steps == 0, half, half if run.path_type == 2 else 0) * is_rectangle[:, None]
    return _divided(records.PATH, np.concatenate([low - margin, high - low + 2 * margin], axis=1), is_rectangle)
