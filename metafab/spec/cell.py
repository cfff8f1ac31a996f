"""The unit-cell file: geometry, materials, illumination, the sweep of its library, and the solver."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from metafab.core.conventions import FloatArray, Side
from metafab.core.errors import InputError
from metafab.spec.fields import BOTH, Checked, NonNegative, Positive, Real, TargetError, spec


@spec()
class Material(Checked):
    """A refractive index n + ik by numbers or by the name of a record."""

    n: Positive | None = None  #: Real part of the refractive index.
    k: NonNegative = 0.0  #: Imaginary part of the refractive index; above 0 absorbs.
    n_error: NonNegative = 0.0  #: Standard uncertainty of `n` for the error budget; 0: not stated.
    #: Index of a substrate for y polarisation, if it differs (a crystal with its optic axis in the surface).
    n_y: Positive | None = None
    k_y: NonNegative | None = None  #: Imaginary part that belongs to `n_y`.
    n_z: Positive | None = None  #: Index of a substrate along z; it matters at oblique incidence.
    k_z: NonNegative | None = None  #: Imaginary part that belongs to `n_z`.
    #: Name of a cited record, a CSV file (`wavelength_nm,n,k`), or shelf/book/page of refractiveindex.info; it replaces
    #: the numbers. A text in place of the table means the same.
    record: str | None = None

    def _faults(self) -> Iterator[str]:
        if (self.n is None) == (self.record is None):
            yield "give either a number `n` (with `k`) or the name of a `record`, not both or neither"

    @property
    def directional(self) -> list[str]:
        """Keys that make a substrate birefringent, if any are given."""
        return [key for key in ("n_y", "k_y", "n_z", "k_z") if getattr(self, key) is not None]


#: A material's table, or the name of a record in its place.
MaterialOrName = Annotated[
    Material, BeforeValidator(lambda value: {"record": value} if isinstance(value, str) else value)
]


#: Row distance of a regular hexagonal lattice over its period, and its largest allowed relative deviation.
_ROWS_PER_PERIOD, _MOST_STRAIN = math.sqrt(3.0) / 2.0, 0.01

_SHAPE_REMEDY = "does `cell.shape` of the unit cell fit?"

#: Range of a cell's lengths over the wavelength; a length outside it is probably in another unit.
_LEAST_WAVELENGTHS, _MOST_WAVELENGTHS = 0.01, 100.0

#: Largest number of size steps along one axis; maps over both axes must fit into memory.
_MOST_STEPS = 10_000

SidewallAngle = Annotated[float, Field(strict=True, ge=60.0, le=120.0)]


@spec()
class Layer(Checked):
    """A uniform layer of one isotropic material."""

    height_nm: Positive  #: Thickness of the layer.
    material: MaterialOrName  #: Material of the layer; isotropic.

    def _faults(self) -> Iterator[str]:
        if self.material.directional:
            yield "`material`: only the substrate may be birefringent"


@spec()
class CellGeometry(Checked):
    """Geometry of the unit cell: one pillar centred in a rectangular or hexagonal lattice cell."""

    #: Distance of pillars along x and y; one number for both. In a hexagonal lattice: within a row, and between rows
    #: (within 1 % of sqrt(3)/2 of the first; by default that, rounded to 1 nm).
    period_nm: Annotated[tuple[Positive, Positive], BOTH]
    height_nm: Positive  #: Height of the pillars.
    #: Cross-section within width and length. Circles have equal width and length; a cross is the union of the rectangle
    #: and the same rectangle turned by 90 degrees; a ring is a circle with a round hole.
    shape: Literal["rectangle", "ellipse", "circle", "cross", "ring"] = "rectangle"
    #: Angle between wall and substrate inside the pillar; 90 without the key. Below 90 the pillar narrows upwards.
    sidewall_angle_deg: SidewallAngle | None = None
    #: Height at which width and length are measured; the middle without the key.
    sizes_at: Literal["bottom", "middle", "top"] | None = None
    film: tuple[Layer, ...] | None = None  #: Uniform films between substrate and pillars, from the substrate up.
    cap: tuple[Layer, ...] | None = None  #: Layers on top of each pillar with the pillar's outline, from the pillar up.
    #: Lattice of the pillars; rectangular without the key. In a hexagonal one every other row is shifted by half a
    #: period.
    lattice: Literal["rectangular", "hexagonal"] | None = None
    corner_radius_nm: NonNegative | None = None  #: Radius of a rectangle's corners.
    wall_nm: Positive | None = None  #: Thickness of a ring's wall, equal for all outer diameters.
    inner_diameter_nm: Positive | None = None  #: Diameter of a ring's hole, equal for all outer diameters.

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

    def _faults(self) -> Iterator[str]:
        if self.is_hexagonal and (self.shape == "cross" or self.corner_radius_nm):
            yield (
                "`shape`, `corner_radius_nm`: pillars of a hexagonal lattice are rectangles, ellipses, circles or "
                "rings; crosses and rounded corners are not available there"
            )
        if self.corner_radius_nm and self.shape != "rectangle":
            yield f"`corner_radius_nm` rounds a rectangle's corners, not those of the shape {self.shape!r}"
        given = [name for name in ("wall_nm", "inner_diameter_nm") if getattr(self, name) is not None]
        if len(given) != (self.shape == "ring"):
            got = " and ".join(f"`{name}`" for name in given) or "neither"
            yield f"a ring, and no other shape, has `wall_nm` or `inner_diameter_nm`: got {got} for {self.shape!r}"

    @property
    def is_hexagonal(self) -> bool:
        """Whether every other row of pillars is shifted by half a period."""
        return self.lattice == "hexagonal"

    @property
    def is_round(self) -> bool:
        """Whether the outline is a circle, whose diameter is both width and length."""
        return self.shape in {"circle", "ring"}

    def hole_nm(self, width_nm: float) -> float:
        """Diameter of the hole of a ring with an outer diameter of ``width_nm``; 0 for other shapes."""
        return width_nm - 2.0 * self.wall_nm if self.wall_nm else self.inner_diameter_nm or 0.0

    def require_sides(self, table: Path, has_diameters: bool) -> None:
        """Refuse a table with diameters unless the pillars are round."""
        if has_diameters and not self.is_round:
            expected = f"`width_nm` and `length_nm` for the shape {self.shape!r}"
            raise InputError.single(str(table), "columns", expected, "`diameter_nm`", _SHAPE_REMEDY)

    def require_diameters(self, table: Path, size_nm: FloatArray) -> None:
        """Refuse rows, shape (n, 2), with a width that is not the length if the pillars are round."""
        unequal = np.flatnonzero(size_nm[:, 0] != size_nm[:, 1])
        if self.is_round and unequal.size:
            width, length = size_nm[unequal[0]]
            expected = f"equal widths and lengths, or `diameter_nm`, for the shape {self.shape!r}"
            got = f"{unequal.size} that differ, such as {width:g} x {length:g} nm"
            raise InputError.single(str(table), "sizes", expected, got, _SHAPE_REMEDY)


@spec()
class CellMaterials(Checked):
    """Materials of the pillar, of the half space below it and of the half space above it."""

    pillar: MaterialOrName  #: Material of the pillars.
    substrate: MaterialOrName  #: Material of the half space below the pillars.
    #: Material of the half space above and between the pillars; vacuum without the key.
    ambient: MaterialOrName = Field(default_factory=lambda: Material(n=1.0))

    def _faults(self) -> Iterator[str]:
        for name, material in (("pillar", self.pillar), ("ambient", self.ambient)):
            for key in material.directional:
                yield f"`{name}.{key}`: only the substrate may be birefringent"


@spec()
class Illumination:
    """Incident plane wave: vacuum wavelength and side of incidence."""

    wavelength_nm: Positive  #: Vacuum wavelength.
    side: Side = "substrate"  #: Side from which the light comes.


@spec()
class Axes(Checked):
    """Further axes of a library beyond the sizes, each a range [lowest, highest]; all optional.

    Only one plane of incidence can be swept: in any other the polarisations mix, and a library holds no cross-polarised
    amplitudes.
    """

    #: Range of wavelengths [lowest, highest]; it contains the unit cell's.
    wavelength_nm: tuple[Positive, Positive] | None = None
    height_nm: tuple[Positive, Positive] | None = None  #: Range of pillar heights; it contains the unit cell's.
    #: Range of sidewall angles; it contains the unit cell's.
    sidewall_angle_deg: tuple[SidewallAngle, SidewallAngle] | None = None
    #: Range of corner radii; it contains the unit cell's.
    corner_radius_nm: tuple[NonNegative, NonNegative] | None = None
    cd_bias_nm: tuple[Real, Real] | None = None  #: Range of the bias of width and length; it contains 0.
    pillar_n_shift: tuple[Real, Real] | None = None  #: Range of the change of the pillar's index; it contains 0.
    #: Range [0, largest] of the angle of incidence in the x-z plane, in the medium of incidence.
    angle_x_deg: tuple[NonNegative, NonNegative] | None = None
    #: Range [0, largest] of the angle of incidence in the y-z plane; not together with `angle_x_deg`.
    angle_y_deg: tuple[NonNegative, NonNegative] | None = None

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Ranges of the swept axes, in the order of the fields."""
        spans = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: span for name, span in spans.items() if span is not None}

    def _faults(self) -> Iterator[str]:
        for name, (low, high) in self.spans.items():
            if not low < high:
                yield f"`{name}` must be [lowest, highest], got [{low}, {high}]"
            if name.startswith("angle") and not (low == 0.0 and high < 90.0):
                yield f"`{name}` must be [0, largest], largest below 90, got [{low}, {high}]"
        if self.angle_x_deg is not None and self.angle_y_deg is not None:
            yield "give `angle_x_deg` or `angle_y_deg`, not both: between the planes polarisations mix"


