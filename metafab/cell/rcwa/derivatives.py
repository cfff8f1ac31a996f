"""Derivatives of the Jones matrices by the pillar's width and length, from one solution and its reverse.

P and Q are symmetric, so that for a field (e, h) and a second one (a, b) of the same cell, lit from the other side,
d/dz (a^T dh - de^T b) = i (a^T dQ e - b^T dP h). Integrated over z this is the Lorentz reciprocity of the truncated
equations: with n the index on the side that the second field is lit from,

    2 n d(amplitude) = i int (a^T dQ e - b^T dP h) dz,

exactly, for the change dP, dQ of the truncated matrices, the stretched coordinate included. Modes make the integral a
closed form, so both derivatives cost a few matrix products beside the eigenvalue problem. In the half spaces
only the evanescent waves of the stretched basis change; the zero order does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.admittance import LayerField, through_layer
from metafab.cell.rcwa.basis import AxisBasis, AxisParity, Formulation, axis_tangent, symmetric_axis
from metafab.cell.rcwa.eigenmodes import LayerModes, PlaneWaves
from metafab.cell.rcwa.factorisation import layer_tangents
from metafab.cell.rcwa.jones import (
    ClassSolution,
    SymmetryClass,
    axis_orders,
    one_thread,
    permittivity,
    solve_class,
    symmetry_classes,
)
from metafab.cell.rcwa.transverse import TransverseBasis
from metafab.cell.response import PillarCell
from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError

#: Stands for a propagation constant of zero: at a Rayleigh anomaly the derivative is infinite.
_SMALLEST = 1e-9


@dataclass(frozen=True)
class SizeDerivatives:
    """Jones matrices at one truncation and their derivatives.

    Attributes:
        t: shape (2, 2); ``r`` likewise, as in :class:`metafab.cell.rcwa.jones.ZeroOrder`.
        t_per_width: shape (2, 2), d t / d width, 1/nm; likewise the other three.
    """

    t: ComplexArray
    r: ComplexArray
    t_per_width: ComplexArray
    t_per_length: ComplexArray
    r_per_width: ComplexArray
    r_per_length: ComplexArray


def derivatives(cell: PillarCell, orders: int, formulation: Formulation = "adaptive") -> SizeDerivatives:
    """Jones matrices of ``cell`` at normal incidence, and their derivatives by both sizes.

    Args:
        cell: a pillar with walls: sizes above 0 and below the period.
        orders: cosines along the longer period.
        formulation: "adaptive" or "fourier".

    Raises:
        InputError: the light comes at an angle, the pillar has no walls along an axis, or layers under or over it.
    """
    _check(cell)
    by_orders = axis_orders(cell, orders)
    tangents = [
        axis_tangent(period, size, count, formulation)
        for period, size, count in zip(cell.period_nm, (cell.width_nm, cell.length_nm), by_orders, strict=True)
    ]
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    d_t, d_r = np.zeros((2, 2, 2), dtype=np.complex128), np.zeros((2, 2, 2), dtype=np.complex128)
    with one_thread():
        for i, case in enumerate(symmetry_classes(cell, by_orders, formulation)):
            solution, incident = solve_class(cell, case), case.basis.zero_order()
            t += incident.T @ solution.field.transmitted
            r += incident.T @ solution.field.reflected
            for axis in (0, 1):
                d_t[axis, i, i], d_r[axis, i, i] = _amplitude_tangents(cell, case, solution, tangents[axis], axis, i)
    return SizeDerivatives(t, r, d_t[0], d_t[1], d_r[0], d_r[1])


def _check(cell: PillarCell) -> None:
    if cell.angle_deg != 0.0:
        raise InputError.single("cell", "angle_deg", "0 for derivatives", f"{cell.angle_deg:g}")
    if cell.under or cell.over:
        raise InputError.single("cell", "under, over", "empty for derivatives", "layers")
    for name, size, period in zip(
        ("width_nm", "length_nm"), (cell.width_nm, cell.length_nm), cell.period_nm, strict=True
    ):
        if not 0.0 < size < period:
            raise InputError.single("cell", name, f"above 0 and below the period of {period:g} nm", f"{size:g} nm")


@dataclass(frozen=True)
class _Change:
    """dP and dQ of the layer and of a half space, in (TM, TE)."""

    p: ComplexArray
    q: ComplexArray


def _amplitude_tangents(
    cell: PillarCell, case: SymmetryClass, solution: ClassSolution, tangent: AxisBasis, axis: int, polarisation: int
) -> tuple[complex, complex]:
    k0_per_nm = 2.0 * math.pi / cell.wavelength_nm
    thickness = k0_per_nm * cell.height_nm
    modes, incoming, outgoing = solution.modes, solution.incoming, solution.outgoing
    incident = case.basis.zero_order()
    reverse = through_layer(modes, thickness, outgoing, incoming, incident)

    d_axis = symmetric_axis(tangent, even_first=polarisation == 0)
    eps = [permittivity(n) for n in (cell.n_pillar, cell.n_ambient, case.n_in, case.n_out)]
    layer = _change(case.basis, d_axis, axis, k0_per_nm, eps[0], eps[1])
    near = _change(case.basis, d_axis, axis, k0_per_nm, eps[2], eps[2])
    far = _change(case.basis, d_axis, axis, k0_per_nm, eps[3], eps[3])

    def reciprocity(second: LayerField) -> complex:
        first, column = solution.field, polarisation
        total = _layer_integral(modes, thickness, layer, first, second, column)
        total += _half_space_integral(incoming, near, first.reflected[:, column], second.reflected[:, column])
        total += _half_space_integral(outgoing, far, first.transmitted[:, column], second.transmitted[:, column])
        return 0.5j * total

    return reciprocity(_reversed(reverse)) / case.n_out, reciprocity(solution.field) / case.n_in


def _reversed(field: LayerField) -> LayerField:
    """The field of light from the far side, written as that of :class:`LayerField` along +z."""
    return LayerField(field.backward, field.forward, field.reflected, field.transmitted)


def _change(
    basis: TransverseBasis, tangent: AxisParity, axis: int, k0_per_nm: float, eps_pillar: complex, eps_around: complex
) -> _Change:
    d_u, d_v = (tangent, None) if axis == 0 else (None, tangent)
    return _Change(*layer_tangents(basis, d_u, d_v, k0_per_nm, eps_pillar, eps_around))


def _layer_integral(
    modes: LayerModes, thickness: float, change: _Change, first: LayerField, second: LayerField, column: int
) -> complex:
    """Integral of a^T dQ e - b^T dP h over the layer."""
    beta = modes.beta
    total, gap = beta[:, None] + beta, beta[:, None] - beta
    decay = np.exp(1j * beta * thickness)
    along = (decay[:, None] * decay - 1.0) / (1j * total)
    close = np.abs(gap) * thickness < 1e-4
    # Two opposite waves of nearly the same beta: the first terms of the series in gap, else the difference.
    series = thickness * np.exp(0.5j * total * thickness) * (1.0 - (gap * thickness) ** 2 / 24.0)
    against = np.where(close, series, (decay[:, None] - decay) / (1j * np.where(close, 1.0, gap)))
    c_plus, c_minus = first.forward[:, column], first.backward[:, column]
    a_plus, a_minus = second.forward[:, column], second.backward[:, column]
    same = (np.outer(a_plus, c_plus) + np.outer(a_minus, c_minus)) * along
    mixed = (np.outer(a_plus, c_minus) + np.outer(a_minus, c_plus)) * against
    from_q = np.sum((modes.e.T @ change.q @ modes.e) * (same + mixed))
    from_p = np.sum((modes.h.T @ change.p @ modes.h) * (same - mixed))
    return complex(from_q - from_p)


def _half_space_integral(waves: PlaneWaves, change: _Change, first: ComplexArray, second: ComplexArray) -> complex:
    """The same over a half space, for outgoing waves of transverse E ``first`` and ``second``, each of shape (n,).

    The zero order, incident light included, drops out: nothing in dP and dQ touches it.
    """
    admittance = waves.h / np.where(waves.e == 0.0, _SMALLEST, waves.e)
    beta = np.where(waves.beta == 0.0, _SMALLEST, waves.beta)
    length = 1j / (beta[:, None] + beta)
    from_q = np.outer(second, first) * change.q
    from_p = np.outer(admittance * second, admittance * first) * change.p
    return complex(np.sum((from_q - from_p) * length))
