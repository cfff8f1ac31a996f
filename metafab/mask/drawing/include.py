"""Cells of other files on the chip: marks, logos and test structures from GDSII or OASIS.

A cell is read with everything below it and drawn in the top cell as polygons: references and repetitions are resolved,
paths become their outlines. Layers are renamed by a table. Texts keep their words, place and layer; their anchor,
rotation and magnification, which OASIS cannot hold, are left out.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import gdstk
import numpy as np

from metafab.core.errors import InputError
from metafab.core.storage.limits import beyond, limit, limited
from metafab.layout.geometry import whole_dbu
from metafab.mask.budget import Budget
from metafab.mask.drawing.clearance import boxes_of, require_apart, require_clear_of_lenses, require_within_frame
from metafab.mask.drawing.surroundings import Surroundings, surroundings
from metafab.mask.gdsii.reader import GdsiiReader
from metafab.mask.oasis.reader import OasisReader
from metafab.mask.shapes.hierarchy import DEEPEST, IntArray
from metafab.spec import Design
from metafab.spec.mask import Include

#: Corners that every GDSII reader takes, and largest distance of a corner from the grid (database units).
_MOST_CORNERS, _ON_GRID = 8190, 1e-3
#: Longest text that every GDSII reader takes.
_LONGEST_TEXT = 512
#: Shapes and texts that a cell may expand to unless the limit ``shapes`` is stated, and corners of a shape: 1 kB.
_MOST_SHAPES, _CORNERS_OF_A_SHAPE = 1_000_000, 64
#: Default of the limit ``memory_mb``: gdstk inflates all blocks of a file, and holds some 250 bytes a shape besides.
_MOST_MB = 256.0
#: No layer is wanted: every shape is counted, none is kept.
_NO_LAYER = (-1, 0, -1)


@dataclass(frozen=True)
class IncludedPolygon:
    """One polygon in the top cell."""

    layer: int  #: Layer in the written file.
    datatype: int  #: Datatype in the written file.
    corners: IntArray  #: Shape (n, 2), x and y in database units, not closed.


@dataclass(frozen=True)
class IncludedText:
    """One text in the top cell, which draws nothing."""

    layer: int  #: Layer in the written file.
    kind: int  #: Text type in the written file.
    at_dbu: tuple[int, int]  #: Place (x, y), database units.
    words: str  #: Printable ASCII.


@dataclass(frozen=True)
class IncludedCell:
    """Everything drawn by one entry of ``mask.include``."""

    file: str  #: Name of the file, without its folder.
    cell: str  #: Name of the cell.
    polygons: tuple[IncludedPolygon, ...]  #: Its polygons.
    texts: tuple[IncludedText, ...]  #: Its texts.

    @property
    def boxes(self) -> IntArray:
        """Bounding box (left, bottom, right, top) of each polygon, shape (n, 4)."""
        corners = [np.concatenate([p.corners.min(axis=0), p.corners.max(axis=0)]) for p in self.polygons]
        return np.array(corners, dtype=np.int64).reshape(-1, 4)

    @property
    def outlines(self) -> list[IntArray]:
        """Corners of each polygon, shape (n, 2)."""
        return [polygon.corners for polygon in self.polygons]

    @property
    def counts(self) -> dict[str, int]:
        """Number of polygons on each "layer/datatype"."""
        counts = Counter(f"{polygon.layer}/{polygon.datatype}" for polygon in self.polygons)
        return dict(sorted(counts.items()))


def shapes_beside(design: Design) -> tuple[tuple[Surroundings, ...], tuple[IncludedCell, ...]]:
    """Return all that the design draws beside its lenses: own shapes, and cells of other files.

    Errors as :func:`~metafab.mask.drawing.surroundings.surroundings` and :func:`included_cells`.
    """
    around = surroundings(design)
    return around, included_cells(design, around)


def included_cells(design: Design, around: tuple[Surroundings, ...]) -> tuple[IncludedCell, ...]:
    """Read the cells of ``mask.include``, which must not touch the shapes ``around`` the lenses.

    InputError if a file or a cell is missing, a corner lies off the grid, a layer holds pillars, field, or chip
    features, or a polygon touches a lens, another feature, or another included cell, or lies beyond frame and dicing
    street without ``beyond_street``; or if a cell contains itself, is nested deeper than the limit, or holds more
    shapes and texts than the limit.
    """
    cells = tuple(_read(design, number, item) for number, item in enumerate(design.mask.include))
    for number, cell in enumerate(cells):
        key = f"mask.include[{number}]"
        _require_layers(design, key, cell)
        boxes, outlines = cell.boxes, cell.outlines
        require_clear_of_lenses(design, key, boxes, f"a polygon of {cell.cell}", outlines)
        for layer in around:
            require_apart(design, key, boxes, boxes_of(layer.rectangles), layer.name, outlines)
        for other, before in enumerate(cells[:number]):
            require_apart(design, key, boxes, before.boxes, f"mask.include[{other}]", outlines, before.outlines)
        if not design.mask.include[number].beyond_street:
            remedy = "move it, widen `mask.chip.margin_um`, or state `beyond_street = true` for shapes of the wafer"
            require_within_frame(design, key, boxes, remedy)
    return cells


def _read(design: Design, number: int, item: Include) -> IncludedCell:
    key = f"mask.include[{number}]"
    library = _opened(design, key, item.file)
    tops = {cell.name for cell in library.top_level()}
    if item.cell is None and len(tops) != 1:
        got = f"{len(tops)} top cells: {', '.join(sorted(tops)[:8])}"
        raise InputError.single(design.name, f"{key}.cell", "the name of a cell", got, "add `cell`")
    name = item.cell or next(iter(tops))
    found = {cell.name: cell for cell in library.cells if isinstance(cell, gdstk.Cell)}
    if name not in found:
        expected = f"one of {', '.join(sorted(found)[:12])}"
        raise InputError.single(design.name, f"{key}.cell", expected, repr(name))
    unit_nm = design.mask.database_unit_nm
    shift = np.array([whole_dbu(at_um * 1e3, unit_nm, f"{key}.at_um") for at_um in item.at_um])
    with limited(**design.stated_limits):
        _require_bounded(found[name], design.name, f"{key}.file")
    polygons = _polygons(design, key, found[name], library.unit)
    texts = _texts(design, key, found[name], library.unit)
    if not polygons:
        raise InputError.single(design.name, f"{key}.cell", "a cell with shapes", f"{name}, which holds none")
    present = {f"{each.layer}/{each.datatype}" for each in polygons} | {f"{each.layer}/{each.kind}" for each in texts}
    if absent := sorted(set(item.layers) - present):
        expected = f"layers of cell {name}: {', '.join(sorted(present))}"
        raise InputError.single(design.name, f"{key}.layers", expected, ", ".join(absent))

    def drawn_on(layer: int, kind: int) -> tuple[int, int]:
        """Layer and datatype, or text type, in the written file."""
        source = f"{layer}/{kind}"
        layer, kind = (int(part) for part in item.layers.get(source, source).split("/"))
        return layer, kind

    placed = [IncludedPolygon(*drawn_on(p.layer, p.datatype), p.corners + shift) for p in polygons]
    labels = [IncludedText(*drawn_on(t.layer, t.kind), _moved(t.at_dbu, shift), t.words) for t in texts]
    return IncludedCell(item.file.name, name, tuple(placed), tuple(labels))


def _moved(place: tuple[int, int], shift: IntArray) -> tuple[int, int]:
    x, y = (np.array(place) + shift).tolist()
    return x, y


def _polygons(design: Design, key: str, cell: gdstk.Cell, unit_m: float) -> list[IncludedPolygon]:
    """Polygons of a cell and of all that it places, on their layers in its file."""
    unit_nm, polygons = design.mask.database_unit_nm, []
    for polygon in cell.get_polygons(apply_repetitions=True, include_paths=True):
        exact = np.asarray(polygon.points) * (unit_m * 1e9 / unit_nm)
        corners = np.rint(exact).astype(np.int64)
        if np.abs(exact - corners).max() > _ON_GRID:
            worst = polygon.points[int(np.abs(exact - corners).max(axis=1).argmax())]
            expected = f"corners on the grid of {unit_nm:g} nm"
            got = f"({worst[0]:g}, {worst[1]:g}) of cell {cell.name}, in units of {unit_m:g} m"
            remedy = "choose a finer `database_unit_nm`, or round turned and scaled references in the file"
            raise InputError.single(design.name, f"{key}.file", expected, got, remedy)
        if len(corners) > _MOST_CORNERS:
            expected = f"polygons of at most {_MOST_CORNERS} corners"
            raise InputError.single(design.name, f"{key}.file", expected, f"{len(corners)}", "fracture the cell")
        polygons.append(IncludedPolygon(polygon.layer, polygon.datatype, corners))
    return polygons


def _texts(design: Design, key: str, cell: gdstk.Cell, unit_m: float) -> list[IncludedText]:
    """Texts of a cell and of all that it places, on their layers in its file."""
    texts = []
    for label in cell.get_labels(apply_repetitions=True):
        if not (label.text.isascii() and label.text.isprintable() and 0 < len(label.text) <= _LONGEST_TEXT):
            expected = f"texts of 1 to {_LONGEST_TEXT} printable ASCII characters"
            raise InputError.single(design.name, f"{key}.file", expected, repr(label.text[:40]), "change or remove it")
        at = np.array(label.origin) * (unit_m * 1e9 / design.mask.database_unit_nm)
        x, y = np.rint(at).astype(np.int64).tolist()
        texts.append(IncludedText(label.layer, label.texttype, (x, y), label.text))
    return texts


def _require_bounded(cell: gdstk.Cell, source: str, field: str) -> None:
    """Refuse a cell that is nested too deep or without end, or that expands to too many shapes and texts."""
    most, deepest = limit("shapes", _MOST_SHAPES), limit("depth", DEEPEST)
    count, _ = _expansion(cell, deepest, {})
    if math.isinf(count):
        expected = f"cells nested at most {deepest:g} deep"
        raise beyond(source, field, "depth", expected, "deeper ones, or one that contains itself", "flatten the cell")
    if count > most:
        expected = f"a cell of at most {most:g} shapes and texts"
        raise beyond(source, field, "shapes", expected, f"{count:.3g}", "include a smaller one")


def _expansion(
    cell: gdstk.Cell, deepest: float, counted: dict[str, tuple[float, int]], level: int = 1
) -> tuple[float, int]:
    """Shapes and texts of a cell, all references and repetitions expanded, and levels of cells.

    A shape counts once for every :data:`_CORNERS_OF_A_SHAPE` corners or part of them, an empty reference as one. The
    count is infinite for a cell that contains itself, or that has more than ``deepest`` levels: it is then not followed
    further. ``counted`` holds the cells that are counted or being counted.
    """
    if level > deepest:
        return math.inf, level
    if cell.name not in counted:
        counted[cell.name] = math.inf, 0
        outlines = (outline for path in cell.paths for outline in path.to_polygons())
        shapes: float = sum(max(1, label.repetition.size) for label in cell.labels)
        for polygon in (*cell.polygons, *outlines):
            shapes += max(1, polygon.repetition.size) * math.ceil(polygon.size / _CORNERS_OF_A_SHAPE)
        levels = 1
        for part in cell.references:
            if isinstance(part.cell, gdstk.Cell):
                inner, below = _expansion(part.cell, deepest, counted, level + 1)
                shapes, levels = shapes + max(1, part.repetition.size) * max(1, inner), max(levels, 1 + below)
        counted[cell.name] = (shapes if levels <= deepest else math.inf), levels
    return counted[cell.name]


def _opened(design: Design, key: str, path: Path) -> gdstk.Library:
    """Read a file, GDSII or OASIS by its first bytes, once metafab's reader has found its blocks within the budget."""
    try:
        with path.open("rb") as stream:
            is_oasis = stream.read(6) == b"%SEMI-"
        with limited(**design.stated_limits), limited(memory_mb=_MOST_MB):
            budget = Budget(path, sites=0, held=True)
            if is_oasis:
                OasisReader(path, _NO_LAYER, skip_blocks=False, budget=budget)
            else:
                GdsiiReader(path, _NO_LAYER, budget=budget)
        return gdstk.read_oas(str(path)) if is_oasis else gdstk.read_gds(str(path))
    except (OSError, RuntimeError) as error:
        expected = "a GDSII or OASIS file"
        raise InputError.single(design.name, f"{key}.file", expected, f"{path}: {error}") from error


def _require_layers(design: Design, key: str, cell: IncludedCell) -> None:
    """Refuse layers on which the design draws."""
    mask = design.mask
    own = {mask.layer, *((mask.field_layer,) if mask.tone != "negative" else ())}
    own |= set(mask.chip.layers) if mask.chip is not None else set()
    own |= set(mask.kit.layers) if mask.kit is not None else set()
    drawn = {(polygon.layer, polygon.datatype) for polygon in cell.polygons}
    taken = sorted(f"{layer}/{kind}" for layer, kind in drawn | {(t.layer, t.kind) for t in cell.texts} if layer in own)
    if taken:
        expected = f"layers other than {', '.join(map(str, sorted(own)))}, on which the design draws"
        raise InputError.single(design.name, f"{key}.layers", expected, taken[0], "rename it in `layers`")
