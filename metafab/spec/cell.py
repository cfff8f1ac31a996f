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
    """A refractive index n + ik (time sign of the conventions: k > 0 absorbs).

    ``n_error`` is the standard uncertainty of n; it enters the error budget, not the solution. ``n_y`` and ``k_y``
    are given only where y polarisation sees another index: a uniaxial substrate whose optic axis lies in the
    surface. ``n_z`` and ``k_z`` are its index along z, which light at an angle sees too. ``record`` names an entry of
    the ``materials`` room in place of numbers.
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


#: Distance of the rows of a regular hexagonal lattice over its period, and how far one may be from regular.
_ROWS_PER_PERIOD, _MOST_STRAIN = math.sqrt(3.0) / 2.0, 0.01

#: Lengths of a cell over the wavelength beyond which they are taken for another unit's numbers.
_LEAST_WAVELENGTHS, _MOST_WAVELENGTHS = 0.01, 100.0

#: Sizes along one axis beyond which maps of both no longer fit any memory.
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
    """The unit cell: a pillar of rectangular cross-section centred in a rectangular period.

    ``lattice`` is rectangular if not given. On a hexagonal one every other row stands half a period aside, and
    ``period_nm`` is the distance of pillars within a row; rows are sqrt(3)/2 of it apart, rounded to a whole nanometre,
    so that a mask can hold what was solved. Given as two numbers, the second is the distance of rows, within 1 % of it.
    ``sidewall_angle_deg`` is the angle between walls and substrate inside the pillar, 90 if not given; below 90 the
    pillar narrows upwards. ``sizes_at`` says where on its height widths and lengths are meant, the middle if not given.
    ``film`` lists closed films between substrate and pillars, from the substrate on, and ``cap`` layers on each pillar,
    from the pillar on, with its outline and the ambient around them; none if not given.
    ``shape`` is the cross-section within width and length: a rectangle, an ellipse, a circle (width and length are
    equal, and only such sizes are swept), or a cross, the rectangle together with itself turned by 90 degrees.
    ``corner_radius_nm`` rounds a rectangle's corners.
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
        """Whether every other row of pillars stands half a period aside."""
        return self.lattice == "hexagonal"


@dataclass(frozen=True, config=CONFIG)
class CellMaterials:
    """What the pillar, the half space below it and the half space above it are made of."""

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
    """A plane wave: vacuum wavelength and the side that it comes from."""

    wavelength_nm: Positive
    side: Side = "substrate"


@dataclass(frozen=True, config=CONFIG)
class Axes:
    """What a library covers beyond sizes, each as [lowest, highest] around the unit cell's own value; all optional.

    ``wavelength_nm``, ``height_nm``, ``sidewall_angle_deg`` and ``corner_radius_nm`` contain the cell's own.
    ``cd_bias_nm`` is added to width and length alike, ``pillar_n_shift`` to the real part of the pillar's index; both
    contain 0.
    ``angle_x_deg`` is the angle of incidence in the x-z plane, inside the medium that the light comes from, from 0 on
    (t is even in it); ``angle_y_deg`` likewise in the y-z plane. Light in any other plane mixes the polarisations,
    which a library does not hold, so only one of the two can be asked.
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
    def asked(self) -> dict[str, tuple[float, float]]:
        """The axes that were asked for, in the order of the fields."""
        spans = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: span for name, span in spans.items() if span is not None}

    @model_validator(mode="after")
    def _sound(self) -> Axes:
        for name, (low, high) in self.asked.items():
            if not low < high:
                raise ValueError(f"`{name}` must be [lowest, highest], got [{low}, {high}]")
            if name.startswith("angle") and not (low == 0.0 and high < 90.0):
                raise ValueError(f"`{name}` must be [0, largest], largest below 90, got [{low}, {high}]")
        if self.angle_x_deg is not None and self.angle_y_deg is not None:
            raise ValueError("give `angle_x_deg` or `angle_y_deg`, not both: between the planes polarisations mix")
        return self


@dataclass(frozen=True, config=CONFIG)
class Sweep:
    """The sizes that a library covers, and the largest error in complex t that it may have.

    ``axes`` names what else it covers (wavelength, height, ...); nothing if not given.
    """

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
    """Which solver builds the library."""

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
        if self.sweep.axes is not None and self.sweep.axes.asked:
            raise ValueError("`sweep.axes` are modelled over width and length; of circles, build a library each")
        return self

    @model_validator(mode="after")
    def _axes_around_the_cell(self) -> UnitCell:
        asked = {} if self.sweep.axes is None else self.sweep.axes.asked
        for name, (low, high) in asked.items():
            if not low <= self.nominal(name) <= high:
                raise ValueError(
                    f"`sweep.axes.{name}` must contain the cell's own {self.nominal(name):g}, got [{low}, {high}]"
                )
        low, high = asked.get("cd_bias_nm", (0.0, 0.0))
        for name, period in zip(("width_nm", "length_nm"), self.cell.period_nm, strict=True):
            smallest, largest = getattr(self.sweep, name)
            if smallest + low <= 0.0 or largest + high > period:
                raise ValueError(
                    f"`sweep.axes.cd_bias_nm` takes `sweep.{name}` to {smallest + low:g}..{largest + high:g} nm, "
                    f"outside 0 to `cell.period_nm` of {period:g} nm"
                )
        return self

    def nominal(self, axis: str) -> float:
        """The cell's own value on an axis of :class:`Axes`."""
        own = {
            "wavelength_nm": self.illumination.wavelength_nm,
            "height_nm": self.cell.height_nm,
            "sidewall_angle_deg": self.cell.sidewall_angle_deg or 90.0,
            "corner_radius_nm": self.cell.corner_radius_nm or 0.0,
        }
        return own.get(axis, 0.0)

    @property
    def has_square_lattice(self) -> bool:
        """Whether a quarter turn maps the lattice to itself; what the materials do is for the ``cell`` room to say."""
        return self.cell.period_nm[0] == self.cell.period_nm[1] and not self.cell.is_hexagonal
