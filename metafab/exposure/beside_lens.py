"""What a written mask holds beside one of its lenses, and how much of it is exposed with the lens.

Other copies are read from the file. Frame, text, test structures and included cells are those of the design; the file
gives the number of shapes on their layers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.exposure.energy.beside import Beside, OtherLens
from metafab.exposure.energy.far import REACH
from metafab.exposure.energy.shapes import strips
from metafab.layout import Outline, lattice_of
from metafab.mask import ReadBack, shapes_beside
from metafab.mask.drawing.copies import lens_copies, lens_copy
from metafab.spec import Design

Dose = Literal["counted", "out of reach", "first exposure", "not the design's"]

#: Height of the strips of inclined sides (nm).
_STRIP_NM = 50.0


@dataclass(frozen=True)
class ShapesBeside:
    """Shapes of a mask beside the lens: another copy, or a layer."""

    name: str  #: The copy, or the layer and what it holds.
    shapes: int  #: Number of shapes in the file.
    #: Whether their dose is counted; they are left out where no Gaussian reaches the lens, where the first exposure
    #: writes them, and where the design does not draw as many.
    dose: Dose


def copies_in_reach(design: Design, copy: int, range_nm: float) -> tuple[int, ...]:
    """Return the numbers of the other copies whose squares lie within reach of Gaussians up to a range.

    InputError if the design has no such copy.
    """
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


def beside_lens(
    design: Design, back: ReadBack, copy: int, range_nm: float
) -> tuple[Beside | None, tuple[ShapesBeside, ...]]:
    """Return what is exposed in reach of one lens of a mask (None for nothing), and a list of all beside the lens.

    Args:
        design: the chip.
        back: its mask, with the copies of :func:`copies_in_reach`.
        copy: the lens, counted from 1.
        range_nm: largest range of the beam.

    Raises:
        InputError: ``process.exposure.with_layers`` names a layer that the design does not draw, or a cell of
            ``mask.include`` cannot be read.
    """
    unit_nm, copies = design.mask.database_unit_nm, lens_copies(design)
    here = copies[copy - 1]
    listed = [
        ShapesBeside(f"copy {number}", count, "counted" if number in back.copies else "out of reach")
        for number, count in back.other_copies.items()
    ]
    lenses = tuple(
        OtherLens(
            pillars,
            ((copies[number - 1].x_dbu - here.x_dbu) * unit_nm, (copies[number - 1].y_dbu - here.y_dbu) * unit_nm),
            design.mask.copies[number - 1].dose,
        )
        for number, pillars in back.copies.items()
    )
    lattice = lattice_of(design)
    half_nm = 0.5 * np.array(lattice.shape[::-1]) * lattice.period_nm + REACH * range_nm
    rectangles = [np.empty((0, 4))]
    drawn = dict(_drawn(design, np.array([here.x_dbu, here.y_dbu])))
    for layer, count in back.other_layers.items():
        if layer.endswith(" text"):  # Texts of included cells draw nothing.
            continue
        name, exposed, parts = drawn.pop(layer, ("", False, []))
        if len(parts) != count:
            listed.append(ShapesBeside(f"{layer} {name}".strip(), count, "not the design's"))
            continue
        near = np.empty(0, dtype=np.int64)
        if exposed:
            boxes = np.array([[*part.min(axis=0), *part.max(axis=0)] for part in parts]) * unit_nm
            near = np.flatnonzero((boxes[:, :2] < half_nm).all(axis=1) & (boxes[:, 2:] > -half_nm).all(axis=1))
            rectangles += [strips(parts[number] * unit_nm, _STRIP_NM) for number in near.tolist()]
        kept: Dose = "counted" if near.size else "out of reach"
        listed.append(ShapesBeside(f"{layer} {name}", count, kept if exposed else "first exposure"))
    found = Beside(lenses, np.concatenate(rectangles), Outline.of(design))
    return (found if lenses or len(found.rectangles_nm) else None), tuple(listed)


def _drawn(design: Design, axis_dbu: FloatArray) -> Iterator[tuple[str, tuple[str, bool, list[FloatArray]]]]:
    """For each "layer/datatype": description, whether the beam writes it with the pillars, and corners of its shapes.

    Corners have the shape (n, 2), in database units from the axis of the lens.
    """
    around, cells = shapes_beside(design)
    parts: dict[str, tuple[str, bool, list[FloatArray]]] = {}
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for one in around:
        shapes = list(one.rectangles[:, None, :2] + unit * one.rectangles[:, None, 2:] - axis_dbu)
        parts[f"{one.layer}/0"] = (one.name, one.exposure == 2, shapes)
    for cell in cells:
        for polygon in cell.polygons:
            name = f"{polygon.layer}/{polygon.datatype}"
            parts.setdefault(name, (f"included from {cell.file}", True, []))[2].append(polygon.corners - axis_dbu)
    process = None if design.process is None else design.process.exposure
    stated = None if process is None else process.with_layers
    layers = {name: int(name.split("/")[0]) for name in parts}
    if stated is not None and (unknown := sorted(set(stated) - set(layers.values()))):
        known = ", ".join(map(str, sorted(set(layers.values()))))
        expected = f"layers that the design draws beside its lenses: {known or 'it draws none'}"
        raise InputError.single(design.name, "process.exposure.with_layers", expected, ", ".join(map(str, unknown)))
    for name, (description, exposed, shapes) in parts.items():
        yield name, (description, exposed if stated is None else layers[name] in stated, shapes)
