"""Mask of a design: formats, layers and units, the chip around the lens, exposure; and the process that prints it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from metafab.spec.fields import CONFIG, Index, NonNegative, Positive, Real

#: Most dose classes by size or density.
MOST_CLASSES = 32


@dataclass(frozen=True, config=CONFIG)
class Dose:
    """Dose classes on consecutive datatypes, for proximity-effect correction.

    Classes divide evenly the range of the pillars' drawn areas ("size"), or of the pattern density in blocks of side
    ``block_um`` ("density"). Class 0, on ``mask.datatype``, holds the smallest areas or densities. With "proximity" the
    classes are corrected doses, the lowest first; ``metafab expose --correct`` writes such a mask.
    """

    by: Literal["size", "density", "proximity"] = "size"
    classes: Annotated[int, Field(strict=True, ge=2, le=256)] = 4
    block_um: Positive = 20.0

    @model_validator(mode="after")
    def _few_classes(self) -> Dose:
        if self.by != "proximity" and self.classes > MOST_CLASSES:
            raise ValueError(f"`classes` must be at most {MOST_CLASSES} by size or density, got {self.classes}")
        return self


@dataclass(frozen=True, config=CONFIG)
class Chip:
    """Marks, frame, text and dicing street around the lens, each on its own layer (datatype 0).

    The frame surrounds the aperture's bounding square at a distance of ``margin_um``; crosses with arms of ``mark_um``
    stand at its four corners, label and scale bar below the lens, the dicing street outside the frame. A length of 0
    omits a kind.
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
        """Layers of marks, frame, text and street."""
        return self.mark_layer, self.frame_layer, self.text_layer, self.street_layer


@dataclass(frozen=True, config=CONFIG)
class Copy:
    """One of several lenses on a chip, centred at ``at_um`` = (x, y).

    ``bias_nm`` is added to ``mask.bias_nm`` for process variants. The mapping leaves no room for it, so a copy with a
    positive bias may violate the design rules. ``label`` is drawn above the lens, on the text layer of the chip.
    """

    at_um: tuple[Real, Real]
    bias_nm: Real = 0.0
    label: str | None = None


@dataclass(frozen=True, config=CONFIG)
class Exposure:
    """Exposure settings that determine the write time."""

    dose_uc_per_cm2: Positive
    beam_current_na: Positive
    settle_shape_us: NonNegative = 0.0
    settle_field_ms: NonNegative = 0.0


@dataclass(frozen=True, config=CONFIG)
class Mask:
    """Mask files of a design.

    ``formats = []`` writes no mask: PSFs, frames and depths are then simulated from the target phases, as for lenses
    with too many pillars to write.

    ``bias_nm`` is added to the width and length of every drawn pillar, to compensate for the etch; simulated pillars
    have no bias, while gap and feature rules hold for drawn shapes. ``tone`` "negative": the drawn pillars are exposed
    and remain. "positive": the write field is also drawn, on ``field_layer``, and field NOT pillars is exposed.
    "inverted": field NOT pillars is drawn on ``field_layer`` as rectangles, five times as many shapes. ``flat`` puts
    every rectangle into the top cell, for software without cells; such files open far more slowly. The unit cell's
    ``corner_radius_nm`` describes printed pillars and is not drawn unless ``draw_corners`` is set.
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


@dataclass(frozen=True, config=CONFIG)
class BeamTerm:
    """One term of the beam's point-spread function; ``exponent`` belongs to a power law."""

    kind: Literal["gauss", "power"]
    weight: Positive
    range_nm: Positive
    exponent: Annotated[float, Field(strict=True, gt=2.0, le=20.0)] | None = None

    @model_validator(mode="after")
    def _exponent_of_power(self) -> BeamTerm:
        if (self.kind == "power") != (self.exponent is not None):
            raise ValueError("`exponent` must be given for a power law, and only for it")
        return self


@dataclass(frozen=True, config=CONFIG)
class ExposureProcess:
    """Electron-beam exposure (``[process.exposure]``).

    The beam's point-spread function is a ``preset``, a list of ``terms``, or a ``table_file``: a text file with radius
    and energy in each row, as Monte Carlo and proximity-correction programs write it. Its radius is in ``table_unit``,
    by default the unit in its header; ``table_energy`` tells an energy density from the energy of each ring between
    one radius and the next. ``blur_nm`` is the range of a further Gaussian blur: beam, secondary electrons, diffusion.
    ``base_over_clearing_dose`` is the base dose over the clearing dose of a large pad; by default
    the dose at which printed sizes equal drawn ones in the mean. ``classes`` is the number of doses that a correction
    may use. ``source`` is the reference of the numbers.
    """

    preset: str | None = None
    terms: tuple[BeamTerm, ...] = ()
    table_file: Path | None = None
    table_unit: Literal["nm", "um"] | None = None
    table_energy: Literal["density", "ring"] = "density"
    blur_nm: NonNegative = 5.0
    base_over_clearing_dose: Positive | None = None
    classes: Annotated[int, Field(strict=True, ge=2, le=256)] = 64
    source: str = "assumption"

    @model_validator(mode="after")
    def _one_function(self) -> ExposureProcess:
        if (self.preset is not None) + bool(self.terms) + (self.table_file is not None) != 1:
            raise ValueError("give one of `preset`, `terms` and `table_file`")
        if self.table_file is None and (self.table_unit is not None or self.table_energy != "density"):
            raise ValueError("`table_unit` and `table_energy` belong to `table_file`")
        return self


@dataclass(frozen=True, config=CONFIG)
class Process:
    """Fabrication process (``[process]``)."""

    exposure: ExposureProcess | None = None
