"""Test structures of ``mask.kit`` as rectangles: bars, verniers, gratings, overlay marks, windows around marks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.errors import InputError
from metafab.layout.geometry import whole_dbu
from metafab.mask.drawing.clearance import boxes_of, moved, require_apart, require_clear_of_lenses, require_within_frame
from metafab.mask.shapes.hierarchy import IntArray
from metafab.spec import Design
from metafab.spec.mask import CdBars, Grating, Kit, Overlay, Vernier

#: Most rectangles of a grating.
_MOST_RECTANGLES = 1_000_000


@dataclass(frozen=True)
class Structure:
    """One test structure."""

    key: str  #: Its table in the design.
    first: IntArray  #: Shape (n, 4), rectangles (x, y, width, height) of the first exposure, database units.
    second: IntArray  #: Shape (n, 4), rectangles that are written with the pillars.

    def box(self, grown_dbu: int) -> IntArray:
        """Bounding box (left, bottom, right, top), grown on each side; shape (1, 4)."""
        boxes = boxes_of(np.concatenate([self.first, self.second]))
        low, high = boxes[:, :2].min(axis=0) - grown_dbu, boxes[:, 2:].max(axis=0) + grown_dbu
        return np.concatenate([low, high])[None]


def kit_structures(design: Design) -> tuple[Structure, ...]:
    """Draw the test structures; InputError if a length is off the grid, or a structure is too large."""
    kit, drawn = design.mask.kit, []
    if kit is None:
        return ()
    for name, items in _lists(kit):
        for number, item in enumerate(items):
            key = f"mask.kit.{name}[{number}]"
            unit = _Unit(design.mask.database_unit_nm, key)
            first, second = _draw(item, unit)
            at = [unit.um(place, "at_um") for place in item.at_um]
            drawn.append(Structure(key, moved(first, *at), moved(second, *at)))
    return tuple(drawn)


def require_clear_kit(
    design: Design,
    structures: Sequence[Structure],
    around: Sequence[tuple[str, IntArray]],
) -> None:
    """Refuse structures that are nearer than ``distance_um`` to a lens, to another structure, or to shapes around.

    Args:
        around: description and rectangles, shape (n, 4), of each kind of shapes around the lenses.

    Raises:
        InputError: a structure is too near (the message names both) or beyond the frame, or the mask's tone would print
            bars as trenches.
    """
    if design.mask.kit is None:
        return
    if design.mask.tone != "negative":
        got = f'tone = "{design.mask.tone}"'
        remedy = "exposed structures would be trenches there: take out mask.kit, or include a cell drawn for that tone"
        raise InputError.single(design.name, "mask.kit", 'tone = "negative"', got, remedy)
    distance = round(design.mask.kit.distance_um * 1e3 / design.mask.database_unit_nm)
    for number, structure in enumerate(structures):
        box = structure.box(distance)
        require_within_frame(design, structure.key, box, "move it with its distance, or widen `mask.chip.margin_um`")
        require_clear_of_lenses(design, structure.key, box, "the structure with its distance")
        for name, rectangles in around:
            require_apart(design, structure.key, box, boxes_of(rectangles), name)
        for before in structures[:number]:
            require_apart(design, structure.key, box, before.box(0), before.key)


def windows(marks: IntArray, margin_dbu: int) -> IntArray:
    """Grow the bounding box (left, bottom, right, top) of each mark by a margin; shape (n, 4).

    The windows are x, y, width and height, shape (n, 4).
    """
    low, high = marks[:, :2] - margin_dbu, marks[:, 2:] + margin_dbu
    return np.concatenate([low, high - low], axis=1)


@dataclass(frozen=True)
class _Unit:
    """Converts lengths of one structure to even numbers of database units."""

    nm_per_dbu: float
    key: str

    def nm(self, length_nm: float, name: str) -> int:
        """An even number, so that a centred shape has its edges on the grid."""
        return whole_dbu(length_nm, self.nm_per_dbu, f"{self.key}.{name}", even=True)

    def um(self, length_um: float, name: str) -> int:
        """As :meth:`nm`, for micrometres."""
        return self.nm(length_um * 1e3, name)


def _lists(kit: Kit) -> Iterator[tuple[str, Sequence[CdBars | Vernier | Grating | Overlay]]]:
    yield "cd_bars", kit.cd_bars
    yield "verniers", kit.verniers
    yield "gratings", kit.gratings
    yield "overlays", kit.overlays


def _draw(item: CdBars | Vernier | Grating | Overlay, unit: _Unit) -> tuple[IntArray, IntArray]:
    """Rectangles of the first and of the second exposure about the structure's centre."""
    nothing = np.empty((0, 4), dtype=np.int64)
    if isinstance(item, CdBars):
        return nothing, _cd_bars(item, unit)
    if isinstance(item, Grating):
        return nothing, _grating(item, unit)
    if isinstance(item, Overlay):
        line = unit.um(item.line_um, "line_um")
        outer = _frame(unit.um(item.outer_um, "outer_um"), line)
        return outer, _frame(unit.um(item.inner_um, "inner_um"), line)
    first, second = _combs(item, unit)
    return (first, second) if item.levels == "both" else (nothing, np.concatenate([first, second]))


