"""The chip around a lens: dose classes, marks, frame and text, further lenses, cells of other files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from metafab.spec.fields import Checked, Flag, Index, NonNegative, Positive, Real, spec

#: Most dose classes by size or density.
MOST_CLASSES = 32
#: Largest layer and datatype: 16 bits.
_LARGEST_LAYER = 65535


@spec()
class Dose(Checked):
    """Dose classes on consecutive datatypes. By size or density, classes divide the range of the values evenly."""

    #: Quantity that decides a pillar's class: its drawn area, the pattern density around it, or the dose corrected for
    #: proximity (`metafab expose --correct`).
    by: Literal["size", "density", "proximity"] = "size"
    #: Number of classes, at most 32 by size or density; class 0, on `mask.datatype`, holds the smallest areas,
    #: densities or doses.
    classes: Annotated[int, Field(strict=True, ge=2, le=256)] = 4
    block_um: Positive = 20.0  #: Side of the blocks in which density is counted.

    def _faults(self) -> Iterator[str]:
        if self.by != "proximity" and self.classes > MOST_CLASSES:
            yield f"`classes` must be at most {MOST_CLASSES} by size or density, got {self.classes}"


@spec()
class Chip:
    """Marks, frame, text and dicing street around the lens, each on its own layer (datatype 0)."""

    margin_um: Positive = 100.0  #: Distance of the frame from the aperture's bounding square.
    mark_um: NonNegative = 60.0  #: Length of the crosses' arms at the four corners; 0 draws none.
    mark_line_um: Positive = 4.0  #: Line width of the crosses.
    frame_um: NonNegative = 10.0  #: Width of the frame; 0 draws none.
    street_um: NonNegative = 100.0  #: Width of the dicing street outside the frame; 0 draws none.
    label: str | None = None  #: Text below the lens.
    text_um: NonNegative = 40.0  #: Height of texts; 0 draws neither texts nor scale bar.
    scale_bar_um: NonNegative = 100.0  #: Length of the scale bar; 0 draws none.
    mark_layer: Index = 10  #: Layer of the crosses.
    frame_layer: Index = 11  #: Layer of the frame.
    text_layer: Index = 12  #: Layer of texts and scale bar.
    street_layer: Index = 13  #: Layer of the dicing street.

    @property
    def layers(self) -> tuple[int, ...]:
        """Layers of marks, frame, text and street."""
        return self.mark_layer, self.frame_layer, self.text_layer, self.street_layer


@spec()
class Copy:
    """One of several lenses on a chip, for process variants."""

    at_um: tuple[Real, Real]  #: Centre (x, y) of the lens.
    #: Added to `mask.bias_nm`. The mapping keeps gaps without it; a bias that breaks a design rule is refused.
    bias_nm: Real = 0.0
    dose: Positive = 1.0  #: Dose relative to the base dose; each distinct dose has datatypes of its own.
    #: Focus of the beam above the resist's surface; listed for the writer, and widens the blur of printed pillars.
    focus_um: Real = 0.0
    label: str | None = None  #: Text above the lens, on the chip's text layer.


@spec()
class Include(Checked):
    """A cell of another file, drawn beside the lenses (``[[mask.include]]``)."""

    file: Path  #: GDSII or OASIS file.
    cell: str | None = None  #: Name of the cell; without the key the only top cell.
    at_um: tuple[Real, Real] = (0.0, 0.0)  #: Place (x, y) of the cell's origin.
    #: New "layer/datatype" of each "layer/datatype" of the file; others keep theirs.
    layers: dict[str, str] = field(default_factory=dict)
    #: Whether shapes may lie beyond frame and dicing street, as marks of the wafer do.
    beyond_street: Flag = False

    def _faults(self) -> Iterator[str]:
        for pair in (*self.layers, *self.layers.values()):
            if not re.fullmatch(r"\d{1,5}/\d{1,5}", pair) or max(map(int, pair.split("/"))) > _LARGEST_LAYER:
                yield f'`layers` must name each layer as "layer/datatype", of at most {_LARGEST_LAYER}, got {pair!r}'