@spec()
class Sweep(Checked):
    """Sizes of a library, and its target error."""

    width_nm: tuple[Positive, Positive]  #: Smallest and largest width.
    length_nm: tuple[Positive, Positive]  #: Smallest and largest length; for circles and rings equal to `width_nm`.
    size_grid_nm: Positive  #: Step of the sizes; both ranges hold a whole number of steps.
    target_error: TargetError = 2e-3  #: Target error of the complex transmission t of every size.
    axes: Axes | None = None  #: Further axes of the library.

    def _faults(self) -> Iterator[str]:
        for name in ("width_nm", "length_nm"):
            low, high = getattr(self, name)
            if low > high:
                yield f"`{name}` must be [smallest, largest], got [{low}, {high}]"
            steps = (high - low) / self.size_grid_nm
            if steps > _MOST_STEPS:
                yield f"`size_grid_nm` must leave at most {_MOST_STEPS} steps of `{name}`, got {steps:.3g}"
            if abs(steps - round(steps)) > 1e-6:
                yield (
                    f"`{name}` must span a whole number of `size_grid_nm` steps, got {high - low} nm in steps "
                    f"of {self.size_grid_nm} nm"
                )


@spec()
class Solver:
    """Solver that builds the library."""

    name: Literal["rcwa", "meep"] = "rcwa"  #: Solver that builds the library.


