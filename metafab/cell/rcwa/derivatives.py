"""Derivatives of the Jones matrices by what the pillar is, from one solution and its reverse.

P and Q are symmetric, so that for a field (e, h) and a second one (a, b) of the same equations, lit from either side,
d/dz (a^T dh - de^T b) = i (a^T dQ e - b^T dP h). Integrated over z this is the Lorentz reciprocity of the truncated
equations: with Y the admittance of the zero order on the side that the second field is lit from and its amplitude e_0,

    2 e_0^T Y d(amplitudes) = i int (a^T dQ e - b^T dP h) dz,

exactly, for the change dP, dQ of the truncated matrices, the stretched coordinate included, and at any angle: the
second field has the same wave vectors, and stands for light that comes back along the first. Modes make the integral a
closed form, so each derivative costs a few matrix products beside the eigenvalue problem. In the half spaces only the
evanescent waves of the stretched basis change; the zero order does not. A taller layer is the same layer with a sheet
of P and Q more at its far face, where the integrand is known without an integral.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from metafab.cell.rcwa.basis.axis import (
    AxisBasis,
    AxisParity,
    Formulation,
    Matrix,
    axis_tangent,
    symmetric_axis,
    travelling_axis,
)
from metafab.cell.rcwa.jones import (
    ClassSolution,
    SymmetryClass,
    matrices,
    one_thread,
    permittivity,
    solve_class,
    symmetry_classes,
)
from metafab.cell.rcwa.layers.factorisation import layer_tangents
from metafab.cell.rcwa.scattering.admittance import LayerField, through_layer
from metafab.cell.rcwa.scattering.eigenmodes import LayerModes, PlaneWaves
from metafab.cell.response import PillarCell
from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError

#: Stands for a propagation constant of zero: at a Rayleigh anomaly the derivative is infinite.
_SMALLEST = 1e-9


@dataclass(frozen=True)
class PillarDerivatives:
    """Jones matrices at one truncation and their derivatives.

    Attributes:
        t: shape (2, 2); ``r`` likewise, as in :class:`metafab.cell.rcwa.jones.ZeroOrder`.
        t_per_width: shape (2, 2), d t / d width, 1/nm; likewise by length and height, and of r.
        t_per_index: shape (2, 2), d t / d n_pillar; analytic, so that times i it is that by the extinction.
    """

    t: ComplexArray
    r: ComplexArray
    t_per_width: ComplexArray
    t_per_length: ComplexArray
    t_per_height: ComplexArray
    t_per_index: ComplexArray
    r_per_width: ComplexArray
    r_per_length: ComplexArray
    r_per_height: ComplexArray
    r_per_index: ComplexArray


def derivatives(cell: PillarCell, orders: int, formulation: Formulation = "adaptive") -> PillarDerivatives:
    """Jones matrices of ``cell`` and their derivatives by both sizes, height and index; any angle of incidence.

    The direction of the light is held (its wave vector in the plane of the cell).

    Args:
        cell: a pillar with upright walls: sizes above 0 and below the period.
        orders: cosines along each axis.
        formulation: "adaptive" or "fourier".

    Raises:
        InputError: the pillar has no walls along an axis, sloped ones, layers under or over it, or a birefringent
            substrate; or as :func:`metafab.cell.rcwa.jones.zero_order`.
    """
    _check(cell)
    tangents = [
        axis_tangent(period, size, orders, formulation)
        for period, size in zip(cell.period_nm, (cell.width_nm, cell.length_nm), strict=True)
    ]
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    d_t, d_r = np.zeros((4, 2, 2), dtype=np.complex128), np.zeros((4, 2, 2), dtype=np.complex128)
    with one_thread():
        for case in symmetry_classes(cell, (orders, orders), formulation):
            solution, incident = solve_class(cell, case), case.basis.zero_order()
            t += incident.T @ solution.field.transmitted
            r += incident.T @ solution.field.reflected
            of_t, of_r = _amplitude_tangents(cell, case, solution, tangents)
            d_t, d_r = d_t + of_t, d_r + of_r
    return PillarDerivatives(t, r, *d_t, *d_r)


def _check(cell: PillarCell) -> None:
    if cell.under or cell.over:
        raise InputError.single("cell", "under, over", "empty for derivatives", "layers")
    if cell.is_sloped:
        raise InputError.single("cell", "sidewall_angle_deg", "90 for derivatives", f"{cell.sidewall_angle_deg:g}")
    if cell.is_shaped:
        raise InputError.single("cell", "shape, corner_radius_nm", "a plain rectangle for derivatives", cell.shape)
    if cell.is_birefringent:
        raise InputError.single("cell", "n_substrate_z", "that of an isotropic substrate", f"{cell.n_substrate_z}")
    for name, size, period in zip(
        ("width_nm", "length_nm"), (cell.width_nm, cell.length_nm), cell.period_nm, strict=True
    ):
        if not 0.0 < size < period:
            raise InputError.single("cell", name, f"above 0 and below the period of {period:g} nm", f"{size:g} nm")


class _Change(NamedTuple):
    """dP and dQ of a layer or half space, in (TM, TE)."""

    p: Matrix
    q: Matrix


def _amplitude_tangents(
    cell: PillarCell, case: SymmetryClass, solution: ClassSolution, tangents: list[AxisBasis]
) -> tuple[ComplexArray, ComplexArray]:
    """Derivatives of t and r of one class, each of shape (4, 2, 2): by width, length, height and index."""
    basis, incident = case.basis, case.basis.zero_order()
    modes, incoming, outgoing = solution.modes, solution.incoming, solution.outgoing
    k0_per_nm = 2.0 * math.pi / cell.wavelength_nm
    thickness = k0_per_nm * cell.height_nm
    first = solution.field
    from_far = _reversed(through_layer(modes, thickness, outgoing, incoming, incident))
    eps = [permittivity(n) for n in (cell.n_pillar, cell.n_ambient, case.n_in, case.n_out)]

    def change(axis: int, eps_inside: complex, eps_around: complex) -> _Change:
        moved = _like((basis.u, basis.v)[axis], tangents[axis])
        d_u, d_v = (moved, None) if axis == 0 else (None, moved)
        return _Change(*layer_tangents(basis, d_u, d_v, k0_per_nm, eps_inside, eps_around))

    totals: list[list[ComplexArray]] = []
    for axis in (0, 1):
        layer = _layer_kernel(modes, thickness, change(axis, eps[0], eps[1]))
        near = _half_space_kernel(incoming, change(axis, eps[2], eps[2]))
        far = _half_space_kernel(outgoing, change(axis, eps[3], eps[3]))
        totals.append(
            [
                layer.total(first, second)
                + second.reflected.T @ near @ first.reflected
                + second.transmitted.T @ far @ first.transmitted
                for second in (from_far, first)
            ]
        )

    p, q = matrices(cell, case)
    y_far = _admittance(outgoing)[:, None]
    e, h = first.transmitted, y_far * first.transmitted
    at_far = [
        (incident + from_far.transmitted, y_far * (from_far.transmitted - incident)),
        (first.transmitted, y_far * first.transmitted),
    ]
    totals.append([k0_per_nm * (a.T @ q @ e - b.T @ p @ h) for a, b in at_far])

    d_eps = 2.0 * complex(cell.n_pillar)
    by_index = _Change(*layer_tangents(basis, None, None, k0_per_nm, eps[0], eps[1], d_eps))
    kernel = _layer_kernel(modes, thickness, by_index)
    totals.append([kernel.total(first, second) for second in (from_far, first)])

    sides = [
        np.linalg.pinv(2.0 * incident.T @ (_admittance(waves)[:, None] * incident)) for waves in (outgoing, incoming)
    ]
    d_t, d_r = (np.stack([1j * side @ total[k] for total in totals]) for k, side in enumerate(sides))
    return d_t, d_r


def _reversed(field: LayerField) -> LayerField:
    """The field of light from the far side, written as that of :class:`LayerField` along +z."""
    return LayerField(field.backward, field.forward, field.reflected, field.transmitted)


def _like(axis: AxisParity, tangent: AxisBasis) -> AxisParity:
    """``tangent`` in the families of ``axis``; what is split off a travelling wave does not change."""
    if axis.label_a.size == axis.label_b.size:
        return travelling_axis(tangent, 0.0)
    return symmetric_axis(tangent, even_first=bool(axis.label_a[0] == 0))


class _LayerKernel(NamedTuple):
    """Integral over the layer of a^T dQ e - b^T dP h, between modes that run the same way and opposite ways."""

    same: ComplexArray
    opposite: ComplexArray

    def total(self, first: LayerField, second: LayerField) -> ComplexArray:
        """Shape (2, 2): [column of ``second``, column of ``first``]."""
        same = second.forward.T @ self.same @ first.forward + second.backward.T @ self.same @ first.backward
        opposite = second.forward.T @ self.opposite @ first.backward + second.backward.T @ self.opposite @ first.forward
        return np.asarray(same + opposite)


def _layer_kernel(modes: LayerModes, thickness: float, change: _Change) -> _LayerKernel:
    beta = modes.beta
    total, gap = beta[:, None] + beta, beta[:, None] - beta
    decay = np.exp(1j * beta * thickness)
    along = (decay[:, None] * decay - 1.0) / (1j * total)
    close = np.abs(gap) * thickness < 1e-4
    # Two opposite waves of nearly the same beta: the first terms of the series in gap, else the difference.
    series = thickness * np.exp(0.5j * total * thickness) * (1.0 - (gap * thickness) ** 2 / 24.0)
    against = np.where(close, series, (decay[:, None] - decay) / (1j * np.where(close, 1.0, gap)))
    from_q, from_p = modes.e.T @ change.q @ modes.e, modes.h.T @ change.p @ modes.h
    return _LayerKernel((from_q - from_p) * along, (from_q + from_p) * against)


def _half_space_kernel(waves: PlaneWaves, change: _Change) -> ComplexArray:
    """The same over a half space, shape (n, n), between the transverse E of outgoing waves where it begins.

    The zero order, incident light included, drops out: nothing in dP and dQ touches it.
    """
    admittance = _admittance(waves)
    beta = np.where(waves.beta == 0.0, _SMALLEST, waves.beta)
    length = 1j / (beta[:, None] + beta)
    return np.asarray((change.q - admittance[:, None] * change.p * admittance) * length)


def _admittance(waves: PlaneWaves) -> ComplexArray:
    return np.asarray(waves.h / np.where(waves.e == 0.0, _SMALLEST, waves.e))
