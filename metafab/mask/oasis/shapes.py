"""What the geometry records of OASIS draw, and what they may leave out because an earlier one said it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metafab.mask.oasis.records import RECTANGLE
from metafab.mask.oasis.stream import DamagedError, Stream
from metafab.mask.shapes.hierarchy import IntArray

#: Geometry records: rectangle, polygon, path, three trapezoids, compact trapezoid, circle, extension.
SHAPES = {RECTANGLE, 21, 22, 23, 24, 25, 26, 27, 33}


@dataclass
class Modal:
    """What records may leave out because an earlier one of the cell said it."""

    relative: bool = False
    placement: tuple[int, int] = (0, 0)
    geometry: tuple[int, int] = (0, 0)
    text: tuple[int, int] = (0, 0)
    cell: str | None = None
    layer: int = -1
    datatype: int = -1
    text_layer: tuple[int, int] = (-1, -1)
    width: int = 0
    height: int = 0
    half_width: int = 0
    extension: list[int] = field(default_factory=lambda: [0, 0])
    path: IntArray | None = None
    polygon: IntArray | None = None
    radius: int = 0
    trapezoid: int = 0
    repetition: IntArray | None = None
    #: Where a compiled run has left a repetition that nobody has asked for yet.
    unread: tuple[NDArray[np.uint8], int] | None = None


def read_shape(kind: int, info: int, stream: Stream, modal: Modal) -> tuple[IntArray, str]:
    """The part of a geometry record that says what it draws, and the modal variables that it sets or uses.

    Args:
        kind: type of the record, one of :data:`SHAPES`.
        info: its info byte.
        stream: stands behind layer and datatype; afterwards before x and y.
        modal: what the record may leave out.

    Returns:
        Corners about the shape's own origin, shape (n, 2), and what it is called. Of slanted trapezoids and bent
        paths only the bounding box is told; a fifth corner marks them as no rectangle.
    """
    if kind == 33:
        stream.string()
        return np.zeros((1, 2), dtype=np.int64), "extension geometry"
    if kind == 27:
        modal.radius = stream.unsigned() if info & 0b10_0000 else modal.radius
        return np.array([[-modal.radius] * 2, [modal.radius] * 2], dtype=np.int64), "circle"
    if kind == 21:
        modal.polygon = stream.points(closed=True) if info & 0b10_0000 else modal.polygon
        if modal.polygon is None:
            raise DamagedError("a polygon without points")
        return modal.polygon, "polygon"
    if kind == 22:
        return _path(info, stream, modal), "path"
    if kind == 26:
        modal.trapezoid = stream.unsigned() if info & 0b1000_0000 else modal.trapezoid
    modal.width = stream.unsigned() if info & 0b100_0000 else modal.width
    if kind == RECTANGLE and info & 0b1000_0000:
        modal.height = modal.width
    else:
        modal.height = stream.unsigned() if info & 0b10_0000 else modal.height
    width, height = modal.width, modal.height
    if kind == 26 and modal.trapezoid == 25:
        height = width
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.int64)
    if kind == RECTANGLE or (kind == 26 and modal.trapezoid in {24, 25}):
        return corners, "rectangle"
    slanted = kind == 26
    if kind in {23, 24}:
        slanted |= stream.signed() != 0
    if kind in {23, 25}:
        slanted |= stream.signed() != 0
    return np.concatenate([corners, [[width // 2, height // 2]]]) if slanted else corners, "trapezoid"


def _path(info: int, stream: Stream, modal: Modal) -> IntArray:
    """Outline of a path: exact where it is one straight piece, else its bounding box and a fifth corner."""
    modal.half_width = stream.unsigned() if info & 0b100_0000 else modal.half_width
    if info & 0b1000_0000:
        scheme = stream.unsigned()
        for end, choice in enumerate((scheme >> 2 & 3, scheme & 3)):
            if choice:
                modal.extension[end] = [0, modal.half_width, 0][choice - 1] if choice < 3 else stream.signed()
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
