"""Geometry records of OASIS -> corners; modal variables, which a record may leave out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from metafab.mask.oasis.elements import Copies, DamagedError, Stream, checked_place
from metafab.mask.oasis.records import POLYGON, RECTANGLE
from metafab.mask.shapes.hierarchy import IntArray

_PATH, _TRAPEZOID, _TRAPEZOID_A, _TRAPEZOID_B, _COMPACT_TRAPEZOID, _CIRCLE, _EXTENSION = 22, 23, 24, 25, 26, 27, 33
#: Kinds of geometry records.
SHAPES = {RECTANGLE, POLYGON, *range(_PATH, _CIRCLE + 1), _EXTENSION}


@dataclass
class Modal:
    """Modal variables of a cell: each keeps its last value for records that leave it out."""

    relative: bool = False  #: Whether positions are relative to the record before.
    placement: tuple[int, int] = (0, 0)  #: Position of the last placement.
    geometry: tuple[int, int] = (0, 0)  #: Position of the last shape.
    text: tuple[int, int] = (0, 0)  #: Position of the last text.
    cell: str | None = None  #: Name of the last placed cell.
    layer: int = -1
    datatype: int = -1
    text_layer: tuple[int, int] = (-1, -1)  #: Layer and type of texts.
    width: int = 0
    height: int = 0
    half_width: int = 0  #: Half the width of paths.
    extension: list[int] = field(default_factory=lambda: [0, 0])  #: Extensions of both ends of paths.
    path: IntArray | None = None  #: Vertices of paths, shape (n, 2).
    polygon: IntArray | None = None  #: Vertices of polygons, shape (n, 2).
    radius: int = 0
    trapezoid: int = 0  #: Type of compact trapezoids.
    repetition: Copies | None = None  #: Places of the last repetition.
    unread: Stream | None = None  #: Stands at a later repetition, which a compiled run has skipped.

    def read_position(self, stream: Stream, last: tuple[int, int], has_x: bool, has_y: bool) -> tuple[int, int]:
        """Read x and y, as far as the record has them; the others are those of ``last``."""
        x, y = last
        if has_x:
            x = stream.signed() + (x if self.relative else 0)
        if has_y:
            y = stream.signed() + (y if self.relative else 0)
        return checked_place(x, y)

    def read_repetition(self, stream: Stream, has_repetition: bool) -> Copies:
        """Read the places of all copies of a record; a single one if it has no repetition."""
        if not has_repetition:
            return Copies(1)
        if self.unread is not None:
            self.repetition, self.unread = self.unread.repetition(None), None
        self.repetition = stream.repetition(self.repetition)
        return self.repetition


def read_shape(kind: int, info: int, stream: Stream, modal: Modal) -> tuple[IntArray, str]:
    """Read the part of a geometry record between datatype and position.

    Args:
        kind: type of the record, one of :data:`SHAPES`.
        info: its info byte.
        stream: stands after layer and datatype; afterwards before x and y.
        modal: values of the fields that the record leaves out; updated.

    Returns:
        Corners relative to the position of the shape, shape (n, 2), and the name of the shape. Slanted trapezoids and
        bent paths are reduced to their bounding box; a fifth corner marks that they are not rectangles.
    """
    if kind == _EXTENSION:
        stream.string()
        return np.zeros((1, 2), dtype=np.int64), "extension geometry"
    if kind == _CIRCLE:
        modal.radius = stream.unsigned() if info & 0b10_0000 else modal.radius
        return np.array([[-modal.radius] * 2, [modal.radius] * 2], dtype=np.int64), "circle"
    if kind == POLYGON:
        modal.polygon = stream.points(closed=True) if info & 0b10_0000 else modal.polygon
        if modal.polygon is None:
            raise DamagedError("a polygon without points")
        return modal.polygon, "polygon"
    if kind == _PATH:
        return _path(info, stream, modal), "path"
    if kind == _COMPACT_TRAPEZOID:
        modal.trapezoid = stream.unsigned() if info & 0b1000_0000 else modal.trapezoid
    modal.width = stream.unsigned() if info & 0b100_0000 else modal.width
    if kind == RECTANGLE and info & 0b1000_0000:
        modal.height = modal.width
    else:
        modal.height = stream.unsigned() if info & 0b10_0000 else modal.height
    width, height = modal.width, modal.height
    if kind == _COMPACT_TRAPEZOID and modal.trapezoid == 25:
        height = width
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.int64)
    if kind == RECTANGLE or (kind == _COMPACT_TRAPEZOID and modal.trapezoid in {24, 25}):
        return corners, "rectangle"
    slanted = kind == _COMPACT_TRAPEZOID
    if kind in {_TRAPEZOID, _TRAPEZOID_A}:
        slanted |= stream.signed() != 0
    if kind in {_TRAPEZOID, _TRAPEZOID_B}:
        slanted |= stream.signed() != 0
    return np.concatenate([corners, [[width // 2, height // 2]]]) if slanted else corners, "trapezoid"


def _path(info: int, stream: Stream, modal: Modal) -> IntArray:
    """Outline of a path: exact if it is one straight piece, else its bounding box and a fifth corner."""
    modal.half_width = stream.unsigned() if info & 0b100_0000 else modal.half_width
    if info & 0b1000_0000:
        scheme = stream.unsigned()
        for end, choice in enumerate((scheme >> 2 & 3, scheme & 3)):
            if choice:
                modal.extension[end] = (0, modal.half_width)[choice - 1] if choice < 3 else stream.signed()
    modal.path = stream.points(closed=False) if info & 0b10_0000 else modal.path
    if modal.path is None:
        raise DamagedError("a path without points")
    points = modal.path
    step = points[-1] - points[0]
    if len(points) == 2 and np.count_nonzero(step) == 1:
        unit = np.sign(step)
        ends = np.stack([points[0] - unit * modal.extension[0], points[1] + unit * modal.extension[1]])
        low = ends.min(axis=0) - modal.half_width * (step == 0)
        high = ends.max(axis=0) + modal.half_width * (step == 0)
        return np.array([low, [high[0], low[1]], high, [low[0], high[1]]], dtype=np.int64)
    reach = modal.half_width + max(*modal.extension, 0)
    return np.concatenate([points - reach, points + reach, points[:1]])
