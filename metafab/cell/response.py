"""What every solver is asked (:class:`PillarCell`, :class:`CellNumerics`) and answers (:class:`CellResponse`)."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from metafab.cell.halfspace import admittance
from metafab.core.conventions import ComplexArray, FloatArray, Side

#: Where a sloped pillar has the stated width and length.
SizesAt = Literal["bottom", "middle", "top"]
#: Cross-section of a pillar within its width and length; a cross is a rectangle and the same turned by 90 degrees.
Shape = Literal["rectangle", "ellipse", "cross"]


@dataclass(frozen=True)
class Slice:
    """A layer of one outline: a cap, a coating, a film; also one step of a sloped pillar.

    Attributes:
        height_nm: thickness.
        n_inside: complex index within the outline.
        n_around: complex index around it; the same for a closed film.
        width_nm: size of the outline along x, 0 to the period; if not given, that of the pillar where they touch.
        length_nm: size along y, likewise.
    """

    height_nm: float
    n_inside: complex
    n_around: complex
    width_nm: float | None = None
    length_nm: float | None = None


@dataclass(frozen=True)
class PillarCell:
    """One unit cell under a plane wave: what is solved.

    Attributes:
        period_nm: (x, y) period.
        width_nm: pillar size along x (at ``sizes_at``); 0 is an empty cell, the period a closed film.
        length_nm: pillar size along y.
        height_nm: pillar height.
        n_pillar: complex index of the pillar.
        n_substrate: complex index of the half space under the pillar, as x and y polarisation see it.
        n_ambient: complex index around and above the pillar.
        wavelength_nm: vacuum wavelength.
        side: where the light comes from.
        angle_deg: polar angle of incidence inside the incident half space, 0 to < 90; in a birefringent one, of the
            ordinary wave.
        azimuth_deg: azimuth of the plane of incidence, counter-clockwise from +x.
        under: layers between substrate and pillar, from the substrate on (an antireflection film); rcwa only. The
            planes of t and r are then those where the whole stack begins and ends.
        over: layers on the pillar, from the pillar on (a residual cap); rcwa only.
        n_substrate_z: index of the substrate along z, for a birefringent one with principal axes x, y, z; its waves are
            then treated rigorously. If not given, each polarisation sees its own index, with light along z only.
        sidewall_angle_deg: between walls and substrate, inside the pillar: below 90 the pillar narrows upwards, above
            90 downwards; rcwa only.
        sizes_at: where on the pillar its width and length are those stated.
        is_staggered: whether every other row of pillars stands half a period aside (a hexagonal lattice); the period
            along y is then the distance of rows. By rcwa, of upright pillars without layers, with light along z.
        shape: of the cross-section, within width and length: a rectangle, an ellipse (a circle where both are equal),
            or a cross, the rectangle together with itself turned by 90 degrees; beside rectangles rcwa only.
        corner_radius_nm: of a rectangle's four edges, as resist and etch round them; at most half a side.
    """

    period_nm: tuple[float, float]
    width_nm: float
    length_nm: float
    height_nm: float
    n_pillar: complex
    n_substrate: tuple[complex, complex]
    n_ambient: complex
    wavelength_nm: float
    side: Side = "substrate"
    angle_deg: float = 0.0
    azimuth_deg: float = 0.0
    under: tuple[Slice, ...] = ()
    over: tuple[Slice, ...] = ()
    n_substrate_z: complex | None = None
    sidewall_angle_deg: float = 90.0
    sizes_at: SizesAt = "middle"
    is_staggered: bool = False
    shape: Shape = "rectangle"
    corner_radius_nm: float = 0.0

    @property
    def is_shaped(self) -> bool:
        """Whether the cross-section is more than one rectangle."""
        return self.shape != "rectangle" or self.corner_radius_nm > 0.0

    @property
    def is_sloped(self) -> bool:
        """Whether the pillar's sizes change with height."""
        return self.sidewall_angle_deg != 90.0

    def sizes_nm(self, height_share: float) -> tuple[float, float]:
        """(width, length) of the pillar at a share of its height, 0 at the substrate and 1 at its end.

        An axis without walls (a size of the period) has no slope; nor has an empty cell.
        """
        if not self.is_sloped or 0.0 in (self.width_nm, self.length_nm):
            return self.width_nm, self.length_nm
        stated = {"bottom": 0.0, "middle": 0.5, "top": 1.0}[self.sizes_at]
        grown = 2.0 * (stated - height_share) * self.height_nm / math.tan(math.radians(self.sidewall_angle_deg))
        width, length = (
            size if size == period else size + grown
            for size, period in zip((self.width_nm, self.length_nm), self.period_nm, strict=True)
        )
        return width, length

    @property
    def is_birefringent(self) -> bool:
        """Whether the substrate is treated as a tensor."""
        return self.n_substrate_z is not None and len({*self.n_substrate, self.n_substrate_z}) > 1

    def tensor(self, side: Side) -> tuple[complex, complex, complex] | None:
        """Principal indices of the half space on ``side``; None where it is not birefringent."""
        if side == "ambient" or not self.is_birefringent or self.n_substrate_z is None:
            return None
        return (*self.n_substrate, self.n_substrate_z)

    @property
    def n_of_angle(self) -> complex:
        """The index that ``angle_deg`` is meant in; of a birefringent half space the ordinary one."""
        n_x, n_y = self.n_in
        return n_x if n_x == n_y or self.side == "ambient" or self.n_substrate_z != n_y else n_y

    @property
    def in_plane(self) -> tuple[float, float]:
        """Wave vector (k_x, k_y) of the incident light in the plane of the cell, over k0."""
        k_in = complex(self.n_of_angle).real * math.sin(math.radians(self.angle_deg))
        cosine, sine = _direction(self.azimuth_deg)
        return k_in * cosine, k_in * sine

    @property
    def n_in(self) -> tuple[complex, complex]:
        """Index of the half space that the light comes from, for x and y polarisation."""
        return self.n_substrate if self.side == "substrate" else (self.n_ambient, self.n_ambient)

    @property
    def n_out(self) -> tuple[complex, complex]:
        """Index of the half space that the light goes to, for x and y polarisation."""
        return (self.n_ambient, self.n_ambient) if self.side == "substrate" else self.n_substrate