def _cd_bars(item: CdBars, unit: _Unit) -> IntArray:
    """Groups side by side, bars along y; above them the same with x and y exchanged."""
    length, space = unit.um(item.length_um, "length_um"), unit.um(item.spacing_um, "spacing_um")
    bars, x = [], 0
    for width_nm in item.width_nm:
        width = unit.nm(width_nm, "width_nm")
        for _ in range(item.lines):
            bars.append((x, 0, width, length))
            x += 2 * width
        x += space - width  # the single bar stands one spacing from the last of the group
        bars.append((x, 0, width, length))
        x += width + space
    upright = np.array(bars, dtype=np.int64)
    across = x - space
    lying = moved(upright[:, [1, 0, 3, 2]], 0, length + space)
    whole = np.concatenate([upright, lying])
    return moved(whole, *(-2 * (side // 4) for side in (max(across, length), length + space + across)))


def _grating(item: Grating, unit: _Unit) -> IntArray:
    """Lines along y, or pillars, as many whole periods as fit."""
    size = [unit.um(side, "size_um") for side in item.size_um]
    pitch = [unit.nm(value, "pitch_nm") for value in item.pitch_nm]
    line = [unit.nm(value, "line_nm") for value in item.line_nm]
    counts = [side // p for side, p in zip(size, pitch, strict=False)] + [1] * (2 - len(pitch))
    if not all(counts):
        raise InputError.single(unit.key, "size_um", "at least one period", f"{item.size_um}", "make it larger")
    if counts[0] * counts[1] > _MOST_RECTANGLES:
        expected = f"at most {_MOST_RECTANGLES} shapes"
        raise InputError.single(unit.key, "size_um", expected, f"{counts[0] * counts[1]}", "make it smaller")
    width, length = line[0], line[1] if len(line) == 2 else size[1]
    columns, rows = np.arange(counts[0]), np.arange(counts[1])
    x = columns * pitch[0] - (counts[0] - 1) * (pitch[0] // 2) - width // 2
    along = pitch[1] if len(pitch) == 2 else 0
    y = rows * along - (counts[1] - 1) * (along // 2) - length // 2
    corner = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.concatenate([corner, np.broadcast_to([width, length], corner.shape)], axis=1).astype(np.int64)


def _combs(item: Vernier, unit: _Unit) -> tuple[IntArray, IntArray]:
    """Combs whose teeth meet along the x axis, and the same with x and y exchanged at their left."""
    width, length = (unit.um(side, "tooth_um") for side in item.tooth_um)
    pitch = unit.um(item.pitch_um, "pitch_um")
    step = unit.nm(item.step_nm, "step_nm")
    number = np.arange(item.teeth) - item.teeth // 2
    reach = np.where(number == 0, length + length // 2, length)

    def comb(spacing: int, above: bool) -> IntArray:
        y = np.zeros_like(reach) if above else -reach
        return np.stack([number * spacing - width // 2, y, np.full_like(reach, width), reach], axis=1).astype(np.int64)

    first, second = comb(pitch, above=False), comb(pitch + step, above=True)
    aside = -(item.teeth // 2 + 1) * (pitch + step) - 2 * length
    turned = [moved(one[:, [1, 0, 3, 2]], aside, 0) for one in (first, second)]
    middle = -2 * (aside // 4)
    both = [moved(np.concatenate(pair), middle, 0) for pair in zip((first, second), turned, strict=True)]
    return both[0], both[1]


def _frame(side: int, line: int) -> IntArray:
    """Square frame about the origin as four rectangles that do not overlap."""
    half, rest = side // 2, side - 2 * line
    sides = [(-half, -half, side, line), (-half, half - line, side, line)]
    sides += [(-half, -half + line, line, rest), (half - line, -half + line, line, rest)]
    return np.array(sides, dtype=np.int64)
