"""A closed-form solver with guided-mode ridges, for library tests that must not depend on a real solver.

t_xx is a smooth background times Lorentzian (Breit-Wigner) factors 1 - 2i g / (s(W, L) + i g), whose pole lies
on the curve s = 0 and whose half width is g nanometres; t_yy is the same with width and length swapped.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell import CellNumerics, CellResponse, CellSolver, PillarCell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import SolverError

#: Half widths of the two ridges, nm.
HALF_WIDTHS_NM = (3.0, 1.0)


def amplitude(width_nm: float, length_nm: float) -> complex:
    """t_xx of the model."""
    w, h = (width_nm - 175.0) / 75.0, (length_nm - 175.0) / 75.0
    t = 1.2 * (1.0 - 0.2 * (w + 1.0) * (h + 1.0) / 4.0) * cmath.exp(1j * (3.5 * w + 1.0 * h + 0.5 * w * h))
    curves = (width_nm - 170.0 + 0.35 * (length_nm - 175.0), width_nm + 0.6 * length_nm - 370.0 + 6.0 * h * h)
    for distance_nm, half_width_nm in zip(curves, HALF_WIDTHS_NM, strict=True):
        t *= 1.0 - 0.9j * half_width_nm / (distance_nm + 1j * half_width_nm)
    return t


def solve(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
    """A response in closed form, with a certificate of 1e-6."""
    x, y = amplitude(cell.width_nm, cell.length_nm), amplitude(cell.length_nm, cell.width_nm)
    return CellResponse(
        cell=cell,
        numerics=numerics,
        t=np.diag([x, y]),
        r=np.diag([0.1 * x, 0.1 * y]),
        error=1e-6,
        converged=True,
        resolution=1,
        seconds=0.0,
    )


def solve_with_slopes(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
    """The same with slopes by differences over 2e-3 nm, which leave 1e-6 of them, where they are asked for."""
    if not numerics.slopes:
        return solve(cell, numerics)
    rows = []
    for name in ("width_nm", "length_nm"):
        ends = [solve(replace(cell, **{name: getattr(cell, name) + step}), numerics) for step in (1e-3, -1e-3)]
        up, down = (np.append(end.t.diagonal(), end.r.diagonal()) for end in ends)
        rows.append((up - down) / 2e-3)
    return replace(solve(cell, numerics), slopes=np.array(rows))


def solve_scaled(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
    """The same at any wavelength: a longer wave sees smaller pillars, as Maxwell's equations scale."""
    scale = 800.0 / cell.wavelength_nm
    return solve(replace(cell, width_nm=scale * cell.width_nm, length_nm=scale * cell.length_nm), numerics)


def solve_shifted(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
    """Sizes that are off by 0.01 nm, as a truncation shifts resonances; certificates have a margin of 1.4."""
    true = solve(cell, numerics)
    off = solve(replace(cell, width_nm=cell.width_nm + 0.01, length_nm=cell.length_nm + 0.01), numerics)
    return replace(off, cell=cell, error=1.4 * float(np.abs(off.t - true.t).max()))


def solve_poorly_in_a_corner(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
    """The same, but unable to certify pillars beyond 240 nm in both sides."""
    answer = solve(cell, numerics)
    error = 0.05 if min(cell.width_nm, cell.length_nm) > 240.0 else 1e-6
    return CellResponse(cell, numerics, answer.t, answer.r, error, error < numerics.target_error, 1, 0.0)


class DyingSolver:
    """Solves so many cells and then fails, as a killed program does."""

    def __init__(self, lives: int, solver: CellSolver = solve) -> None:
        self.lives = lives
        self.solver = solver
        self.calls = 0

    def __call__(self, cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        self.calls += 1
        if self.calls > self.lives:
            raise SolverError("out of lives")
        return self.solver(cell, numerics)


@dataclass(frozen=True)
class Shifted:
    """A model with the closed form's values off by a constant, and only that constant on a grid."""

    off: float

    def __call__(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        x = np.array([amplitude(w, h) for w, h in zip(width_nm, length_nm, strict=True)])
        y = np.array([amplitude(h, w) for w, h in zip(width_nm, length_nm, strict=True)])
        return np.asarray(np.stack([x, y, 0.1 * x, 0.1 * y], axis=-1) + self.off, dtype=np.complex128)

    def on_grid(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        return np.full((4, length_nm.size, width_nm.size), self.off, dtype=np.complex128)
