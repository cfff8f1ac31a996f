"""Cells of other files on the chip: marks, logos and test structures from GDSII or OASIS.

A cell is read with everything below it and drawn in the top cell as polygons: references and repetitions are resolved,
paths become their outlines. Layers are renamed by a table. Texts draw nothing; they are counted, not written.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import gdstk
import numpy as np

from metafab.core.errors import InputError
from metafab.layout.geometry import aperture_dbu, whole_dbu
from metafab.mask.drawing.copies import lens_copies
from metafab.mask.drawing.surroundings import Surroundings
from metafab.mask.shapes.hierarchy import IntArray
from metafab.spec import Design
from metafab.spec.mask import Include

#: Corners that every GDSII reader takes, and largest distance of a corner from the grid (database units).
_MOST_CORNERS, _ON_GRID = 8190, 1e-3


@dataclass(frozen=True)
class IncludedPolygon:
    """One polygon in the top cell.

    Attributes:
        layer: layer in the written file.
        datatype: datatype in the written file.
        corners: shape (n, 2), x and y in database units, not closed.
    """

    layer: int
    datatype: int
    corners: IntArray

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, bottom, right and top."""
        (left, bottom), (right, top) = self.corners.min(axis=0).tolist(), self.corners.max(axis=0).tolist()
        return left, bottom, right, top


@dataclass(frozen=True)
class IncludedCell:
    """Everything drawn by one entry of ``mask.include``.

    Attributes:
        file: name of the file, without its folder.
        cell: name of the cell.
        polygons: its polygons.
        texts: number of texts, which are not written.
    """

    file: str
    cell: str
    polygons: tuple[IncludedPolygon, ...]
    texts: int

    @property
    def counts(self) -> dict[str, int]:
        """Number of polygons on each "layer/datatype"."""
        counts = Counter(f"{polygon.layer}/{polygon.datatype}" for polygon in self.polygons)
        return dict(sorted(counts.items()))


def included_cells(design: Design, around: tuple[Surroundings, ...]) -> tuple[IncludedCell, ...]:
    """Read the cells of ``mask.include``.

    Args:
        design: the chip.
        around: shapes around the lenses, which the cells must not touch.

    Raises:
        InputError: a file or a cell is missing, a corner lies off the grid, a layer holds pillars, field, or chip
            features, or a polygon touches a lens, another feature, or another included cell.
    """
    cells = tuple(_read(design, number, item) for number, item in enumerate(design.mask.include, start=1))
    for number, cell in enumerate(cells, start=1):
        key = f"mask.include[{number}]"
        _require_layers(design, key, cell)
        _require_clear_of_lenses(design, key, cell)
        boxes = np.array([polygon.box for polygon in cell.polygons]).reshape(-1, 4)
        for layer in around:
            rectangles = layer.rectangles
            others = np.concatenate([rectangles[:, :2], rectangles[:, :2] + rectangles[:, 2:]], axis=1)
            _require_apart(design, key, boxes, others, layer.name)
        for other, before in enumerate(cells[: number - 1], start=1):
            others = np.array([polygon.box for polygon in before.polygons]).reshape(-1, 4)
            _require_apart(design, key, boxes, others, f"mask.include[{other}]")
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
    per_unit = library.unit * 1e9 / unit_nm
    polygons, present = [], set()
    for polygon in found[name].get_polygons(apply_repetitions=True, include_paths=True):
        exact = np.asarray(polygon.points) * per_unit
        corners = np.rint(exact).astype(np.int64)
        if np.abs(exact - corners).max() > _ON_GRID:
            worst = polygon.points[int(np.abs(exact - corners).max(axis=1).argmax())]
            expected = f"corners on the grid of {unit_nm:g} nm"
            got = f"({worst[0]:g}, {worst[1]:g}) of cell {name}, in units of {library.unit:g} m"
            raise InputError.single(design.name, f"{key}.file", expected, got, "choose a finer `database_unit_nm`")
        if len(corners) > _MOST_CORNERS:
            expected = f"polygons of at most {_MOST_CORNERS} corners"
            raise InputError.single(design.name, f"{key}.file", expected, f"{len(corners)}", "fracture the cell")
        source = f"{polygon.layer}/{polygon.datatype}"
        present.add(source)
        layer, datatype = (int(part) for part in item.layers.get(source, source).split("/"))
        polygons.append(IncludedPolygon(layer, datatype, corners + shift))
    if not polygons:
        raise InputError.single(design.name, f"{key}.cell", "a cell with shapes", f"{name}, which holds none")
    if absent := sorted(set(item.layers) - present):
        expected = f"layers of cell {name}: {', '.join(sorted(present))}"
        raise InputError.single(design.name, f"{key}.layers", expected, ", ".join(absent))
    return IncludedCell(item.file.name, name, tuple(polygons), len(found[name].get_labels()))


def _opened(design: Design, key: str, path: Path) -> gdstk.Library:
    """Read a file by its first bytes."""
    try:
        with path.open("rb") as stream:
            is_oasis = stream.read(6) == b"%SEMI-"
        return gdstk.read_oas(str(path)) if is_oasis else gdstk.read_gds(str(path))
    except (OSError, RuntimeError) as error:
        expected = "a GDSII or OASIS file"
        raise InputError.single(design.name, f"{key}.file", expected, f"{path}: {error}") from error


def _require_layers(design: Design, key: str, cell: IncludedCell) -> None:
    """Refuse layers on which the design draws."""
    mask = design.mask
    own = {mask.layer, *((mask.field_layer,) if mask.tone != "negative" else ())}
    own |= set(mask.chip.layers) if mask.chip is not None else set()
    taken = sorted(f"{p.layer}/{p.datatype}" for p in cell.polygons if p.layer in own)
    if taken:
        expected = f"layers other than {', '.join(map(str, sorted(own)))}, on which the design draws"
        raise InputError.single(design.name, f"{key}.layers", expected, taken[0], "rename it in `layers`")


def _require_clear_of_lenses(design: Design, key: str, cell: IncludedCell) -> None:
    """Refuse polygons that reach into a lens."""
    half = aperture_dbu(design) // 2
    for number, copy in enumerate(lens_copies(design), start=1):
        for polygon in cell.polygons:
            left, bottom, right, top = polygon.box
            near = np.array(
                [max(left - copy.x_dbu, 0, copy.x_dbu - right), max(bottom - copy.y_dbu, 0, copy.y_dbu - top)]
            )
            reach = np.hypot(*near) if design.device.aperture_shape == "circle" else near.max()
            if reach <= half:
                um = design.mask.database_unit_nm * 1e-3
                got = f"a polygon of {cell.cell} at ({left * um:g}, {bottom * um:g}) um in lens {number}"
                raise InputError.single(design.name, f"{key}.at_um", "a place beside the lenses", got, "move it")


def _require_apart(design: Design, key: str, boxes: IntArray, others: IntArray, name: str) -> None:
    """Refuse bounding boxes, shape (n, 4), that touch others, shape (m, 4): left, bottom, right, top."""
    for left, bottom, right, top in boxes.tolist():
        touching = (others[:, 0] <= right) & (others[:, 2] >= left) & (others[:, 1] <= top) & (others[:, 3] >= bottom)
        if touching.any():
            um = design.mask.database_unit_nm * 1e-3
            got = f"a shape at ({left * um:g}, {bottom * um:g}) um that touches: {name}"
            raise InputError.single(design.name, f"{key}.at_um", "a free place", got, "move it")
