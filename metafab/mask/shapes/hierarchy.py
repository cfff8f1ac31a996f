"""Cells and references of a mask file, in either format -> a stream of shapes in the coordinates of the top cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.storage.limits import beyond, limit

IntArray = NDArray[np.int64]

# Rectangles expanded at a time; keeps a chunk in the cache.
_CHUNK = 1 << 16

#: Deepest nesting of cells, unless the limit ``depth`` is stated; masks of a chip have fewer than twenty levels.
DEEPEST = 100

_ORIGIN = np.zeros(2, dtype=np.int64)

#: Cell in which KLayout, and with it gdsfactory, keeps notes on the other cells.
_CONTEXT = "$$$CONTEXT_INFO$$$"


@dataclass(frozen=True)
class Other:
    """Shapes of one kind on the pillar layer that are not pillars."""

    kind: str  #: Name of the shape in the file, such as "polygon".
    boxes: IntArray  #: Shape (n, 4), x, y, width, height of their bounding boxes in file units; (0, 4) if unknown.
    count: int  #: Number of shapes.


@dataclass(frozen=True)
class Orientation:
    """A mirror at the x axis, then ``quarters`` turns by 90 degrees counter-clockwise."""

    mirrored: bool = False
    quarters: int = 0

    def __call__(self, rectangles: IntArray) -> IntArray:
        """Mirror and turn rectangles, x, y, width, height; shape (n, 4) in and out."""
        if not self.mirrored and not self.quarters:
            return rectangles
        x, y, width, height = rectangles.T
        if self.mirrored:
            y = -(y + height)
        for _ in range(self.quarters):
            x, y, width, height = -(y + height), x, height, width
        return np.stack([x, y, width, height], axis=1)


@dataclass(frozen=True)
class Chunk:
    """Some shapes of a cell."""

    rectangles: IntArray  #: Pillars, shape (n, 4), x and y of the lower left corner, width, height, in file units.
    others: tuple[Other, ...] = ()  #: All other shapes on the pillar layer, already moved by ``shift``.
    #: Shape (2,), still to be added to x and y of the rectangles, which is free when they are put at their sites.
    shift: IntArray = field(default_factory=lambda: _ORIGIN)

    def shift_under(self, turn: Orientation) -> IntArray:
        """The shift after the rectangles have been turned, shape (2,)."""
        return turn(np.concatenate([self.shift, self.shift * 0])[None])[0, :2]


@dataclass(frozen=True)
class Part:
    """A piece of a file that can be read on its own, on any thread."""

    count: int  #: Number of shapes.
    chunks: Callable[[], Iterator[Chunk]]  #: Opens their stream.


@dataclass(frozen=True)
class Reference:
    """Placements of one cell."""

    cell: str  #: Its name.
    #: None if the cell is magnified or turned by another angle than a multiple of 90 degrees.
    orientation: Orientation | None
    count: int  #: Number of placements.
    offsets: Callable[[], Iterator[IntArray]]  #: Opens the stream of their origins, shape (m, 2) each.


@dataclass
class Cell:
    """A cell of a file."""

    references: list[Reference] = field(default_factory=list)  #: Cells placed in it.
    shapes: Callable[[], Iterator[Chunk]] = lambda: iter(())  #: Opens the stream of its own shapes on the pillar layer.
    shape_count: int = 0  #: Number of these shapes.
    #: Number of shapes on other layers, by "layer/datatype".
    other_layers: Counter[str] = field(default_factory=Counter)


class Hierarchy:
    """The cells of a file and their references.

    Args:
        cells: cells by name.
        source: the file, for messages.

    Attributes:
        tops: names of the cells that no other cell places, without KLayout's cell of notes.

    Raises:
        InputError: a referenced cell is missing, cells contain one another or nest too deeply, or there is no cell.
    """

    def __init__(self, cells: Mapping[str, Cell], source: str) -> None:
        self._cells = cells
        placed = set()
        for name, cell in cells.items():
            for reference in cell.references:
                placed.add(reference.cell)
                if reference.cell not in cells:
                    expected, got = "references to cells of the file", f"one to {reference.cell!r}"
                    remedy = "the file is incomplete: write it again"
                    raise InputError.single(source, f"cell {name}", expected, got, remedy)
        self.tops = tuple(name for name in cells if name not in placed and name != _CONTEXT)
        if not self.tops:
            got = "cells that contain one another" if cells else "no cell"
            raise InputError.single(source, "cells", "a top cell", got, "write the mask again")
        self._totals = self._count(source)

    @property
    def is_distorted(self) -> bool:
        """Whether a cell is magnified or obliquely turned: its shapes are not read, but counted by the index."""
        return any(reference.orientation is None for cell in self._cells.values() for reference in cell.references)

    def count(self) -> int:
        """Number of shapes on the pillar layer with all references expanded; reads no shape."""
        return sum(self._totals[top][0] for top in self.tops)

    def other_layers(self) -> dict[str, int]:
        """Number of shapes on other layers with all references expanded, by "layer/datatype"."""
        total: Counter[str] = Counter()
        for top in self.tops:
            total.update(self._totals[top][1])
        return dict(sorted(total.items()))

    def parts(self) -> Iterator[Part]:
        """All shapes on the pillar layer, in the coordinates of their top cell, in the order of the file."""
        for top in self.tops:
            cell = self._cells[top]
            if cell.shape_count:
                yield Part(cell.shape_count, cell.shapes)
            for reference in cell.references:
                yield from self._parts_of(reference)

    def _parts_of(self, reference: Reference) -> Iterator[Part]:
        count, _ = self._totals[reference.cell]
        if count == 0:
            return
        if reference.orientation is None:
            none = np.empty((0, 4), dtype=np.int64)
            lost = Other("magnified or obliquely turned reference", none, count * reference.count)
            chunk = Chunk(none, (lost,))
            yield Part(lost.count, lambda: iter((chunk,)))
            return
        block = max(1, _CHUNK // count)
        for offsets in reference.offsets():
            for start in range(0, len(offsets), block):
                shift = offsets[start : start + block]
                yield Part(count * len(shift), partial(self._placed, reference, shift))

    def _placed(self, reference: Reference, offsets: IntArray) -> Iterator[Chunk]:
        """Shapes of a placed cell at each of some origins, shape (m, 2)."""
        turn = reference.orientation or Orientation()
        for chunk in self._expanded(reference.cell):
            turned, shift = turn(chunk.rectangles), chunk.shift_under(turn)
            if len(offsets) == 1 and not chunk.others:
                yield Chunk(turned, (), shift + offsets[0])
                continue
            others = tuple(
                Other(other.kind, _copied(turn(other.boxes), offsets), other.count * len(offsets))
                for other in chunk.others
            )
            yield Chunk(_copied(turned, offsets + shift), others)

    def _expanded(self, name: str) -> Iterator[Chunk]:
        """Shapes of a cell and of all cells placed in it."""
        cell = self._cells[name]
        yield from cell.shapes()
        for reference in cell.references:
            for part in self._parts_of(reference):
                yield from part.chunks()

    def _count(self, source: str) -> dict[str, tuple[int, Counter[str]]]:
        """Expanded counts of every cell, children first, without recursion (files may nest deeply)."""
        totals: dict[str, tuple[int, Counter[str]]] = {}
        depth, deepest = dict[str, int](), limit("depth", DEEPEST)
        for top in self._cells:
            stack, open_cells = [(top, False)], set()
            while stack:
                name, children_done = stack.pop()
                if name in totals:
                    continue
                cell = self._cells[name]
                if children_done:
                    count, layers = cell.shape_count, Counter(cell.other_layers)
                    for reference in cell.references:
                        inner, inner_layers = totals[reference.cell]
                        count += inner * reference.count
                        for layer, number in inner_layers.items():
                            layers[layer] += number * reference.count
                    totals[name] = (count, layers)
                    depth[name] = 1 + max((depth[reference.cell] for reference in cell.references), default=0)
                    if depth[name] > deepest:
                        expected = f"cells nested at most {deepest:g} deep"
                        raise beyond(source, f"cell {name}", "depth", expected, "deeper ones", "flatten the mask")
                    open_cells.discard(name)
                    continue
                open_cells.add(name)
                stack.append((name, True))
                for reference in cell.references:
                    if reference.cell in open_cells:
                        expected, got = "cells without circles", f"one that contains {reference.cell!r}"
                        raise InputError.single(source, f"cell {name}", expected, got, "write the mask again")
                    stack.append((reference.cell, False))
        return totals


def _copied(boxes: IntArray, offsets: IntArray) -> IntArray:
    """Boxes, shape (n, 4), at each of some origins, shape (m, 2): shape (m n, 4)."""
    copies = np.repeat(boxes[None], len(offsets), axis=0)
    copies[:, :, :2] += offsets[:, None, :]
    return copies.reshape(-1, 4)


def box_of(points: IntArray) -> IntArray:
    """Bounding box of some points, shape (n, 2): x, y, width, height, shape (4,)."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.concatenate([low, high - low])
