"""Mask files of a design: formats, layers, units, bias, tone, and the exposure that writes them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from metafab.spec.fields import Checked, Flag, Index, NonNegative, Positive, Real, spec
from metafab.spec.mask.chip import Chip, Copy, Dose, Include
from metafab.spec.mask.kit import Kit

#: Most datatypes of one layer.
MOST_DATATYPES = 256


@spec()
class Exposure(Checked):
    """Exposure settings that determine the write time."""

    dose_uc_per_cm2: Positive  #: Areal dose.
    beam_current_na: Positive  #: Beam current.
    settle_shape_us: NonNegative = 0.0  #: Settling time of each shape.
    settle_field_ms: NonNegative = 0.0  #: Settling time of each write field.
    #: Distance between the beam's places within a shape (Gaussian beam); no shots are counted without the key.
    shot_pitch_nm: Positive | None = None
    clock_mhz: Positive | None = None  #: Largest rate of shots; without the key the current alone limits the time.
    #: Largest side of a shot of a shaped beam; larger trapezoids are several shots.
    max_shot_um: Positive | None = None
    #: Order of the write fields of a lens: "rows" all from left to right, "serpentine" to and fro, "spiral" from the
    #: middle outwards, "inwards" the reverse, so that the middle is written last, when a drift has settled.
    field_order: Literal["rows", "serpentine", "spiral", "inwards"] = "serpentine"
    drift_nm_per_min: NonNegative = 0.0  #: Drift of the stage or the sample while it is written.

    def _faults(self) -> Iterator[str]:
        if self.max_shot_um is not None and self.shot_pitch_nm is not None:
            yield "give `shot_pitch_nm` for a Gaussian beam or `max_shot_um` for a shaped one, not both"
        if self.clock_mhz is not None and self.max_shot_um is None and self.shot_pitch_nm is None:
            yield "`clock_mhz` needs `shot_pitch_nm` or `max_shot_um`, which give the number of shots"


@spec()
class Mask(Checked):
    """Mask files of a design. Simulated pillars have no bias; gap and feature rules hold for drawn shapes."""

    #: Files to write; [] writes no mask, and the target phases are simulated.
    formats: tuple[Literal["gds", "oas"], ...] = ("gds", "oas")
    layer: Index = 1  #: Layer of the pillars.
    datatype: Index = 0  #: Datatype of the pillars; the first one of dose classes.
    #: Database unit; pillars of odd width on an even period need half a nanometre.
    database_unit_nm: Annotated[float, Field(strict=True, gt=0.0, le=1000.0)] = 0.5
    write_field_um: Positive = 499.8  #: Side of a write field: a whole number of periods.
    bias_nm: Real = 0.0  #: Added to width and length of every drawn pillar, to compensate for the etch.
    #: "negative": the drawn pillars are exposed and remain. "positive": the write field is also drawn, and field NOT
    #: pillars is exposed. "inverted": field NOT pillars is drawn as rectangles.
    tone: Literal["negative", "positive", "inverted"] = "negative"
    field_layer: Index = 2  #: Layer of the write field.
    #: Put every rectangle into the top cell, for software without cells; such files open far more slowly.
    flat: Flag = False
    #: Draw the unit cell's `corner_radius_nm`, which otherwise describes printed pillars only.
    draw_corners: Flag = False
    dose: Dose | None = None  #: Dose classes on consecutive datatypes; one dose without the table.
    chip: Chip | None = None  #: Marks, frame, text and dicing street; the lens alone without the table.
    copies: tuple[Copy, ...] = ()  #: Several lenses on the chip; one in the middle without them.
    include: tuple[Include, ...] = ()  #: Cells of other files on the chip: marks, logos, test structures.
    kit: Kit | None = None  #: Test structures beside the lenses; none without the table.
    exposure: Exposure | None = None  #: Exposure settings; no write time is estimated without the table.

    @property
    def doses(self) -> tuple[float, ...]:
        """Distinct doses of the copies relative to the base dose, ascending."""
        return tuple(sorted({copy.dose for copy in self.copies})) or (1.0,)

    @property
    def dose_classes(self) -> int:
        """Number of dose classes within a lens."""
        return 1 if self.dose is None else self.dose.classes

    @property
    def datatypes(self) -> tuple[int, int]:
        """First and last datatype of the pillars: one for each dose class, for each dose of the copies in turn."""
        return self.datatype, self.datatype + len(self.doses) * self.dose_classes - 1

    def _faults(self) -> Iterator[str]:
        if len(self.doses) > 1 and self.tone != "negative":
            yield 'copies with different `dose` need `tone = "negative"`, where the pillars are exposed'
        if self.exposure is not None and self.exposure.max_shot_um is not None and self.tone != "negative":
            yield '`exposure.max_shot_um` needs `tone = "negative"`; shots of the field are not counted'
        if len(self.doses) * self.dose_classes > MOST_DATATYPES:
            yield (
                f"doses of `copies` times dose classes must be at most {MOST_DATATYPES}, "
                f"got {len(self.doses)} x {self.dose_classes}"
            )
        if len(set(self.formats)) != len(self.formats):
            yield "`formats` must name each of 'gds' and 'oas' at most once; [] writes no mask"
        if self.chip is None and any(copy.label is not None for copy in self.copies):
            yield "labels of `copies` need [mask.chip], which sets their size and layer"
        used = [self.layer, *((self.field_layer,) if self.tone != "negative" else ())]
        used += self.chip.layers if self.chip is not None else ()
        used += self.kit.layers if self.kit is not None else ()
        if len(set(used)) != len(used):
            yield f"pillars, field, marks, frame, text, street and kit need layers of their own, got {used}"
