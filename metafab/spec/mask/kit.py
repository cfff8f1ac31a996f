"""Test structures beside the lenses, for microscopes, ellipsometers and the alignment of two exposures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from metafab.spec.fields import Checked, Index, NonNegative, Positive, Real, spec

_Odd = Annotated[int, Field(strict=True, ge=3, le=999)]


@spec()
class CdBars:
    """Bars whose widths are measured with an electron microscope, along both axes.

    For each width there is a dense group, whose gaps are as wide as its bars, and one bar by itself.
    """

    at_um: tuple[Real, Real]  #: Centre (x, y).
    width_nm: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=50)]  #: Widths of the bars.
    length_um: Positive = 10.0  #: Length of the bars.
    lines: _Odd = 5  #: Bars of a dense group.
    spacing_um: Positive = 5.0  #: Distance between groups, and of a single bar from its group.


@spec()
class Vernier(Checked):
    """Two combs of slightly different pitch, along both axes, read with a microscope."""

    at_um: tuple[Real, Real]  #: Centre (x, y).
    pitch_um: Positive = 4.0  #: Pitch of the first comb.
    step_nm: Positive = 20.0  #: Difference of the pitches, which is the resolution.
    #: Teeth of each comb, an odd number; the middle ones, which face each other without a shift, are longer.
    teeth: Annotated[int, Field(strict=True, ge=3, le=199)] = 21
    tooth_um: tuple[Positive, Positive] = (1.0, 10.0)  #: Width and length of a tooth.
    #: "both": the first comb belongs to the first exposure, so that the shift between two exposures is read. "second":
    #: both are written with the pillars, so that the stitching of fields is read.
    levels: Literal["both", "second"] = "both"

    def _faults(self) -> Iterator[str]:
        if self.teeth % 2 == 0:
            yield f"`teeth` must be odd, got {self.teeth}"
        if self.tooth_um[0] >= self.pitch_um:
            yield "`tooth_um` must be narrower than `pitch_um`"


@spec()
class Grating(Checked):
    """A field of lines or of equal pillars, for ellipsometry and scatterometry."""

    at_um: tuple[Real, Real]  #: Centre (x, y).
    #: Period along x; with a second value also along y.
    pitch_nm: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=2)]
    #: Width of lines along y; with two values, width and length of pillars.
    line_nm: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=2)]
    size_um: tuple[Positive, Positive] = (50.0, 50.0)  #: Sides of the field; whole periods that fit are drawn.

    def _faults(self) -> Iterator[str]:
        if len(self.pitch_nm) != len(self.line_nm):
            yield "`pitch_nm` and `line_nm` need equally many values: one for lines, two for pillars"
        if any(line >= pitch for line, pitch in zip(self.line_nm, self.pitch_nm, strict=True)):
            yield "`line_nm` must be smaller than `pitch_nm`"


@spec()
class Overlay(Checked):
    """A frame of the first exposure around a frame of the second, for overlay measurements."""

    at_um: tuple[Real, Real]  #: Centre (x, y).
    outer_um: Positive = 20.0  #: Outer side of the outer frame.
    inner_um: Positive = 10.0  #: Outer side of the inner frame.
    line_um: Positive = 2.0  #: Width of both frames' lines.

    def _faults(self) -> Iterator[str]:
        if not 2.0 * self.line_um < self.inner_um < self.outer_um - 2.0 * self.line_um:
            yield "`inner_um` must be more than two lines, and less than `outer_um` without its two lines"


@spec()
class Kit(Checked):
    """Test structures (``[mask.kit]``), each on datatype 0 of the layers below.

    Marks of ``[mask.chip]`` and the shapes on `first_layer` belong to the first exposure, all others to the second.
    """

    cd_bars: tuple[CdBars, ...] = ()  #: Bars for size measurements.
    verniers: tuple[Vernier, ...] = ()  #: Verniers.
    gratings: tuple[Grating, ...] = ()  #: Fields of lines or pillars.
    overlays: tuple[Overlay, ...] = ()  #: Overlay marks.
    distance_um: NonNegative = 2.0  #: Smallest distance of a structure from lenses, marks, texts and other structures.
    layer: Index = 15  #: Layer of structures that are written with the pillars.
    first_layer: Index = 14  #: Layer of structures of the first exposure.
    #: Margin of windows around the marks of the first exposure, on `clear_layer`; 0 draws none.
    clear_um: NonNegative = 0.0
    clear_layer: Index = 16  #: Layer of the windows.

    def _faults(self) -> Iterator[str]:
        if self.clear_um and self.clear_um >= self.distance_um:
            yield "`clear_um` must be less than `distance_um`, so that windows touch nothing"

    @property
    def layers(self) -> tuple[int, ...]:
        """Layers of the structures, and of the windows if there are any."""
        return self.layer, self.first_layer, *((self.clear_layer,) if self.clear_um else ())
