"""Derivatives of the Jones matrices by sizes, height and index, from one solution and its reverse.

P and Q are symmetric, so that for a field (e, h) and a second one (a, b) of the same equations, lit from either side,
d/dz (a^T dh - de^T b) = i (a^T dQ e - b^T dP h). Integrated over z this is the Lorentz reciprocity of the truncated
equations: with Y the admittance of the zero order on the side that the second field is lit from and its amplitude e_0,

    2 e_0^T Y d(amplitudes) = i int (a^T dQ e - b^T dP h) dz,

exactly, for the change dP, dQ of the truncated matrices, the stretched coordinate included, and at any angle: the
second field has the same wave vectors, and stands for light that returns along the first. Modes make the integral a
closed form, so that each derivative costs a few matrix products besides the eigenvalue problem. In the half spaces only
the evanescent waves of the stretched basis change; the zero order does not. A taller layer has one more sheet of P and
Q at its far face, where the integrand is known without an integral.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.axis import AxisBasis, AxisParity, axis_tangent, symmetric_axis, travelling_axis
from metafab.cell.rcwa.basis.coordinates import Formulation, Matrix
from metafab.cell.rcwa.jones import one_thread, solve_by_modes
from metafab.cell.rcwa.layers.factorisation import layer_tangents
from metafab.cell.rcwa.scattering.half_space import PlaneWaves, plane_waves
from metafab.cell.rcwa.scattering.mode_matching import LayerField, through_layer
from metafab.cell.rcwa.scattering.modes import LayerModes
from metafab.cell.rcwa.symmetry import SymmetryClass, permittivity, symmetry_classes
from metafab.core.conventions import ComplexArray
from metafab.core.errors import Fault, InputError

#: Used for a propagation constant of zero: at a Rayleigh anomaly the derivative is infinite.
_SMALLEST = 1e-9


@dataclass(frozen=True)
class PillarDerivatives:
    """Jones matrices at one truncation and their derivatives by width, length, height (1/nm) and n_pillar.

    The derivative by the index is analytic: i times it is the derivative by the extinction.

    Attributes:
        t: shape (2, 2), transmission as in :class:`metafab.cell.rcwa.jones.ZeroOrder`.
        r: shape (2, 2), reflection.
        d_t: shape (4, 2, 2), derivatives of t.
        d_r: shape (4, 2, 2), derivatives of r.
    """

    t: ComplexArray
    r: ComplexArray
    d_t: ComplexArray
    d_r: ComplexArray


def derivatives(cell: PillarCell, orders: int, formulation: Formulation = "adaptive") -> PillarDerivatives:
    """Jones matrices of ``cell`` and their derivatives by both sizes, height and index, at any angle of incidence.

    The light's wave vector in the plane of the cell is held constant.

    Args:
        cell: a plain rectangle with upright walls: sizes above 0 and below the period.
        orders: cosines along each axis.
        formulation: "adaptive" or "fourier".

    Raises:
        InputError: the cell is not such a pillar, or as :func:`metafab.cell.rcwa.jones.zero_order`.
    """
    faults = cell.untreated("derivatives", treated=("angle_deg",))
    sizes = (("width_nm", cell.width_nm), ("length_nm", cell.length_nm))
    faults += [
        Fault(name, f"above 0 and below the period of {period:g} nm", f"{size:g} nm")
        for (name, size), period in zip(sizes, cell.period_nm, strict=True)
        if not 0.0 < size < period
    ]
    if faults:
        raise InputError("cell", faults)
    tangents = [
        axis_tangent(period, size, orders, formulation)
        for period, size in zip(cell.period_nm, (cell.width_nm, cell.length_nm), strict=True)
    ]
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    d_t, d_r = np.zeros((4, 2, 2), dtype=np.complex128), np.zeros((4, 2, 2), dtype=np.complex128)
    with one_thread():
        for case in symmetry_classes(cell, orders, formulation):
            field, of_t, of_r = _amplitude_tangents(case, tangents)
            t += case.incident.T @ field.transmitted
            r += case.incident.T @ field.reflected
            d_t, d_r = d_t + of_t, d_r + of_r
    return PillarDerivatives(t, r, d_t, d_r)


class _Change(NamedTuple):
    """dP and dQ of a layer or half space, in (TM, TE)."""

    p: Matrix
    q: Matrix


def _amplitude_tangents(
    case: SymmetryClass, tangents: list[AxisBasis]
) -> tuple[LayerField, ComplexArray, ComplexArray]:
    """Field of one class, and derivatives of t and r by width, length, height and index, each of shape (4, 2, 2)."""
    cell, basis, incident, k0_per_nm = case.cell, case.basis, case.incident, case.cell.k0_per_nm
    eps = [permittivity(n) for n in (cell.n_pillar, cell.n_ambient, case.n_in, case.n_out)]
    incoming, outgoing = (plane_waves(basis, k0_per_nm, each) for each in eps[2:])
    modes, first = solve_by_modes(case, incoming, outgoing)
    thickness = case.thickness_k0()
    from_far = _reversed(through_layer(modes, thickness, outgoing, incoming, incident))

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

    p, q = case.matrices()
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
    return first, d_t, d_r


def _reversed(field: LayerField) -> LayerField:
    """The field of light from the far side, in the order of :class:`LayerField` along +z."""
    return LayerField(field.backward, field.forward, field.reflected, field.transmitted)


def _like(axis: AxisParity, tangent: AxisBasis) -> AxisParity:
    """``tangent`` in the families of ``axis``; the incident wave number of a travelling wave does not change."""
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
    # Opposite waves of nearly equal beta: the first terms of the series in gap, else the difference.
    series = thickness * np.exp(0.5j * total * thickness) * (1.0 - (gap * thickness) ** 2 / 24.0)
    against = np.where(close, series, (decay[:, None] - decay) / (1j * np.where(close, 1.0, gap)))
    from_q, from_p = modes.e.T @ change.q @ modes.e, modes.h.T @ change.p @ modes.h
    return _LayerKernel((from_q - from_p) * along, (from_q + from_p) * against)


def _half_space_kernel(waves: PlaneWaves, change: _Change) -> ComplexArray:
    """Integral over a half space between the transverse E of outgoing waves where it begins, shape (n, n).

    The zero order, incident light included, drops out: dP and dQ are zero there.
    """
    admittance = _admittance(waves)
    beta = np.where(waves.beta == 0.0, _SMALLEST, waves.beta)
    length = 1j / (beta[:, None] + beta)
    return np.asarray((change.q - admittance[:, None] * change.p * admittance) * length)


def _admittance(waves: PlaneWaves) -> ComplexArray:
    return np.asarray(waves.h / np.where(waves.e == 0.0, _SMALLEST, waves.e))
