"""Mask of a design: formats, layers and units, the chip around the lens, exposure; and the process that prints it."""

from __future__ import annotations

import re
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from metafab.spec.cell import SidewallAngle
from metafab.spec.fields import CONFIG, Flag, Index, NonNegative, Positive, Real

#: Most dose classes by size or density.
MOST_CLASSES = 32


@dataclass(frozen=True, config=CONFIG)
class Dose:
    """Dose classes on consecutive datatypes. By size or density, classes divide the range of the values evenly."""

    by: Literal["size", "density", "proximity"] = "size"
    """What decides a pillar's class: its drawn area, the pattern density around it, or the dose corrected for proximity
    (`metafab expose --correct`)."""
    classes: Annotated[int, Field(strict=True, ge=2, le=256)] = 4
    """Number of classes; class 0, on `mask.datatype`, holds the smallest areas, densities or doses."""
    block_um: Positive = 20.0
    """Side of the blocks in which density is counted."""

    @model_validator(mode="after")
    def _few_classes(self) -> Dose:
        if self.by != "proximity" and self.classes > MOST_CLASSES:
            raise ValueError(f"`classes` must be at most {MOST_CLASSES} by size or density, got {self.classes}")
        return self


@dataclass(frozen=True, config=CONFIG)
class Chip:
    """Marks, frame, text and dicing street around the lens, each on its own layer (datatype 0)."""

    margin_um: Positive = 100.0
    """Distance of the frame from the aperture's bounding square."""
    mark_um: NonNegative = 60.0
    """Length of the crosses' arms at the four corners; 0 draws none."""
    mark_line_um: Positive = 4.0
    """Line width of the crosses."""
    frame_um: NonNegative = 10.0
    """Width of the frame; 0 draws none."""
    street_um: NonNegative = 100.0
    """Width of the dicing street outside the frame; 0 draws none."""
    label: str | None = None
    """Text below the lens."""
    text_um: Positive = 40.0
    """Height of texts."""
    scale_bar_um: NonNegative = 100.0
    """Length of the scale bar; 0 draws none."""
    mark_layer: Index = 10
    """Layer of the crosses."""
    frame_layer: Index = 11
    """Layer of the frame."""
    text_layer: Index = 12
    """Layer of texts and scale bar."""
    street_layer: Index = 13
    """Layer of the dicing street."""

    @property
    def layers(self) -> tuple[int, ...]:
        """Layers of marks, frame, text and street."""
        return self.mark_layer, self.frame_layer, self.text_layer, self.street_layer


@dataclass(frozen=True, config=CONFIG)
class Copy:
    """One of several lenses on a chip, for process variants."""

    at_um: tuple[Real, Real]
    """Centre (x, y) of the lens."""
    bias_nm: Real = 0.0
    """Added to `mask.bias_nm`; the mapping leaves no room for it, and one that breaks a design rule is refused."""
    label: str | None = None
    """Text above the lens, on the chip's text layer."""


@dataclass(frozen=True, config=CONFIG)
class Include:
    """A cell of another file, drawn beside the lenses (``[[mask.include]]``)."""

    file: Path
    """GDSII or OASIS file."""
    cell: str | None = None
    """Name of the cell; without the key the only top cell."""
    at_um: tuple[Real, Real] = (0.0, 0.0)
    """Place (x, y) of the cell's origin."""
    layers: dict[str, str] = field(default_factory=dict)
    """New "layer/datatype" of each "layer/datatype" of the file; others keep theirs."""

    @model_validator(mode="after")
    def _pairs(self) -> Include:
        for pair in (*self.layers, *self.layers.values()):
            if not re.fullmatch(r"\d{1,5}/\d{1,5}", pair):
                raise ValueError(f'`layers` must name each layer as "layer/datatype", got {pair!r}')
        return self


@dataclass(frozen=True, config=CONFIG)
class Exposure:
    """Exposure settings that determine the write time."""

    dose_uc_per_cm2: Positive
    """Areal dose."""
    beam_current_na: Positive
    """Beam current."""
    settle_shape_us: NonNegative = 0.0
    """Settling time of each shape."""
    settle_field_ms: NonNegative = 0.0
    """Settling time of each write field."""