@spec()
class Neighbours:
    """Training of the model of unlike neighbours, which a library holds if its unit cell has this table."""

    #: Rows of unlike pillars to solve, for each direction of the row and each polarisation. A twelfth as many are added
    #: where the model is least sure.
    rows: Annotated[int, Field(strict=True, ge=60, le=20_000)] = 960
    #: Even and odd modes of a pillar beyond 4 and 3 or 4. With 1 the field of a mask takes two thirds of the time, and
    #: the median error on rows of random sizes is 1.3 times as large.
    more_modes: Annotated[int, Field(strict=True, ge=0, le=3)] = 2
    #: Blocks of 3 x 3 to 5 x 5 pillars to solve, for the coupling of rows across themselves and of both polarisations;
    #: 0 for none. They take some 15 minutes of processor time, and serve orders of large blocks, with
    #: the paper's cell of more than 49 pillars (`metafab fullwave --solver model`).
    blocks: Annotated[int, Field(strict=True, ge=0, le=2000)] = 64


@spec()
class UnitCell(Checked):
    """A unit-cell file (``unitcell_lib/NAME.toml``)."""

    cell: CellGeometry  #: Geometry of the unit cell.
    materials: CellMaterials  #: Materials.
    illumination: Illumination  #: Incident light.
    sweep: Sweep  #: Sizes of the library.
    solver: Solver = Field(default_factory=Solver)  #: Solver of the library.
    neighbours: Neighbours | None = None  #: Training of the model of unlike neighbours.
    source: str = ""  #: Where the numbers come from.

    def _faults(self) -> Iterator[str]:
        for name, period in zip(("width_nm", "length_nm"), self.cell.period_nm, strict=True):
            largest = getattr(self.sweep, name)[1]
            if largest > period:
                yield f"`sweep.{name}` reaches {largest} nm, beyond `cell.period_nm` of {period} nm"
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
            yield (
                f"{', '.join(wrong)}: lengths must be {least_nm:g} to {most_nm:g} nm, a hundredth to a hundred of the "
                f"wavelength of {wavelength_nm:g} nm; are they in nanometres?"
            )
        circles = self.cell.is_round
        if circles and self.sweep.width_nm != self.sweep.length_nm:
            shapes = "rings" if self.cell.shape == "ring" else "circles"
            yield f"`sweep.length_nm` of {shapes} must equal `sweep.width_nm`: both are the diameter"
        smallest_nm = self.sweep.width_nm[0]
        if self.cell.shape == "ring" and not 0.0 < self.cell.hole_nm(smallest_nm) < smallest_nm:
            yield f"`sweep.width_nm` starts at {smallest_nm:g} nm: no ring of that outer diameter has this wall or hole"
        yield from self._axis_faults()
        yield from self._neighbour_faults()

    def _axis_faults(self) -> Iterator[str]:
        spans = {} if self.sweep.axes is None else self.sweep.axes.spans
        is_ring = self.cell.shape == "ring"
        shape = "hexagonal lattices" if self.cell.is_hexagonal else f"the shape {self.cell.shape!r}"
        for name, is_refused in (
            ("corner_radius_nm", self.cell.shape != "rectangle" or self.cell.is_hexagonal),
            ("cd_bias_nm", is_ring),
            *(
                (name, is_ring or self.cell.is_hexagonal)
                for name in ("sidewall_angle_deg", "angle_x_deg", "angle_y_deg")
            ),
        ):
            if is_refused and name in spans:
                yield f"`sweep.axes.{name}` is not available for {shape}; remove the axis"
        for name, (low, high) in spans.items():
            if not low <= self.nominal(name) <= high:
                yield (f"`sweep.axes.{name}` must contain the cell's own {self.nominal(name):g}, got [{low}, {high}]")
        low, high = spans.get("cd_bias_nm", (0.0, 0.0))
        for name, period in zip(("width_nm", "length_nm"), self.cell.period_nm, strict=True):
            smallest, largest = getattr(self.sweep, name)
            if smallest + low <= 0.0 or largest + high > period:
                yield (
                    f"`sweep.axes.cd_bias_nm` takes `sweep.{name}` to {smallest + low:g}..{largest + high:g} nm, "
                    f"outside 0 to `cell.period_nm` of {period:g} nm"
                )

    def _neighbour_faults(self) -> Iterator[str]:
        """Refuse a model of neighbours where the row solver cannot supply its training rows."""
        if self.neighbours is None:
            return
        cell, substrate = self.cell, self.materials.substrate
        hindrances = {
            "a rectangular lattice": cell.is_hexagonal,
            '`cell.shape` "rectangle"': cell.shape != "rectangle",
            "sharp corners": bool(cell.corner_radius_nm),
            "upright walls": cell.sidewall_angle_deg not in (None, 90.0),
            "pillars without films and caps": bool(cell.film) or bool(cell.cap),
            "an isotropic substrate": any(index is not None for index in (substrate.n_y, substrate.k_y, substrate.n_z)),
            '`solver.name` "rcwa"': self.solver.name != "rcwa",
            "more than one width and one length": self.sweep.width_nm[0] == self.sweep.width_nm[1]
            or self.sweep.length_nm[0] == self.sweep.length_nm[1],
        }
        wrong = [name for name, stands in hindrances.items() if stands]
        if wrong:
            yield f"`neighbours`: the model of neighbours needs {', '.join(wrong)}; remove the table"

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
