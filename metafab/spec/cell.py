"""The unit-cell file: geometry, materials, illumination, the sweep of its library, and the solver."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from metafab.core.conventions import Side
from metafab.spec.fields import CONFIG, NonNegative, Positive, Real, TargetError


@dataclass(frozen=True, config=CONFIG)
class Material:
    """A refractive index n + ik; k > 0 absorbs (see the conventions).

    ``n_error`` is the standard uncertainty of n; it enters the error budget, not the solution. ``n_y`` and ``k_y``
    describe a substrate whose index differs for y polarisation (a uniaxial crystal with its optic axis in the
    surface), ``n_z`` and ``k_z`` its index along z, which matters at oblique incidence. ``record`` names an entry of
    the ``materials`` room and replaces the numbers.
    """

    n: Positive | None = None
    k: NonNegative = 0.0
    n_error: NonNegative = 0.0
    n_y: Positive | None = None
    k_y: NonNegative | None = None
    n_z: Positive | None = None
    k_z: NonNegative | None = None
    record: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Material:
        if (self.n is None) == (self.record is None):
            raise ValueError("give either a number `n` (with `k`) or the name of a `record`, not both or neither")
        return self


def _material(value: object) -> object:
    return {"record": value} if isinstance(value, str) else value


#: Row distance of a regular hexagonal lattice over its period, and its largest allowed relative deviation.
_ROWS_PER_PERIOD, _MOST_STRAIN = math.sqrt(3.0) / 2.0, 0.01

#: Range of a cell's lengths over the wavelength; a length outside it is probably in another unit.
_LEAST_WAVELENGTHS, _MOST_WAVELENGTHS = 0.01, 100.0

#: Largest number of size steps along one axis; maps over both axes must fit into memory.
_MOST_STEPS = 10_000

SidewallAngle = Annotated[float, Field(strict=True, ge=60.0, le=120.0)]


@dataclass(frozen=True, config=CONFIG)
class Layer:
    """A uniform layer of one isotropic material."""

    height_nm: Positive
    material: Material

    @field_validator("material", mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        return _material(value)

    @model_validator(mode="after")
    def _isotropic(self) -> Layer:
        if self.material.n_y is not None or self.material.n_z is not None:
            raise ValueError("`material`: only the substrate may be birefringent")
        return self


@dataclass(frozen=True, config=CONFIG)
class CellGeometry:
    """Geometry of the unit cell: one pillar centred in a rectangular or hexagonal lattice cell.

    ``lattice``: rectangular by default. In a hexagonal lattice every other row is shifted by half a period;
    ``period_nm`` is the distance of pillars within a row. The row distance is sqrt(3)/2 of it, rounded to a whole
    nanometre so that a mask can hold it, or the second number of ``period_nm``, which must lie within 1 % of that.
    ``shape``: cross-section within width and length. A circle has equal width and length, and only such sizes are
    swept; a cross is the union of the rectangle and the rectangle turned by 90 degrees.
    ``corner_radius_nm``: radius of a rectangle's corners.
    ``sidewall_angle_deg``: angle between wall and substrate inside the pillar, 90 by default; below 90 the pillar
    narrows upwards. ``sizes_at``: height at which width and length are measured, the middle by default.
    ``film``: uniform films between substrate and pillars, from the substrate up. ``cap``: layers on top of each
    pillar, with the pillar's outline, from the pillar up.
    """

    period_nm: tuple[Positive, Positive]
    height_nm: Positive
    shape: Literal["rectangle", "ellipse", "circle", "cross"] = "rectangle"
    sidewall_angle_deg: SidewallAngle | None = None
    sizes_at: Literal["bottom", "middle", "top"] | None = None
    film: tuple[Layer, ...] | None = None
    cap: tuple[Layer, ...] | None = None
    lattice: Literal["rectangular", "hexagonal"] | None = None
    corner_radius_nm: NonNegative | None = None

    @field_validator("period_nm", mode="before")
    @classmethod
    def _square(cls, value: object) -> object:
        return (value, value) if isinstance(value, int | float) else value

    @model_validator(mode="after")
    def _rows(self) -> CellGeometry:
        along_row, rows_nm = self.period_nm
        regular_nm = along_row * _ROWS_PER_PERIOD
        if not self.is_hexagonal or abs(rows_nm / regular_nm - 1.0) <= _MOST_STRAIN:
            return self
        if rows_nm != along_row or round(regular_nm) == 0:
            raise ValueError(
                f"`period_nm` of a hexagonal lattice must be one number, or rows within 1 % of {regular_nm:.6g} nm "
                f"apart, got {rows_nm:g} nm"
            )
        object.__setattr__(self, "period_nm", (along_row, float(round(regular_nm))))
        return self

    @model_validator(mode="after")
    def _corners(self) -> CellGeometry:
        if self.is_hexagonal and (self.shape != "rectangle" or self.corner_radius_nm):
            raise ValueError("`shape`, `corner_radius_nm`: pillars of a hexagonal lattice are plain rectangles, so far")
        if self.corner_radius_nm and self.shape != "rectangle":
            raise ValueError(f"`corner_radius_nm` rounds a rectangle's corners, not those of the shape {self.shape!r}")
        return self

    @property
    def is_hexagonal(self) -> bool:
        """Whether every other row of pillars is shifted by half a period."""
        return self.lattice == "hexagonal"


@dataclass(frozen=True, config=CONFIG)
class CellMaterials:
    """Materials of the pillar, of the half space below it and of the half space above it."""

    pillar: Material
    substrate: Material
    ambient: Material = Field(default_factory=lambda: Material(n=1.0))

    @field_validator("pillar", "substrate", "ambient", mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        return _material(value)

    @model_validator(mode="after")
    def _one_birefringent(self) -> CellMaterials:
        for name in ("pillar", "ambient"):
            given = [key for key in ("n_y", "k_y", "n_z", "k_z") if getattr(getattr(self, name), key) is not None]
            if given:
                raise ValueError(f"`{name}.{given[0]}`: only the substrate may be birefringent")
        return self


@dataclass(frozen=True, config=CONFIG)
class Illumination:
    """Incident plane wave: vacuum wavelength and side of incidence."""

    wavelength_nm: Positive
    side: Side = "substrate"


@dataclass(frozen=True, config=CONFIG)
class Axes:
    """Further axes of a library beyond the sizes, each a range [lowest, highest]; all optional.

    ``wavelength_nm``, ``height_nm``, ``sidewall_angle_deg`` and ``corner_radius_nm`` contain the unit cell's value.
    ``cd_bias_nm`` is added to width and length, ``pillar_n_shift`` to the real part of the pillar's index; both ranges
    contain 0. ``angle_x_deg`` is the angle of incidence in the x-z plane, in the medium of incidence; its range starts
    at 0, because t is even in it. ``angle_y_deg`` is that in the y-z plane. Only one of the two can be swept: in any
    other plane of incidence the polarisations mix, and a library holds no cross-polarised amplitudes.
    """

    wavelength_nm: tuple[Positive, Positive] | None = None
    height_nm: tuple[Positive, Positive] | None = None
    sidewall_angle_deg: tuple[SidewallAngle, SidewallAngle] | None = None
    corner_radius_nm: tuple[NonNegative, NonNegative] | None = None
    cd_bias_nm: tuple[Real, Real] | None = None
    pillar_n_shift: tuple[Real, Real] | None = None
    angle_x_deg: tuple[NonNegative, NonNegative] | None = None
    angle_y_deg: tuple[NonNegative, NonNegative] | None = None

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Ranges of the swept axes, in the order of the fields."""
        spans = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: span for name, span in spans.items() if span is not None}

    @model_validator(mode="after")
    def _sound(self) -> Axes:
        for name, (low, high) in self.spans.items():
            if not low < high:
                raise ValueError(f"`{name}` must be [lowest, highest], got [{low}, {high}]")
            if name.startswith("angle") and not (low == 0.0 and high < 90.0):
                raise ValueError(f"`{name}` must be [0, largest], largest below 90, got [{low}, {high}]")
        if self.angle_x_deg is not None and self.angle_y_deg is not None:
            raise ValueError("give `angle_x_deg` or `angle_y_deg`, not both: between the planes polarisations mix")
        return self