@dataclass(frozen=True)
class CellNumerics:
    """How a unit cell is solved.

    Attributes:
        target_error: largest error wanted in any of the complex amplitudes.
        solver: "rcwa", or "meep" for FDTD in a separate program.
        formulation: rcwa only: "adaptive" coordinates, or plain "fourier" harmonics as an independent check.
        max_orders: rcwa only: most cosines along each axis before the solver gives up, from 3.
        steps: rcwa only: how many steps a sloped pillar is cut into, an even number, as half as many are solved along;
            if not given, as many as the target asks for.
    """

    target_error: float = 1e-3
    solver: Literal["rcwa", "meep"] = "rcwa"
    formulation: Literal["adaptive", "fourier"] = "adaptive"
    max_orders: int = 16
    steps: int | None = None


@dataclass(frozen=True)
class CellResponse:
    """Zero-order Jones matrices of a unit cell, each with the same reference planes for every solver.

    Attributes:
        cell: what was solved.
        numerics: what was asked of the solver.
        t: shape (2, 2), transmitted over incident E, [out, in] in the basis (x, y); planes of the conventions. For
            light at an angle, of the field's components along x and y (tangential to the cell).
        r: shape (2, 2), reflected over incident E, both at the plane where the pillar begins.
        error: bound or estimate of the largest absolute error among ``t`` and ``r``.
        converged: whether ``error <= numerics.target_error``.
        resolution: Fourier orders (rcwa) or pixels per micrometre (meep) of the finest solution.
        seconds: time that the solution took.
        details: solver's own figures (orders of the sequence, condition numbers, decay levels, ...).
    """

    cell: PillarCell
    numerics: CellNumerics
    t: ComplexArray
    r: ComplexArray
    error: float
    converged: bool
    resolution: int
    seconds: float
    details: dict[str, float | str] = field(default_factory=dict)

    @property
    def transmittance(self) -> tuple[float, float]:
        """Zero-order power transmittance of x and y polarised light (all outgoing polarisations)."""
        near: Side = self.cell.side
        far: Side = "ambient" if near == "substrate" else "substrate"
        x, y = (
            _power_across(self.cell, self.t[:, i], far) / _power_across(self.cell, np.eye(2)[i], near) for i in (0, 1)
        )
        return x, y


def _power_across(cell: PillarCell, field: ComplexArray | FloatArray, side: Side) -> float:
    """Power (in units of the vacuum's) that a zero order with tangential field (x, y) carries along z on ``side``."""
    tensor = cell.tensor(side)
    if tensor is not None:
        return float(np.vdot(field, admittance(tensor, np.array(cell.in_plane)) @ field).real)
    n = cell.n_in if side == cell.side else cell.n_out
    if cell.angle_deg == 0.0:
        return float(n[0].real * abs(field[0]) ** 2 + n[1].real * abs(field[1]) ** 2)
    azimuth = math.radians(cell.azimuth_deg)
    along = math.cos(azimuth) * field[0] + math.sin(azimuth) * field[1]
    across = math.cos(azimuth) * field[1] - math.sin(azimuth) * field[0]
    q = cmath.sqrt(n[0] ** 2 - (cell.n_of_angle * math.sin(math.radians(cell.angle_deg))) ** 2)
    return float((n[0] ** 2 / q).real * abs(along) ** 2 + q.real * abs(across) ** 2)


def _direction(azimuth_deg: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of 90 degrees, so that mirror planes are recognised."""
    quarter, rest = divmod(azimuth_deg, 90.0)
    c, s = (1.0, 0.0) if rest == 0.0 else (math.cos(math.radians(rest)), math.sin(math.radians(rest)))
    return ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]


class CellSolver(Protocol):
    """A solver of unit cells; RCWA, Meep and a stored table are interchangeable."""

    def __call__(self, cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        """Solve one unit cell.

        Raises:
            SolverError: no trustworthy answer could be had.
        """
