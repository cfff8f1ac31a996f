"""Shapes around the lenses of a chip: write fields, marks, frame, labels, scale bar, street, test structures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.errors import InputError
from metafab.layout import lattice_of
from metafab.layout.geometry import aperture_dbu
from metafab.mask.drawing.clearance import boxes_of, moved
from metafab.mask.drawing.copies import LensCopy, lens_copies
from metafab.mask.drawing.font import ROWS, text_rectangles, width_squares
from metafab.mask.drawing.kit import kit_structures, require_clear_kit, windows
from metafab.mask.shapes.hierarchy import IntArray
from metafab.spec import Chip, Design
from metafab.spec.mask import Kit


@dataclass(frozen=True)
class Surroundings:
    """Rectangles of one layer around the lenses."""

    name: str  #: Description in lists of layers.
    layer: int  #: GDSII or OASIS layer; the datatype is 0.
    rectangles: IntArray  #: Shape (n, 4), x, y of the lower left corner, width, height in database units.
    #: Number of the exposure that writes them, 1 for marks that the second one is aligned to; 0 for windows that the
    #: shop uses as it needs.
    exposure: int = 2


def surroundings(design: Design) -> tuple[Surroundings, ...]:
    """Return the layers that the design draws around its lenses; empty for a lens alone in negative tone.

    InputError if marks, label or scale bar do not fit in their place, or a test structure touches something.
    """
    layers, copies = [], lens_copies(design)
    if design.mask.tone == "positive":
        lattice = lattice_of(design)
        width, height = (n * p for n, p in zip(lattice.shape[::-1], lattice.period_dbu, strict=True))
        corners = [(copy.x_dbu - width // 2, copy.y_dbu - height // 2) for copy in copies]
        field = np.array([[x, y, width, height] for x, y in corners], dtype=np.int64)
        layers.append(Surroundings("write field: expose field NOT pillars", design.mask.field_layer, field))
    if design.mask.chip is not None:
        layers += _chip(design, design.mask.chip, copies)
    if design.mask.kit is not None:
        layers += _kit(design, design.mask.kit, layers)
    return tuple(layer for layer in layers if len(layer.rectangles))


@dataclass(frozen=True)
class _Box:
    """A rectangle by its sides, in database units."""

    left: int
    bottom: int
    right: int
    top: int

    def grown(self, by: int) -> _Box:
        """Return the rectangle with each side moved outwards."""
        return _Box(self.left - by, self.bottom - by, self.right + by, self.top + by)


def _chip(design: Design, chip: Chip, copies: Sequence[LensCopy]) -> list[Surroundings]:
    lens, margin = aperture_dbu(design) // 2, _dbu(design, chip.margin_um)
    lenses = _lenses(design, copies)
    inner = lenses.grown(margin)
    outer = inner.grown(_dbu(design, chip.frame_um))
    text = np.concatenate([_text(design, chip, lenses, margin), *_copy_labels(design, chip, copies, lens)])
    return [
        Surroundings("alignment marks", chip.mark_layer, _marks(design, chip, lenses.grown(margin // 2)), exposure=1),
        Surroundings("frame", chip.frame_layer, _ring(inner, outer)),
        Surroundings("label and scale bar", chip.text_layer, text),
        Surroundings("dicing street", chip.street_layer, _ring(outer, outer.grown(_dbu(design, chip.street_um)))),
    ]


def _lenses(design: Design, copies: Sequence[LensCopy]) -> _Box:
    """Bounding box of all lenses."""
    x_dbu, y_dbu = [copy.x_dbu for copy in copies], [copy.y_dbu for copy in copies]
    return _Box(min(x_dbu), min(y_dbu), max(x_dbu), max(y_dbu)).grown(aperture_dbu(design) // 2)


def _kit(design: Design, kit: Kit, around: Sequence[Surroundings]) -> list[Surroundings]:
    """Test structures, and windows around all that the first exposure draws."""
    structures = kit_structures(design)
    require_clear_kit(design, structures, [(layer.name, layer.rectangles) for layer in around])
    nothing = [np.empty((0, 4), dtype=np.int64)]
    first = np.concatenate([*nothing, *(one.first for one in structures)])
    second = np.concatenate([*nothing, *(one.second for one in structures)])
    marks = [layer.rectangles for layer in around if layer.exposure == 1]
    # A cross is three rectangles.
    boxes = [boxes_of(cross) for one in marks for cross in one.reshape(-1, 3, 4)]
    corners = [np.concatenate([box[:, :2].min(axis=0), box[:, 2:].max(axis=0)])[None] for box in boxes]
    corners += [one.box(0) for one in structures if len(one.first)]
    margin = _dbu(design, kit.clear_um)
    return [
        Surroundings("test structures of the first exposure", kit.first_layer, first, exposure=1),
        Surroundings("test structures", kit.layer, second),
        Surroundings(
            "windows around marks",
            kit.clear_layer,
            windows(np.concatenate([*nothing, *corners]), margin) if margin else nothing[0],
            exposure=0,
        ),
    ]


def _marks(design: Design, chip: Chip, centres: _Box) -> IntArray:
    """Crosses centred at the corners of ``centres``; each is three rectangles that do not overlap."""
    if chip.mark_um > chip.margin_um:
        raise _no_room(design, "mark_um", f"at most the margin of {chip.margin_um:g} um", f"{chip.mark_um:g} um")
    clear_um = design.mask.kit.clear_um if design.mask.kit is not None else 0.0
    if clear_um and chip.mark_um + 2.0 * clear_um >= chip.margin_um:
        expected = f"with `mask.kit.clear_um` on both sides less than the margin of {chip.margin_um:g} um"
        raise _no_room(design, "mark_um", expected, f"{chip.mark_um + 2.0 * clear_um:g} um")
    arm, line = _dbu(design, chip.mark_um), _dbu(design, chip.mark_line_um)
    if not arm:
        return np.empty((0, 4), dtype=np.int64)
    if line >= arm:
        raise _no_room(design, "mark_line_um", f"less than `mark_um`, {chip.mark_um:g} um", f"{chip.mark_line_um:g} um")
    half, rest = arm // 2, (arm - line) // 2
    cross = [(-half, -line // 2, arm, line), (-line // 2, -half, line, rest), (-line // 2, line // 2, line, rest)]
    corners = [(x, y, 0, 0) for y in (centres.bottom, centres.top) for x in (centres.left, centres.right)]
    return np.concatenate([np.array(cross) + corner for corner in np.array(corners, dtype=np.int64)])


def _ring(inner: _Box, outer: _Box) -> IntArray:
    """Ring between two boxes, as four rectangles that do not overlap."""
    line = outer.right - inner.right
    if line == 0:
        return np.empty((0, 4), dtype=np.int64)
    whole, rest = outer.right - outer.left, inner.top - inner.bottom
    sides = [(outer.left, outer.bottom, whole, line), (outer.left, inner.top, whole, line)]
    sides += [(outer.left, inner.bottom, line, rest), (inner.right, inner.bottom, line, rest)]
    return np.array(sides, dtype=np.int64)


def _copy_labels(design: Design, chip: Chip, copies: Sequence[LensCopy], lens: int) -> Iterator[IntArray]:
    """Label of each copy, just above the square of its lens.

    InputError if a label is wider than its lens, or lies on another lens.
    """
    square = _dbu(design, chip.text_um) // ROWS
    for number, copy in enumerate(copies):
        if copy.label is None or not chip.text_um:
            continue
        key, width = f"mask.copies[{number}].label", width_squares(copy.label) * square
        if width > 2 * lens:
            um = width * design.mask.database_unit_nm * 1e-3
            expected = f"at most the lens' {design.device.aperture_um:g} um"
            raise InputError.single(design.name, key, expected, f"{um:g} um", "shorten it, or `mask.chip.text_um`")
        left, bottom = copy.x_dbu - lens, copy.y_dbu + lens + square
        for other in copies:
            aside = left >= other.x_dbu + lens or left + width <= other.x_dbu - lens
            if not (aside or bottom >= other.y_dbu + lens or bottom + ROWS * square <= other.y_dbu - lens):
                expected, got = "room above the lens", f"a lens at {other.x_dbu}, {other.y_dbu} database units there"
                raise InputError.single(design.name, key, expected, got, "move the copies apart")
        yield moved(text_rectangles(copy.label, square), left, bottom)


def _text(design: Design, chip: Chip, lenses: _Box, margin: int) -> IntArray:
    """Label at the left, and scale bar with its length at the right; both below all lenses."""
    label = design.name if chip.label is None else chip.label
    square = _dbu(design, chip.text_um) // ROWS
    if not chip.text_um:
        return np.empty((0, 4), dtype=np.int64)
    if square < 1 or (ROWS + 2 * bool(design.mask.copies)) * square > margin:
        raise _no_room(design, "text_um", f"at most the margin of {chip.margin_um:g} um", f"{chip.text_um:g} um")
    bar, small = _dbu(design, chip.scale_bar_um), max(1, square // 2)
    caption = f"{chip.scale_bar_um:g} UM"
    used = width_squares(label) * square
    if bar:
        used += max(bar, width_squares(caption) * small) + ROWS * square
    # Marks reach inwards as far as the box around the lenses; the text keeps half a margin from them where it fits.
    width = lenses.right - lenses.left
    aside = min(margin // 2, max(square, (width - used) // 2))
    if used > max(0, width - 2 * aside):
        um = design.mask.database_unit_nm * 1e-3
        expected = f"label and scale bar within {max(0, width - 2 * aside) * um:g} um"
        remedy = "shorten it, or `text_um` and `scale_bar_um`"
        raise InputError.single(design.name, "mask.chip.label", expected, f"{used * um:g} um", remedy)
    left, right = lenses.left + aside, lenses.right - aside
    bottom = lenses.bottom - margin // 2 - ROWS * square // 2
    rectangles = [moved(text_rectangles(label, square), left, bottom)]
    if bar:
        rectangles.append(np.array([[right - bar, bottom, bar, square]], dtype=np.int64))
        rectangles.append(moved(text_rectangles(caption, small), right - bar, bottom + 2 * square))
    return np.concatenate(rectangles)


def _dbu(design: Design, length_um: float) -> int:
    """Convert to an even number of database units, so that centred rectangles are exact."""
    return 2 * round(length_um * 5e2 / design.mask.database_unit_nm)


def _no_room(design: Design, key: str, expected: str, got: str) -> InputError:
    return InputError.single(design.name, f"mask.chip.{key}", expected, got, "make it smaller or `margin_um` wider")
