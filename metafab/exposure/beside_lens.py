"""Shapes of a written mask beside one of its lenses, and those among them that are exposed with the lens.

Other copies are read from the file. Frame, text, test structures and included cells are those of the design; the file
gives the number of shapes on their layers.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from metafab import mask
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress
from metafab.exposure.energy.beside import Beside, OtherLens
from metafab.exposure.energy.far import REACH
from metafab.exposure.expose import ExposedLens
from metafab.layout import Outline, PillarMap, lattice_of
from metafab.mask import ReadBack, shapes_beside
from metafab.mask.drawing.copies import lens_copies, lens_copy
from metafab.mask.writing import strips
from metafab.spec import Design

_log = logging.getLogger(__name__)

Dose = Literal["counted", "out of reach", "first exposure", "not the design's"]

#: Height of the strips into which shapes with inclined sides are cut (nm).
_STRIP_NM = 50.0


@dataclass(frozen=True)
class ShapesBeside:
    """Shapes of a mask beside the lens: another copy, or a layer."""

    name: str  #: The copy, or the layer and its content.
    shapes: int  #: Number of shapes in the file.
    #: Whether their dose is counted; they are left out where no Gaussian reaches the lens, where the first exposure
    #: writes them, and where the design does not draw as many.
    dose: Dose


def _in_reach(design: Design, copy: int, range_nm: float) -> tuple[int, ...]:
    """Numbers of the other copies whose squares lie within reach of Gaussians up to a range."""
    lattice, copies = lattice_of(design), lens_copies(design)
    here, reach_dbu = lens_copy(design, copy), REACH * range_nm / lattice.database_unit_nm
    sides = [count * period for count, period in zip(lattice.shape[::-1], lattice.period_dbu, strict=True)]
    return tuple(
        number
        for number, other in enumerate(copies, start=1)
        if number != copy
        and abs(other.x_dbu - here.x_dbu) < sides[0] + reach_dbu
        and abs(other.y_dbu - here.y_dbu) < sides[1] + reach_dbu
    )


def read_lenses(
    path: Path,
    design: Design,
    copy: int,
    range_nm: float,
    progress: Progress,
    *,
    together: bool = False,
) -> tuple[tuple[ExposedLens, ...], tuple[ShapesBeside, ...]]:
    """Read a lens of a mask with all that is exposed within reach of the beam, and list the shapes around it.

    Shapes that the design does not draw are left out, with a warning.

    Args:
        path: the mask.
        design: its design.
        copy: number of the lens, from 1; it comes first in the result.
        range_nm: largest range of the beam.
        progress: called while the file is read.
        together: whether all other lenses are read as well; their pillars must be equal.

    Raises:
        InputError: the file holds other shapes than pillars, pillars of dose classes, a lens without pillars, or lenses
            that differ though ``together``; ``process.exposure.with_layers`` names a layer that the design does not
            draw, or a cell of ``mask.include`` cannot be read.
    """
    layer, copies = design.mask.layer, design.mask.copies
    numbers = [copy, *(number for number in range(1, len(copies) + 1) if together and number != copy)]
    reach = {number: _in_reach(design, number, range_nm) if copies else () for number in numbers}
    along = sorted({other for near in reach.values() for other in near} - {copy})
    back = mask.read(path, design, progress=progress, copy=copy, along=along)
    back.require_pillars_alone("their exposure cannot be simulated; `metafab drc` lists their places")
    further = [name for name in back.other_layers if name.split("/")[0] == str(layer)]
    if further or back.datatypes != design.mask.datatypes:
        expected = f"pillars on layer {layer}, datatype {design.mask.datatype} alone"
        got = ", ".join(further) or "those of dose classes, datatypes {} to {}".format(*back.datatypes)
        raise InputError.single(str(path), "layers", expected, got, "expose the mask without dose classes")
    if missing := ", ".join(str(number) for number, shapes in back.other_copies.items() if not shapes):
        remedy = "read the mask with its own design"
        raise InputError.single(str(path), "copies", "pillars in all lenses", f"none in copy {missing}", remedy)
    if together:
        _require_equal(back)
    lenses, listed = [], []
    for number in numbers:
        others = {other: back.pillars if together else back.copies[other] for other in reach[number]}
        beside, shapes = _beside(design, back, number, others, range_nm)
        lenses.append(ExposedLens(back.pillars, beside, copies[number - 1].dose if copies else 1.0, number))
        listed.append(shapes)
    if ignored := [f"{one.shapes} on {one.name}" for one in listed[0] if one.dose == "not the design's"]:
        where = "the dose of shapes of %s that the design does not draw is not counted: %s"
        _log.warning(where, path, ", ".join(ignored))
    return tuple(lenses), listed[0]


def _require_equal(back: ReadBack) -> None:
    """Refuse lenses that differ from the one that is read."""
    pillars, first = back.pillars, list(back.pillars.tiles())
    count = sum(int(np.count_nonzero(tile.size_index)) for tile in first)
    differ = [number for number, shapes in back.other_copies.items() if shapes != count]
    for number, other in back.copies.items():
        tiles = zip(first, other.tiles(), strict=True)
        if not all(np.array_equal(pillars.size_dbu[a.size_index], other.size_dbu[b.size_index]) for a, b in tiles):
            differ.append(number)
    if differ:
        expected, got = "lenses of equal pillars", f"others in copy {', '.join(map(str, sorted(set(differ))))}"
        raise InputError.single(str(back.path), "copies", expected, got, "`metafab drc --copy` lists their places")


def _beside(
    design: Design, back: ReadBack, copy: int, others: Mapping[int, PillarMap], range_nm: float
) -> tuple[Beside | None, tuple[ShapesBeside, ...]]:
    """Shapes exposed in reach of one lens of a mask (None without any), and the list of all beside the lens read.

    ``others`` are the lenses in reach of it.
    """
    unit_nm, copies = design.mask.database_unit_nm, lens_copies(design)
    here = copies[copy - 1]
    listed = [
        ShapesBeside(f"copy {number}", count, "counted" if number in others else "out of reach")
        for number, count in back.other_copies.items()
    ]
    lenses = tuple(
        OtherLens(
            pillars,
            ((copies[number - 1].x_dbu - here.x_dbu) * unit_nm, (copies[number - 1].y_dbu - here.y_dbu) * unit_nm),
            design.mask.copies[number - 1].dose,
            number,
        )
        for number, pillars in others.items()
    )
    lattice = lattice_of(design)
    half_nm = 0.5 * np.array(lattice.shape[::-1]) * lattice.period_nm + REACH * range_nm
    rectangles = [np.empty((0, 4))]
    drawn = _drawn(design, np.array([here.x_dbu, here.y_dbu]))
    for layer, count in back.other_layers.items():
        if layer.endswith(" text"):  # Texts of included cells draw nothing.
            continue
        own = drawn.get(layer, _DrawnLayer())
        if len(own.corners_dbu) != count:
            listed.append(ShapesBeside(f"{layer} {own.description}".strip(), count, "not the design's"))
            continue
        near = np.empty(0, dtype=np.int64)
        if own.is_exposed:
            boxes = np.array([[*each.min(axis=0), *each.max(axis=0)] for each in own.corners_dbu]) * unit_nm
            near = np.flatnonzero((boxes[:, :2] < half_nm).all(axis=1) & (boxes[:, 2:] > -half_nm).all(axis=1))
            rectangles += [strips(own.corners_dbu[number] * unit_nm, _STRIP_NM) for number in near.tolist()]
        kept: Dose = "counted" if near.size else "out of reach"
        listed.append(ShapesBeside(f"{layer} {own.description}", count, kept if own.is_exposed else "first exposure"))
    found = Beside(lenses, np.concatenate(rectangles), Outline.of(design))
    return (found if lenses or len(found.rectangles_nm) else None), tuple(listed)


@dataclass(frozen=True, eq=False)
class _DrawnLayer:
    """Shapes that the design draws beside its lenses, on one layer and datatype."""

    description: str = ""  #: Source of the shapes.
    is_exposed: bool = False  #: Whether the beam writes them with the pillars.
    #: Corners of each shape, (n, 2), database units from the axis of the lens.
    corners_dbu: list[FloatArray] = field(default_factory=list)


def _drawn(design: Design, axis_dbu: FloatArray) -> dict[str, _DrawnLayer]:
    """Shapes that the design draws beside its lenses, by "layer/datatype"."""
    around, cells = shapes_beside(design)
    parts: dict[str, _DrawnLayer] = {}
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for one in around:
        shapes = list(one.rectangles[:, None, :2] + unit * one.rectangles[:, None, 2:] - axis_dbu)
        parts[f"{one.layer}/0"] = _DrawnLayer(one.name, one.exposure == 2, shapes)
    for cell in cells:
        for polygon in cell.polygons:
            name = f"{polygon.layer}/{polygon.datatype}"
            part = parts.setdefault(name, _DrawnLayer(f"included from {cell.file}", True))
            part.corners_dbu.append(polygon.corners - axis_dbu)
    process = None if design.process is None else design.process.exposure
    stated = None if process is None else process.with_layers
    layers = {name: int(name.split("/")[0]) for name in parts}
    if stated is not None and (unknown := sorted(set(stated) - set(layers.values()))):
        known = ", ".join(map(str, sorted(set(layers.values()))))
        expected = f"layers that the design draws beside its lenses: {known or 'it draws none'}"
        raise InputError.single(design.name, "process.exposure.with_layers", expected, ", ".join(map(str, unknown)))
    if stated is None:
        return parts
    return {name: replace(part, is_exposed=layers[name] in stated) for name, part in parts.items()}
