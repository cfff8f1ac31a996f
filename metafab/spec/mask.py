"""The mask file: formats, layers and units, what surrounds the lens, and how the shop exposes it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from metafab.spec.fields import CONFIG, Index, NonNegative, Positive, Real


@dataclass(frozen=True, config=CONFIG)
class Dose:
    """Dose classes on consecutive datatypes, ready for proximity-effect correction.

    Class 0, on ``mask.datatype``, holds the smallest pillars ("size": by drawn area) or the emptiest surroundings
    ("density": covered share of the ``block_um`` wide block around the pillar); the classes divide the range evenly.
    """

    by: Literal["size", "density"] = "size"
    classes: Annotated[int, Field(strict=True, ge=2, le=32)] = 4
    block_um: Positive = 20.0


@dataclass(frozen=True, config=CONFIG)
class Chip:
    """What is drawn around the lens, each kind on a layer of its own, datatype 0; a length of 0 leaves a kind out.

    ``margin_um`` lies between the square that bounds the aperture and the frame; crosses of arms ``mark_um`` stand
    at its four corners, the label and the scale bar below the lens, and the dicing street outside the frame.
    """

    margin_um: Positive = 100.0
    mark_um: NonNegative = 60.0
    mark_line_um: Positive = 4.0
    frame_um: NonNegative = 10.0
    street_um: NonNegative = 100.0
    label: str | None = None
    text_um: Positive = 40.0
    scale_bar_um: NonNegative = 100.0
    mark_layer: Index = 10
    frame_layer: Index = 11
    text_layer: Index = 12
    street_layer: Index = 13

    @property
    def layers(self) -> tuple[int, ...]:
        """All of its layers."""
        return self.mark_layer, self.frame_layer, self.text_layer, self.street_layer


@dataclass(frozen=True, config=CONFIG)
class Copy:
    """One lens of several on a chip, centred at ``at_um`` = (x, y).

    ``bias_nm`` is added to ``mask.bias_nm``, for corner variants: the mapping does not leave room for it, so that
    design rules may not hold for a wider copy. ``label`` is drawn above the lens, on the text layer of the chip.
    """

    at_um: tuple[Real, Real]
    bias_nm: Real = 0.0
    label: str | None = None


@dataclass(frozen=True, config=CONFIG)
class Exposure:
    """What the write time follows from: area dose, beam current, and settling for each shape and write field."""

    dose_uc_per_cm2: Positive
    beam_current_na: Positive
    settle_shape_us: NonNegative = 0.0
    settle_field_ms: NonNegative = 0.0


@dataclass(frozen=True, config=CONFIG)
class Mask:
    """How the layout is written; with ``formats = []`` it is not.

    A design without a mask ends at its target phases: PSFs, frames and depths are those of a perfect lens. So lenses
    can be judged whose pillars are too many to write.

    ``bias_nm`` is added to the width and length of every drawn pillar (etch compensation); pillars stand without it,
    while the gap and feature rules hold for what is drawn. ``tone`` "negative" exposes what stays; "positive" adds
    the write field on ``field_layer``, and the shop exposes field NOT pillars; "inverted" draws that very difference on
    ``field_layer`` in rectangles, five times as many shapes. ``flat`` puts every rectangle into the top cell, for
    software that knows no cells; such files open far more slowly. The unit cell's ``corner_radius_nm`` is what exposure
    and etch do to rectangles, unless ``draw_corners`` has the mask draw it.
    """

    formats: tuple[Literal["gds", "oas"], ...] = ("gds", "oas")
    layer: Index = 1
    datatype: Index = 0
    database_unit_nm: Annotated[float, Field(strict=True, gt=0.0, le=1000.0)] = 0.5
    write_field_um: Positive = 499.8
    bias_nm: Real = 0.0
    tone: Literal["negative", "positive", "inverted"] = "negative"
    field_layer: Index = 2
    flat: bool = False
    draw_corners: bool = False
    dose: Annotated[Dose | None, Field(description="omitted: one dose")] = None
    chip: Annotated[Chip | None, Field(description="omitted: the lens alone")] = None
    copies: Annotated[tuple[Copy, ...], Field(description="omitted: one lens in the middle")] = ()
    exposure: Annotated[Exposure | None, Field(description="omitted: no write time is estimated")] = None

    @property
    def datatypes(self) -> tuple[int, int]:
        """First and last datatype of the pillars: one, or one for each dose class."""
        return self.datatype, self.datatype + (0 if self.dose is None else self.dose.classes - 1)

    @model_validator(mode="after")
    def _formats(self) -> Mask:
        if len(set(self.formats)) != len(self.formats):
            raise ValueError("`formats` must name each of 'gds' and 'oas' at most once; [] writes no mask")
        return self

    @model_validator(mode="after")
    def _labels(self) -> Mask:
        if self.chip is None and any(copy.label is not None for copy in self.copies):
            raise ValueError("labels of `copies` need [mask.chip], which says their size and layer")
        return self

    @model_validator(mode="after")
    def _layers(self) -> Mask:
        used = [self.layer, *((self.field_layer,) if self.tone != "negative" else ())]
        used += self.chip.layers if self.chip is not None else ()
        if len(set(used)) != len(used):
            raise ValueError(f"pillars, field, marks, frame, text and street need layers of their own, got {used}")
        return self
