"""What is drawn beside the pillars: write field, alignment marks, frame, label, scale bar and dicing street."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.errors import InputError
from metafab.layout import lattice_of
from metafab.layout.geometry import aperture_dbu
from metafab.mask.font import ROWS, text_rectangles, width_squares
from metafab.mask.hierarchy import IntArray
from metafab.spec import Chip, Design


@dataclass(frozen=True)
class Surroundings:
    """Rectangles of one kind.

    Attributes:
        name: what they are, for layer lists.
        layer: layer; the datatype is 0.
        rectangles: shape (n, 4), x, y of the lower left corner, width, height in database units.
    """

    name: str
    layer: int
    rectangles: IntArray


def surroundings(design: Design) -> tuple[Surroundings, ...]:
    """All that the design draws beside its pillars; empty unless asked for.

    Raises:
        InputError: marks, label or scale bar do not fit where they belong.
    """
    found = []
    if design.mask.tone == "positive":
        lattice = lattice_of(design)
        width, height = (n * p for n, p in zip(lattice.shape[::-1], lattice.period_dbu, strict=True))
        field = np.array([[-(width // 2), -(height // 2), width, height]], dtype=np.int64)
        found.append(Surroundings("write field: expose field NOT pillars", design.mask.field_layer, field))
    if design.mask.chip is not None:
        found += _chip(design, design.mask.chip)
    return tuple(kind for kind in found if len(kind.rectangles))


def _chip(design: Design, chip: Chip) -> list[Surroundings]:
    lens, margin = aperture_dbu(design) // 2, _dbu(design, chip.margin_um)
    inner = lens + margin
    outer = inner + _dbu(design, chip.frame_um)
    return [
        Surroundings("alignment marks", chip.mark_layer, _marks(design, chip, lens + margin // 2)),
        Surroundings("frame", chip.frame_layer, _ring(inner, outer)),
        Surroundings("label and scale bar", chip.text_layer, _text(design, chip, lens, margin)),
        Surroundings("dicing street", chip.street_layer, _ring(outer, outer + _dbu(design, chip.street_um))),
    ]


def _marks(design: Design, chip: Chip, centre: int) -> IntArray:
    """Crosses centred at (+-centre, +-centre), three rectangles each, so that none overlap."""
    if chip.mark_um > chip.margin_um:
        raise _no_room(design, "mark_um", f"at most the margin of {chip.margin_um:g} um", f"{chip.mark_um:g} um")
    arm, line = _dbu(design, chip.mark_um), _dbu(design, chip.mark_line_um)
    if not arm:
        return np.empty((0, 4), dtype=np.int64)
    if line >= arm:
        raise _no_room(design, "mark_line_um", f"less than `mark_um`, {chip.mark_um:g} um", f"{chip.mark_line_um:g} um")
    half, rest = arm // 2, (arm - line) // 2
    cross = [(-half, -line // 2, arm, line), (-line // 2, -half, line, rest), (-line // 2, line // 2, line, rest)]
    corners = [(x, y, 0, 0) for y in (-centre, centre) for x in (-centre, centre)]
    return np.concatenate([np.array(cross) + corner for corner in np.array(corners, dtype=np.int64)])


def _ring(inner: int, outer: int) -> IntArray:
    """The square ring between two half sides, as four rectangles that do not overlap."""
    line = outer - inner
    if line == 0:
        return np.empty((0, 4), dtype=np.int64)
    whole, rest = 2 * outer, 2 * inner
    sides = [(-outer, -outer, whole, line), (-outer, inner, whole, line)]
    sides += [(-outer, -inner, line, rest), (inner, -inner, line, rest)]
    return np.array(sides, dtype=np.int64)


def _text(design: Design, chip: Chip, lens: int, margin: int) -> IntArray:
    """The label at the left and the scale bar, its length written above it, at the right; both below the lens."""
    label = design.name if chip.label is None else chip.label
    square = _dbu(design, chip.text_um) // ROWS
    if square < 1 or ROWS * square > margin:
        raise _no_room(design, "text_um", f"at most the margin of {chip.margin_um:g} um", f"{chip.text_um:g} um")
    # Marks reach inwards to the lens' square at most; text keeps half a margin from them.
    left, right = -lens + margin // 2, lens - margin // 2
    bottom = -lens - margin // 2 - ROWS * square // 2
    found = [_moved(text_rectangles(label, square), left, bottom)]
    used = width_squares(label) * square
    if chip.scale_bar_um:
        bar = _dbu(design, chip.scale_bar_um)
        caption = f"{chip.scale_bar_um:g} UM"
        small = max(1, square // 2)
        found.append(np.array([[right - bar, bottom, bar, square]], dtype=np.int64))
        found.append(_moved(text_rectangles(caption, small), right - bar, bottom + 2 * square))
        used += max(bar, width_squares(caption) * small) + ROWS * square
    if used > right - left:
        room_um = (right - left) * design.mask.database_unit_nm * 1e-3
        raise _no_room(
            design,
            "label",
            f"label and scale bar within {room_um:g} um",
            f"{used * design.mask.database_unit_nm * 1e-3:g} um",
        )
    return np.concatenate(found)


def _moved(rectangles: IntArray, x: int, y: int) -> IntArray:
    return rectangles + np.array([x, y, 0, 0], dtype=np.int64)


def _dbu(design: Design, length_um: float) -> int:
    """An even number of database units, so that centred rectangles are exact."""
    return 2 * round(length_um * 5e2 / design.mask.database_unit_nm)


def _no_room(design: Design, key: str, expected: str, got: str) -> InputError:
    return InputError.single(design.name, f"mask.chip.{key}", expected, got, "make it smaller or `margin_um` wider")