@dataclass(frozen=True, config=CONFIG)
class Sweep:
    """Sizes of a library, and its target error in complex t; ``axes`` lists further axes (wavelength, height, ...)."""

    width_nm: tuple[Positive, Positive]
    length_nm: tuple[Positive, Positive]
    size_grid_nm: Positive
    target_error: TargetError = 2e-3
    axes: Axes | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Sweep:
        for name in ("width_nm", "length_nm"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"`{name}` must be [smallest, largest], got [{low}, {high}]")
            steps = (high - low) / self.size_grid_nm
            if steps > _MOST_STEPS:
                raise ValueError(f"`size_grid_nm` must leave at most {_MOST_STEPS} steps of `{name}`, got {steps:.3g}")
            if abs(steps - round(steps)) > 1e-6:
                raise ValueError(
                    f"`{name}` must span a whole number of `size_grid_nm` steps, got {high - low} nm in steps "
                    f"of {self.size_grid_nm} nm"
                )
        return self


@dataclass(frozen=True, config=CONFIG)
class Solver:
    """Solver that builds the library."""

    name: Literal["rcwa", "meep"] = "rcwa"


@dataclass(frozen=True, config=CONFIG)
class UnitCell:
    """A unit-cell file (``unitcell_lib/NAME.toml``)."""

    cell: CellGeometry
    materials: CellMaterials
    illumination: Illumination
    sweep: Sweep
    solver: Solver = Field(default_factory=Solver)
    source: Annotated[str, Field(description="where the numbers come from")] = ""

    @model_validator(mode="after")
    def _fits(self) -> UnitCell:
        for name, period in zip(("width_nm", "length_nm"), self.cell.period_nm, strict=True):
            largest = getattr(self.sweep, name)[1]
            if largest > period:
                raise ValueError(f"`sweep.{name}` reaches {largest} nm, beyond `cell.period_nm` of {period} nm")
        return self

    @model_validator(mode="after")
    def _in_nanometres(self) -> UnitCell:
        wavelength_nm = self.illumination.wavelength_nm
        least_nm, most_nm = _LEAST_WAVELENGTHS * wavelength_nm, _MOST_WAVELENGTHS * wavelength_nm
        lengths = {
            "cell.period_nm": min(self.cell.period_nm),
            "cell.height_nm": self.cell.height_nm,
            "sweep.width_nm": self.sweep.width_nm[0],
            "sweep.length_nm": self.sweep.length_nm[0],
        }
        wrong = [f"`{name}` = {length:g}" for name, length in lengths.items() if not least_nm <= length <= most_nm]
        if wrong:
            raise ValueError(
                f"{', '.join(wrong)}: lengths must be {least_nm:g} to {most_nm:g} nm, a hundredth to a hundred of the "
                f"wavelength of {wavelength_nm:g} nm; are they in nanometres?"
            )
        return self

    @model_validator(mode="after")
    def _round(self) -> UnitCell:
        if self.cell.shape != "circle":
            return self
        if self.sweep.width_nm != self.sweep.length_nm:
            raise ValueError("`sweep.length_nm` of circles must equal `sweep.width_nm`: both are the diameter")
        if self.sweep.axes is not None and self.sweep.axes.spans:
            raise ValueError("`sweep.axes` is not available for circles; build one library for each value")
        return self

    @model_validator(mode="after")
    def _axes_around_the_cell(self) -> UnitCell:
        spans = {} if self.sweep.axes is None else self.sweep.axes.spans
        for name, (low, high) in spans.items():
            if not low <= self.nominal(name) <= high:
                raise ValueError(
                    f"`sweep.axes.{name}` must contain the cell's own {self.nominal(name):g}, got [{low}, {high}]"
                )
        low, high = spans.get("cd_bias_nm", (0.0, 0.0))
        for name, period in zip(("width_nm", "length_nm"), self.cell.period_nm, strict=True):
            smallest, largest = getattr(self.sweep, name)
            if smallest + low <= 0.0 or largest + high > period:
                raise ValueError(
                    f"`sweep.axes.cd_bias_nm` takes `sweep.{name}` to {smallest + low:g}..{largest + high:g} nm, "
                    f"outside 0 to `cell.period_nm` of {period:g} nm"
                )
        return self

    def nominal(self, axis: str) -> float:
        """Value of the unit cell on an axis of :class:`Axes`."""
        own = {
            "wavelength_nm": self.illumination.wavelength_nm,
            "height_nm": self.cell.height_nm,
            "sidewall_angle_deg": self.cell.sidewall_angle_deg or 90.0,
            "corner_radius_nm": self.cell.corner_radius_nm or 0.0,
        }
        return own.get(axis, 0.0)

    @property
    def has_square_lattice(self) -> bool:
        """Whether a rotation by 90 degrees maps the lattice to itself; materials are not considered."""
        return self.cell.period_nm[0] == self.cell.period_nm[1] and not self.cell.is_hexagonal
