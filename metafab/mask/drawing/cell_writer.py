"""Streaming of a mask, for both formats: tiles become cells as they come, and the top cell places them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask.drawing.cells import Stamp, TileCell, lens_name, tile_cell
from metafab.mask.drawing.copies import PLAIN, LensCopy, Variant, variants
from metafab.mask.shapes.hierarchy import IntArray


@dataclass(frozen=True)
class Drawing:
    """Properties of a mask that a writer needs before the first tile."""

    lattice: Lattice  #: Lattice of the tiles.
    top: str  #: Name of the top cell.
    copies: tuple[LensCopy, ...] = ()  #: Lenses to place if there are several; empty if the top cell is the lens.
    #: Whether the top cell is the only cell and holds every shape, those of each copy at their places.
    flat: bool = False


@dataclass(frozen=True)
class EncodedTile:
    """The shapes of one cell of a tile, in the bytes of a format."""

    variant: Variant  #: Bias and dose of the copies of the lens that the shapes belong to.
    cell: TileCell  #: Cell of the shapes.
    #: Bytes of the elements in pieces of shape (n,); a flat mask has them once for each copy of the lens.
    content: tuple[NDArray[np.uint8], ...]
    cells: Mapping[str, bytes] = field(default_factory=dict)  #: Encoded cells to which the elements refer, by name.


@dataclass(frozen=True)
class TileEncoder(ABC):
    """Encodes tiles in a format; independent of the file, so that it may travel to another process."""

    drawing: Drawing  #: The mask.

    def __call__(self, stamped: Iterable[tuple[PillarTile, Stamp]]) -> list[EncodedTile]:
        """Encode the stamps of a tile, cell by cell. Safe to call from several threads."""
        cells: dict[TileCell, list[tuple[PillarTile, Stamp]]] = {}
        for tile, stamp in stamped:
            cells.setdefault(tile_cell(self.drawing.lattice, tile, stamp), []).append((tile, stamp))
        return [self._encoded(cell, parts) for cell, parts in cells.items()]

    def _encoded(self, cell: TileCell, parts: Sequence[tuple[PillarTile, Stamp]]) -> EncodedTile:
        variant, flat = parts[0][1].variant, self.drawing.flat
        copies = [copy for copy in self.drawing.copies if flat and copy.variant == variant]
        places = [cell.flattened(copy.x_dbu, copy.y_dbu) for copy in copies] if flat else [cell]
        pieces = tuple(piece for place in places for piece in self._content(parts, place))
        if flat:
            return EncodedTile(variant, cell, pieces)
        used = {name: data for part in parts for name, data in self._cells(*part).items()}
        return EncodedTile(variant, cell, pieces, used)

    def _cells(self, tile: PillarTile, stamp: Stamp) -> dict[str, bytes]:
        """Encoded cells to which the elements of a tile refer; by default none."""
        return {}

    @abstractmethod
    def _content(self, parts: Sequence[tuple[PillarTile, Stamp]], cell: TileCell) -> Iterable[NDArray[np.uint8]]:
        """Bytes of the elements of a cell."""


class MaskWriter(ABC):
    """Writes a mask tile by tile from the start of a binary stream; only tiles that are being written are in memory.

    InputError if the format cannot hold the mask.
    """

    encoder: TileEncoder  #: Makes the encoded tiles that :meth:`add` takes.

    def __init__(self, stream: BinaryIO, drawing: Drawing) -> None:
        self._stream = stream
        self._drawing = drawing
        self._placed: dict[Variant, list[TileCell]] = {one: [] for one in variants(drawing.copies) or (PLAIN,)}
        self._cells: dict[str, bytes] = {}
        self._begin_file()
        if drawing.flat:
            self._begin_cell(drawing.top)

    def add(self, tile: EncodedTile) -> None:
        """Append the cell of a tile. The caller must not read the tile afterwards: its memory may be used again."""
        self._cells.update(tile.cells)
        if not self._drawing.flat:
            self._placed[tile.variant].append(tile.cell)
            self._begin_cell(tile.cell.name)
        for piece in tile.content:
            self._write(piece.data)  # Not copied: a tile may have tens of megabytes.
        if not self._drawing.flat:
            self._end_cell()

    def close(
        self,
        surroundings: Iterable[tuple[int, IntArray]] = (),
        polygons: Iterable[tuple[int, int, IntArray]] = (),
        texts: Iterable[tuple[int, int, tuple[int, int], str]] = (),
    ) -> None:
        """Write the top cell and the end of the file; InputError if the format cannot hold a rectangle.

        ``surroundings`` are (layer, rectangles of shape (n, 4)) to draw in the top cell, ``polygons`` (layer, datatype,
        corners of shape (n, 2)), ``texts`` (layer, text type, place (x, y) in database units, ASCII words).
        """
        for _, cell in sorted(self._cells.items()):
            self._write(cell)
        if not self._drawing.flat:
            self._begin_top()
        for layer, rectangles in surroundings:
            self._draw(layer, rectangles)
        for layer, datatype, corners in polygons:
            self._draw_polygon(layer, datatype, corners)
        for layer, kind, at_dbu, words in texts:
            self._add_text(layer, kind, at_dbu, words)
        self._end_cell()
        self._end_file()

    def _begin_top(self) -> None:
        """Write the cells of the lenses, and the top cell that places them; without copies it places the tiles."""
        drawing = self._drawing
        if drawing.copies:
            for variant in self._placed:
                self._begin_cell(lens_name(variant, drawing.top))
                self._place_tiles(variant)
                self._end_cell()
        self._begin_cell(drawing.top)
        if not drawing.copies:
            self._place_tiles(PLAIN)
        for copy in drawing.copies:
            self._place(lens_name(copy.variant, drawing.top), copy.x_dbu, copy.y_dbu)

    def _place_tiles(self, variant: Variant) -> None:
        for cell in self._placed[variant]:
            self._place(cell.name, cell.x_dbu, cell.y_dbu)

    def _write(self, data: bytes | memoryview) -> None:
        self._stream.write(data)

    @abstractmethod
    def _begin_file(self) -> None: ...

    @abstractmethod
    def _begin_cell(self, name: str) -> None: ...

    @abstractmethod
    def _place(self, name: str, x_dbu: int, y_dbu: int) -> None: ...

    @abstractmethod
    def _draw(self, layer: int, rectangles: IntArray) -> None:
        """Write rectangles, shape (n, 4), on datatype 0."""

    @abstractmethod
    def _draw_polygon(self, layer: int, datatype: int, corners: IntArray) -> None:
        """Write a polygon, shape (n, 2), not closed."""

    @abstractmethod
    def _add_text(self, layer: int, kind: int, at_dbu: tuple[int, int], words: str) -> None:
        """Write a text at a place (x, y)."""

    @abstractmethod
    def _end_cell(self) -> None: ...

    @abstractmethod
    def _end_file(self) -> None: ...
