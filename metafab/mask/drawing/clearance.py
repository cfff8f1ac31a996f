"""Distances between the lenses and everything beside them.

Boxes (left, bottom, right, top) that touch are judged by their polygons where these are known, as for included cells.
Polygons nearer than one database unit touch.
"""

from __future__ import annotations

from collections.abc import Sequence

import gdstk
import numpy as np

from metafab.core.errors import InputError
from metafab.layout.geometry import aperture_dbu
from metafab.mask.drawing.copies import lens_copies
from metafab.mask.shapes.hierarchy import IntArray
from metafab.spec import Design


def boxes_of(rectangles: IntArray) -> IntArray:
    """Convert rectangles (x, y, width, height) to boxes; shape (n, 4) both."""
    return np.concatenate([rectangles[:, :2], rectangles[:, :2] + rectangles[:, 2:]], axis=1)


def moved(rectangles: IntArray, x: int, y: int) -> IntArray:
    """Displace rectangles (x, y, width, height), shape (n, 4)."""
    return rectangles + np.array([x, y, 0, 0], dtype=np.int64)


def require_clear_of_lenses(
    design: Design, key: str, boxes: IntArray, name: str, outlines: Sequence[IntArray] | None = None
) -> None:
    """Refuse boxes of a design's table ``key``, shape (n, 4), database units, that reach into a lens: InputError.

    ``outlines`` are the polygons in the boxes, corners of shape (m, 2) each.
    """
    half = aperture_dbu(design) // 2
    for number, copy in enumerate(lens_copies(design), start=1):
        at = np.array([copy.x_dbu, copy.y_dbu])
        away = np.maximum(np.maximum(boxes[:, :2] - at, at - boxes[:, 2:]), 0)
        # The field of other tones is a square.
        is_round = design.device.aperture_shape in {"circle", "ring"} and design.mask.tone == "negative"
        reach = np.hypot(*away.T) if is_round else away.max(axis=1)
        for box in np.flatnonzero(reach <= half).tolist():
            if outlines is not None and not _reaches(outlines[box] - at, half, is_round):
                continue
            left, bottom, *_ = boxes[box].tolist()
            um = design.mask.database_unit_nm * 1e-3
            got = f"{name} at ({left * um:g}, {bottom * um:g}) um in lens {number}"
            raise InputError.single(design.name, f"{key}.at_um", "a place beside the lenses", got, "move it")


def require_within_frame(design: Design, key: str, boxes: IntArray, remedy: str) -> None:
    """Refuse boxes of a table ``key`` of the design, shape (n, 4), beyond frame and dicing street: InputError."""
    chip = design.mask.chip
    if chip is None or not (chip.frame_um or chip.street_um):
        return
    at = np.array([(copy.x_dbu, copy.y_dbu) for copy in lens_copies(design)])
    margin = aperture_dbu(design) // 2 + 2 * round(chip.margin_um * 5e2 / design.mask.database_unit_nm)
    low, high = at.min(axis=0) - margin, at.max(axis=0) + margin
    for box in boxes[((boxes[:, :2] < low) | (boxes[:, 2:] > high)).any(axis=1)][:1]:
        um = design.mask.database_unit_nm * 1e-3
        inner, outer = (
            "x from {:g} to {:g} um and y from {:g} to {:g} um".format(*(um * np.array(sides)[[0, 2, 1, 3]]))
            for sides in ((*low, *high), box)
        )
        expected = f"a place within the frame, {inner}"
        raise InputError.single(design.name, f"{key}.at_um", expected, outer, remedy)


def _reaches(outline: IntArray, half: int, is_round: bool) -> bool:
    """Whether a polygon reaches into the disc of radius ``half`` about the origin, or into the square around it."""
    if not is_round:
        return _meet(outline, [np.array([[-half, -half], [half, -half], [half, half], [-half, half]])])
    start = outline.astype(np.float64)
    along = np.roll(start, -1, axis=0) - start
    share = np.clip(-(start * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1.0), 0.0, 1.0)
    nearest = np.hypot(*(start + share[:, None] * along).T).min()
    return bool(nearest <= half) or bool(gdstk.Polygon(start.tolist()).contain((0.0, 0.0)))


def _meet(outline: IntArray, others: Sequence[IntArray]) -> bool:
    """Whether a polygon touches one of ``others``, corners of shape (n, 2) each."""
    origin = outline[0]  # Near the origin whole numbers stay exact.
    grown = gdstk.offset([gdstk.Polygon(other - origin) for other in others], 1.0)
    return bool(gdstk.boolean(gdstk.Polygon(outline - origin), grown, "and"))


def require_apart(
    design: Design,
    key: str,
    boxes: IntArray,
    others: IntArray,
    name: str,
    outlines: Sequence[IntArray] | None = None,
    other_outlines: Sequence[IntArray] | None = None,
) -> None:
    """Refuse boxes of a table ``key`` of the design, shape (n, 4), that touch ``others``, shape (m, 4): InputError.

    ``outlines`` are the polygons in the boxes, corners of shape (n, 2) each; ``other_outlines`` those in ``others``,
    which without them are rectangles.
    """
    for number, (left, bottom, right, top) in enumerate(boxes.tolist()):
        touching = (others[:, 0] <= right) & (others[:, 2] >= left) & (others[:, 1] <= top) & (others[:, 3] >= bottom)
        if touching.any():
            near = np.flatnonzero(touching).tolist()
            beside = [others[i][[[0, 1], [2, 1], [2, 3], [0, 3]]] for i in near]
            if other_outlines is not None:
                beside = [other_outlines[i] for i in near]
            if outlines is not None and not _meet(outlines[number], beside):
                continue
            um = design.mask.database_unit_nm * 1e-3
            got = f"a shape at ({left * um:g}, {bottom * um:g}) um that touches: {name}"
            raise InputError.single(design.name, f"{key}.at_um", "a free place", got, "move it")
