"""Numerics and result of every unit-cell solver."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, Protocol, Self

import numpy as np

from metafab.cell.fresnel import admittance
from metafab.cell.pillar import PillarCell
from metafab.core.conventions import ComplexArray, FloatArray, Side
from metafab.core.display import Displayed, dataset

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, kw_only=True)
class CellNumerics:
    """Numerics of a unit-cell solution."""

    target_error: float = 1e-3  #: Largest accepted error of any complex amplitude, above 0 and below 1.
    #: "rcwa", "elements" for spectral elements, which "rcwa" takes by itself for curved outlines, or "meep" for FDTD.
    solver: Literal["rcwa", "elements", "meep"] = "rcwa"
    #: Rcwa only: "adaptive" coordinates, or plain "fourier" harmonics as an independent check.
    formulation: Literal["adaptive", "fourier"] = "adaptive"
    #: Largest number of cosines along each axis (rcwa) or largest polynomial order (elements, at least 5), from 3.
    max_orders: int = 16
    #: Rcwa only: even number of layers that approximate a sloped pillar; None for as many as the target error requires.
    steps: int | None = None
    #: Rcwa only: derivatives of the amplitudes by both sizes as well, for plain rectangles with upright walls.
    slopes: bool = False


@dataclass(frozen=True)
class SolverDetails:
    """Base class of the solver-specific figures of a response."""

    def exchanged(self) -> Self:
        """The figures with those of x and y, which end in ``_x`` and ``_y``, exchanged."""
        ends = {"_x": "_y", "_y": "_x"}
        return replace(
            self, **{name[:-2] + ends[name[-2:]]: value for name, value in vars(self).items() if name[-2:] in ends}
        )


@dataclass(frozen=True, repr=False)
class CellResponse(Displayed):
    """Zero-order Jones matrices of a unit cell, in the reference planes of the conventions for every solver.

    Attributes:
        cell: the cell that was solved.
        numerics: numerics of the solution.
        t: shape (2, 2), transmitted over incident tangential E (x and y components), indexed [out, in] in the basis
            (x, y).
        r: shape (2, 2), reflected over incident tangential E, both at the plane where the pillar begins.
        error: bound or estimate of the largest absolute error among ``t`` and ``r``.
        converged: whether ``error <= numerics.target_error``.
        resolution: Fourier orders (rcwa), functions of the transverse field (elements) or pixels per micrometre (meep)
            of the finest solution.
        seconds: time that the solution took.
        details: figures of the solver (orders, condition number, decay, ...).
        slopes: shape (2, 4), derivatives of t_xx, t_yy, r_xx, r_yy by width and by length, 1/nm; None if not asked for,
            or not known.
    """

    cell: PillarCell
    numerics: CellNumerics
    t: ComplexArray
    r: ComplexArray
    error: float
    converged: bool
    resolution: int
    seconds: float
    details: SolverDetails = SolverDetails()
    slopes: ComplexArray | None = None

    def exchanged(self) -> CellResponse:
        """Response of the cell with x and y exchanged, with `seconds` 0; ValueError where there is no such cell.

        See :meth:`metafab.cell.PillarCell.exchanged`.
        """
        cell = self.cell.exchanged()
        if cell is None:
            raise ValueError(f"`cell`: expected one whose axes may be exchanged, got {self.cell}")
        t, r = self.t[::-1, ::-1], self.r[::-1, ::-1]
        slopes = None if self.slopes is None else self.slopes[::-1, [1, 0, 3, 2]]
        return replace(self, cell=cell, t=t, r=r, seconds=0.0, details=self.details.exchanged(), slopes=slopes)

    @property
    def transmittance(self) -> tuple[float, float]:
        """Zero-order power transmittance of x and y polarised light, summed over both outgoing polarisations."""
        return self._transmittance(0), self._transmittance(1)

    def _transmittance(self, axis: int) -> float:
        cell, incident = self.cell, np.eye(2)[axis]
        return _power_across(cell, self.t[:, axis], cell.far_side) / _power_across(cell, incident, cell.side)

    def key_figures(self) -> dict[str, str]:
        """Transmission of both polarisations and the error bound."""
        phases, powers = np.angle(np.diag(self.t)), self.transmittance
        return {
            **{
                f"{p} polarisation": f"transmittance {power:.4f}, phase {phase:.4f} rad"
                for p, power, phase in zip("xy", powers, phases, strict=True)
            },
            "error": f"{self.error:.1e}",
            {"rcwa": "orders", "elements": "functions", "meep": "pixels per um"}[self.numerics.solver]: str(
                self.resolution
            ),
        }

    def to_xarray(self) -> xarray.Dataset:
        """Jones matrices over (outgoing, incident) polarisation.

        Raises:
            MissingToolError: xarray is not installed.
        """
        axes = ("outgoing", "incident")
        matrices = {"t": (axes, self.t, ""), "r": (axes, self.r, "")}
        return dataset(matrices, {axis: ["x", "y"] for axis in axes}, error=self.error)


class CellSolver(Protocol):
    """A solver of unit cells; RCWA, Meep and a stored table are interchangeable."""

    def __call__(self, cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        """Solve one unit cell.

        Raises:
            SolverError: the solver found no result that passes its checks.
        """


def power_ratio(cell: PillarCell) -> FloatArray:
    """Return the zero-order power transmittance of t = 1, shape (2,), x and y polarisation: n_out / n_in along z."""
    ratios = [_power_across(cell, e, cell.far_side) / _power_across(cell, e, cell.side) for e in np.eye(2)]
    return np.array(ratios)


def _power_across(cell: PillarCell, field: ComplexArray | FloatArray, side: Side) -> float:
    """Power along z of a zero order with tangential field (x, y) on ``side``, in units of |E|^2 in vacuum."""
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
