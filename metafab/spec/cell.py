"""The unit-cell file: geometry, materials, illumination, the sweep of its library, and the solver."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from metafab.core.conventions import Side
from metafab.spec.fields import CONFIG, NonNegative, Positive, TargetError


@dataclass(frozen=True, config=CONFIG)
class Material:
    """A refractive index n + ik (time sign of the conventions: k > 0 absorbs).

    ``n_error`` is the standard uncertainty of n; it enters the error budget, not the solution. ``n_y`` and ``k_y``
    are given only where y polarisation sees another index: a uniaxial substrate whose optic axis lies in the
    surface. ``record`` names an entry of the ``materials`` room in place of numbers.
    """

    n: Positive | None = None
    k: NonNegative = 0.0
    n_error: NonNegative = 0.0
    n_y: Positive | None = None
    k_y: NonNegative | None = None
    record: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Material:
        if (self.n is None) == (self.record is None):
            raise ValueError("give either a number `n` (with `k`) or the name of a `record`, not both or neither")
        return self


def _material(value: object) -> object:
    return {"record": value} if isinstance(value, str) else value


@dataclass(frozen=True, config=CONFIG)
class CellGeometry:
    """The unit cell: a pillar of rectangular cross-section centred in a rectangular period."""

    period_nm: tuple[Positive, Positive]
    height_nm: Positive
    shape: Literal["rectangle"] = "rectangle"

    @field_validator("period_nm", mode="before")
    @classmethod
    def _square(cls, value: object) -> object:
        return (value, value) if isinstance(value, int | float) else value


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


@dataclass(frozen=True, config=CONFIG)
class Illumination:
    """A plane wave: vacuum wavelength and the side that it comes from."""

    wavelength_nm: Positive
    side: Side = "substrate"


@dataclass(frozen=True, config=CONFIG)
class Sweep:
    """The sizes that a library covers, and the largest error in complex t that it may have."""

    width_nm: tuple[Positive, Positive]
    length_nm: tuple[Positive, Positive]
    size_grid_nm: Positive
    target_error: TargetError = 2e-3

    @model_validator(mode="after")
    def _ordered(self) -> Sweep:
        for name in ("width_nm", "length_nm"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"`{name}` must be [smallest, largest], got [{low}, {high}]")
            steps = (high - low) / self.size_grid_nm
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

    @property
    def is_square(self) -> bool:
        """Whether swapping x and y swaps the two polarisations and nothing else."""
        isotropic = all(m.n_y is None for m in (self.materials.substrate, self.materials.ambient))
        return isotropic and self.cell.period_nm[0] == self.cell.period_nm[1]