@dataclass(frozen=True, config=CONFIG)
class Mask:
    """Mask files of a design. Simulated pillars have no bias; gap and feature rules hold for drawn shapes."""

    formats: tuple[Literal["gds", "oas"], ...] = ("gds", "oas")
    """Files to write; [] writes no mask, and the target phases are simulated."""
    layer: Index = 1
    """Layer of the pillars."""
    datatype: Index = 0
    """Datatype of the pillars; the first one of dose classes."""
    database_unit_nm: Annotated[float, Field(strict=True, gt=0.0, le=1000.0)] = 0.5
    """Database unit; pillars of odd width on an even period need half a nanometre."""
    write_field_um: Positive = 499.8
    """Side of a write field: a whole number of periods."""
    bias_nm: Real = 0.0
    """Added to width and length of every drawn pillar, to compensate for the etch."""
    tone: Literal["negative", "positive", "inverted"] = "negative"
    """"negative": the drawn pillars are exposed and remain. "positive": the write field is also drawn, and field NOT
    pillars is exposed. "inverted": field NOT pillars is drawn as rectangles."""
    field_layer: Index = 2
    """Layer of the write field."""
    flat: Flag = False
    """Put every rectangle into the top cell, for software without cells; such files open far more slowly."""
    draw_corners: Flag = False
    """Draw the unit cell's `corner_radius_nm`, which otherwise describes printed pillars only."""
    dose: Dose | None = None
    """Dose classes on consecutive datatypes; one dose without the table."""
    chip: Chip | None = None
    """Marks, frame, text and dicing street; the lens alone without the table."""
    copies: tuple[Copy, ...] = ()
    """Several lenses on the chip; one in the middle without them."""
    include: tuple[Include, ...] = ()
    """Cells of other files on the chip: marks, logos, test structures."""
    exposure: Exposure | None = None
    """Exposure settings; no write time is estimated without the table."""

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
    """One term of the beam's point-spread function."""

    kind: Literal["gauss", "power"]
    """Gaussian or power law."""
    weight: Positive
    """Weight relative to the other terms."""
    range_nm: Positive
    """Range of the term."""
    exponent: Annotated[float, Field(strict=True, gt=2.0, le=20.0)] | None = None
    """Exponent of a power law."""

    @model_validator(mode="after")
    def _exponent_of_power(self) -> BeamTerm:
        if (self.kind == "power") != (self.exponent is not None):
            raise ValueError("`exponent` must be given for a power law, and only for it")
        return self


@dataclass(frozen=True, config=CONFIG)
class ExposureProcess:
    """Electron-beam exposure (``[process.exposure]``): the beam as a preset, as terms, or as a table."""

    preset: str | None = None
    """Name of a supplied point-spread function of the beam."""
    terms: tuple[BeamTerm, ...] = ()
    """The beam's point-spread function as a sum of terms."""
    table_file: Path | None = None
    """The beam's point-spread function as a text file with radius and energy in each row, as Monte Carlo and proximity-
    correction programs write it."""
    table_unit: Literal["nm", "um"] | None = None
    """Unit of the table's radius; without the key that in its header."""
    table_energy: Literal["density", "ring"] = "density"
    """Whether the table holds an energy density, or the energy of each ring between one radius and the next."""
    blur_nm: NonNegative = 5.0
    """Range of a further Gaussian blur: beam, secondary electrons, diffusion."""
    base_over_clearing_dose: Positive | None = None
    """Base dose over the clearing dose of a large pad; without the key that at which printed sizes equal drawn ones in
    the mean."""
    correction: Literal["dose", "shape"] = "dose"
    """Whether a correction gives each pillar one of some doses, or changes the drawn sizes, for tools with one dose."""
    classes: Annotated[int, Field(strict=True, ge=2, le=256)] = 64
    """Number of doses that a correction may use."""
    source: str = "assumption"
    """Reference of the numbers."""

    @model_validator(mode="after")
    def _one_function(self) -> ExposureProcess:
        if (self.preset is not None) + bool(self.terms) + (self.table_file is not None) != 1:
            raise ValueError("give one of `preset`, `terms` and `table_file`")
        if self.table_file is None and (self.table_unit is not None or self.table_energy != "density"):
            raise ValueError("`table_unit` and `table_energy` belong to `table_file`")
        return self


@dataclass(frozen=True, config=CONFIG)
class Etch:
    """Dry etch (``[process.etch]``): made less printed pillars."""

    bias_nm: Real = 0.0
    """Change of width and length at the mean density."""
    microloading_nm: Real = 0.0
    """Further change where the local density is larger by 1."""
    microloading_range_um: Positive = 50.0
    """Range of the Gaussian that averages the density."""
    height_nm: Positive | None = None
    """Height of the made pillar; without the key the unit cell's."""
    sidewall_angle_deg: SidewallAngle | None = None
    """Angle of the made sidewalls; without the key the unit cell's."""
    corner_radius_nm: NonNegative | None = None
    """Radius of the made corners; without the key that of the printed ones."""
    source: str = "assumption"
    """Reference of the numbers."""

    @property
    def corner(self) -> dict[str, float]:
        """Axes of the cell that differ from the unit cell's, by the names of a library's axes."""
        axes = {name: getattr(self, name) for name in ("height_nm", "sidewall_angle_deg", "corner_radius_nm")}
        return {name: value for name, value in axes.items() if value is not None}


@dataclass(frozen=True, config=CONFIG)
class Process:
    """Fabrication process (``[process]``)."""

    exposure: ExposureProcess | None = None
    """Electron-beam exposure."""
    etch: Etch | None = None
    """Dry etch; without the table the printed pillars remain as they are."""
