"""Fabrication process: the beam that exposes the resist, and the etch."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from metafab.spec.cell import SidewallAngle
from metafab.spec.fields import Checked, Index, NonNegative, Positive, Real, spec


@spec()
class BeamTerm(Checked):
    """One term of the beam's point-spread function."""

    kind: Literal["gauss", "power"]  #: Gaussian or power law.
    weight: Real  #: Weight relative to the other terms; Gaussians with a negative one subtract.
    range_nm: Positive  #: Range of the term.
    exponent: Annotated[float, Field(strict=True, gt=2.0, le=20.0)] | None = None  #: Exponent of a power law.

    def _faults(self) -> Iterator[str]:
        if self.weight == 0.0 or (self.weight < 0.0 and self.kind == "power"):
            yield f"`weight` must not be 0, and positive for a power law, got {self.weight:g}"
        if (self.kind == "power") != (self.exponent is not None):
            yield "`exponent` must be given for a power law, and only for it"


@spec()
class ExposureProcess(Checked):
    """Electron-beam exposure (``[process.exposure]``): the beam as a preset, as terms, or as a table."""

    preset: str | None = None  #: Name of a supplied point-spread function of the beam.
    terms: tuple[BeamTerm, ...] = ()  #: The beam's point-spread function as a sum of terms.
    #: The beam's point-spread function as a text file with radius and energy in each row, as Monte Carlo and proximity-
    #: correction programs write it.
    table_file: Path | None = None
    table_unit: Literal["nm", "um"] | None = None  #: Unit of the table's radius; without the key that in its header.
    #: Whether the table holds an energy density, or the energy of each ring between one radius and the next.
    table_energy: Literal["density", "ring"] = "density"
    #: Range of a further Gaussian blur in the best focus: beam, secondary electrons, diffusion.
    blur_nm: NonNegative = 5.0
    #: Half angle of the focused beam, by which `focus_um` of a copy widens the blur; needed where a copy is out of
    #: focus.
    convergence_mrad: Annotated[float, Field(strict=True, gt=0.0, le=100.0)] | None = None
    best_focus_um: Real = 0.0  #: Focus of the smallest blur, as `focus_um` of a copy.
    #: Energy of the backscattered electrons (ranges of at least 2 um) over that of the others; without the key that of
    #: the function.
    backscatter_ratio: Positive | None = None
    #: Base dose over the clearing dose of a large pad; without the key that at which printed sizes equal drawn ones in
    #: the mean, in the best focus.
    base_over_clearing_dose: Positive | None = None
    #: Contrast of the resist: its height grows from none to all over a factor of 10^(1 / contrast) in energy, with half
    #: of it at the clearing energy; without the key the walls are upright.
    contrast: Annotated[float, Field(strict=True, ge=0.5, le=100.0)] | None = None
    #: Layers other than the pillars' that the beam writes in the same exposure, at the base dose; without the key all
    #: but alignment marks, windows and the shapes of the first exposure.
    with_layers: tuple[Index, ...] | None = None
    #: Whether a correction gives each pillar one of some doses, or changes the drawn sizes, for tools with one dose.
    correction: Literal["dose", "shape"] = "dose"
    #: Number of doses that a correction may use; "auto" for as few as change printed sizes by 0.1 nm at most. A file of
    #: few classes is smaller.
    classes: Annotated[int, Field(strict=True, ge=2, le=256)] | Literal["auto"] = "auto"
    source: str = "assumption"  #: Reference of the numbers.

    def _faults(self) -> Iterator[str]:
        if (self.preset is not None) + bool(self.terms) + (self.table_file is not None) != 1:
            yield "give one of `preset`, `terms` and `table_file`"
        if self.table_file is None and (self.table_unit is not None or self.table_energy != "density"):
            yield "`table_unit` and `table_energy` belong to `table_file`"


@spec()
class Etch:
    """Dry etch (``[process.etch]``): difference between made and printed pillars."""

    bias_nm: Real = 0.0  #: Change of width and length at the mean density.
    microloading_nm: Real = 0.0  #: Further change where the local density is larger by 1.
    microloading_range_um: Positive = 50.0  #: Range of the Gaussian that averages the density.
    height_nm: Positive | None = None  #: Height of the made pillar; without the key the unit cell's.
    sidewall_angle_deg: SidewallAngle | None = None  #: Angle of the made sidewalls; without the key the unit cell's.
    #: Radius of the made corners; without the key that of the printed ones.
    corner_radius_nm: NonNegative | None = None
    source: str = "assumption"  #: Reference of the numbers.

    @property
    def corner(self) -> dict[str, float]:
        """Axes of the cell that differ from the unit cell's, by the names of a library's axes."""
        axes = {name: getattr(self, name) for name in ("height_nm", "sidewall_angle_deg", "corner_radius_nm")}
        return {name: value for name, value in axes.items() if value is not None}


@spec()
class Process:
    """Fabrication process (``[process]``)."""

    exposure: ExposureProcess | None = None  #: Electron-beam exposure.
    etch: Etch | None = None  #: Dry etch; without the table the printed pillars remain as they are.
