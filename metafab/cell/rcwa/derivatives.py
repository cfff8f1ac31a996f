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

from metafab.cell import PillarCell
from metafab.cell.rcwa.basis.axis import (
    AxisBasis,
    AxisParity,
    even_matrix,
    odd_matrix,
    plane_waves_of_axis,
    symmetric_axis,
    travelling_axis,
)
from metafab.cell.rcwa.basis.coordinates import Formulation, Interval, Matrix, WallMap, stretched
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.jones import one_thread
from metafab.cell.rcwa.layers.factorisation import inverse_of_direct_rule, inverse_rule, kron
from metafab.cell.rcwa.scattering.half_space import PlaneWaves, plane_waves
from metafab.cell.rcwa.scattering.modes import FaceFields, LayerModes, layer_modes, match_modes
from metafab.cell.rcwa.symmetry import SymmetryClass, permittivity, symmetry_classes
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import Fault, InputError

#: Used for a propagation constant of zero: at a Rayleigh anomaly the derivative is infinite.
_SMALLEST = 1e-9


@dataclass(frozen=True)
class PillarDerivatives:
    """Jones matrices at one truncation and their derivatives by width, length, height (1/nm) and n_pillar.

    The derivative by the index is analytic: i times it is the derivative by the extinction.
    """

    t: ComplexArray  #: Shape (2, 2), transmission as in :class:`metafab.cell.rcwa.jones.ZeroOrder`.
    r: ComplexArray  #: Shape (2, 2), reflection.
    d_t: ComplexArray  #: Shape (4, 2, 2), derivatives of t.
    d_r: ComplexArray  #: Shape (4, 2, 2), derivatives of r.


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
        _axis_tangent(period, size, orders, formulation)
        for period, size in zip(cell.period_nm, (cell.width_nm, cell.length_nm), strict=True)
    ]
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    d_t, d_r = np.zeros((4, 2, 2), dtype=np.complex128), np.zeros((4, 2, 2), dtype=np.complex128)
    with one_thread():
        for case in symmetry_classes(cell, orders, formulation):
            faces, of_t, of_r = _amplitude_tangents(case, tangents)
            t += case.incident.T @ faces.transmitted
            r += case.incident.T @ faces.reflected
            d_t, d_r = d_t + of_t, d_r + of_r
    return PillarDerivatives(t, r, d_t, d_r)


class _Change(NamedTuple):
    """dP and dQ of a layer or half space, in (TM, TE)."""

    p: Matrix
    q: Matrix


def _amplitude_tangents(
    case: SymmetryClass, tangents: list[AxisBasis]
) -> tuple[FaceFields, ComplexArray, ComplexArray]:
    """Field at the faces of one class, and derivatives of t and r, each of shape (4, 2, 2)."""
    cell, basis, incident, k0_per_nm = case.cell, case.basis, case.incident, case.cell.k0_per_nm
    eps = [permittivity(n) for n in (cell.n_pillar, cell.n_ambient, case.n_in, case.n_out)]
    incoming, outgoing = (plane_waves(basis, k0_per_nm, each) for each in eps[2:])
    modes, thickness = layer_modes(*case.matrices()), case.thickness_k0()
    first = _layer_field(modes, thickness, incoming, outgoing, incident)
    from_far = _reversed(_layer_field(modes, thickness, outgoing, incoming, incident))

    def change(axis: int, eps_inside: complex, eps_around: complex) -> _Change:
        moved = _like((basis.u, basis.v)[axis], tangents[axis])
        d_u, d_v = (moved, None) if axis == 0 else (None, moved)
        return _Change(*_layer_tangents(basis, d_u, d_v, k0_per_nm, eps_inside, eps_around))

    totals: list[list[ComplexArray]] = []
    for axis in (0, 1):
        layer = _layer_kernel(modes, thickness, change(axis, eps[0], eps[1]))
        near = _half_space_kernel(incoming, change(axis, eps[2], eps[2]))
        far = _half_space_kernel(outgoing, change(axis, eps[3], eps[3]))
        totals.append(
            [
                layer.total(first, second)
                + second.faces.reflected.T @ near @ first.faces.reflected
                + second.faces.transmitted.T @ far @ first.faces.transmitted
                for second in (from_far, first)
            ]
        )

    p, q = case.matrices()
    y_far = _admittance(outgoing)[:, None]
    e, h = first.faces.transmitted, y_far * first.faces.transmitted
    at_far = [
        (incident + from_far.faces.transmitted, y_far * (from_far.faces.transmitted - incident)),
        (first.faces.transmitted, y_far * first.faces.transmitted),
    ]
    totals.append([k0_per_nm * (a.T @ q @ e - b.T @ p @ h) for a, b in at_far])

    d_eps = 2.0 * complex(cell.n_pillar)
    by_index = _Change(*_layer_tangents(basis, None, None, k0_per_nm, eps[0], eps[1], d_eps))
    kernel = _layer_kernel(modes, thickness, by_index)
    totals.append([kernel.total(first, second) for second in (from_far, first)])

    sides = [
        np.linalg.pinv(2.0 * incident.T @ (_admittance(waves)[:, None] * incident)) for waves in (outgoing, incoming)
    ]
    d_t, d_r = (np.stack([1j * side @ total[k] for total in totals]) for k, side in enumerate(sides))
    return first.faces, d_t, d_r


def _reversed(field: _LayerField) -> _LayerField:
    """The field of light from the far side, in the order of :class:`_LayerField` along +z."""
    faces = FaceFields(field.faces.reflected, field.faces.transmitted, 0.0)
    return _LayerField(field.backward, field.forward, faces)


class _LayerField(NamedTuple):
    """Field in a layer, shapes (n, p): c+ of each mode where it begins, c- where it ends; and at the faces."""

    forward: ComplexArray
    backward: ComplexArray
    faces: FaceFields


def _layer_field(
    modes: LayerModes, thickness: float, incoming: PlaneWaves, outgoing: PlaneWaves, incident: ComplexArray
) -> _LayerField:
    faces = match_modes(modes, thickness, incoming, outgoing, incident)
    e_near, h_near = incident + faces.reflected, _admittance(incoming)[:, None] * (incident - faces.reflected)
    e_far, h_far = faces.transmitted, _admittance(outgoing)[:, None] * faces.transmitted
    forward = 0.5 * (np.linalg.solve(modes.e, e_near) + np.linalg.solve(modes.h, h_near))
    backward = 0.5 * (np.linalg.solve(modes.e, e_far) - np.linalg.solve(modes.h, h_far))
    return _LayerField(np.asarray(forward, np.complex128), np.asarray(backward, np.complex128), faces)


def _like(axis: AxisParity, tangent: AxisBasis) -> AxisParity:
    """``tangent`` in the families of ``axis``; the incident wave number of a travelling wave does not change."""
    if axis.label_a.size == axis.label_b.size:
        return travelling_axis(tangent, 0.0)
    return symmetric_axis(tangent, even_first=bool(axis.label_a[0] == 0))


class _LayerKernel(NamedTuple):
    """Integral over the layer of a^T dQ e - b^T dP h, between modes that run the same way and opposite ways."""

    same: ComplexArray
    opposite: ComplexArray

    def total(self, first: _LayerField, second: _LayerField) -> ComplexArray:
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


def _axis_tangent(period_nm: float, size_nm: float, orders: int, formulation: Formulation) -> AxisBasis:
    """Derivative of :func:`metafab.cell.rcwa.basis.axis.outline_bases` of one outline with respect to its size, 1/nm.

    The basis functions rotate among each other as the map follows the pillar: perturbation theory of the definite pair
    (D F_odd^-1 D^T, F_even) and of its odd partner, whose eigenvalues are equal to its own and all distinct.
    """
    (pillar, whole), (d_pillar, d_whole) = _cosine_integrals(period_nm, size_nm, orders, formulation)
    wavenumber, even, odd = plane_waves_of_axis(period_nm, whole, orders)
    metric_even, metric_odd = even.T @ even_matrix(d_whole, orders) @ even, odd.T @ odd_matrix(d_whole, orders) @ odd
    k = np.concatenate([[0.0], wavenumber])
    lifted = np.zeros_like(metric_even)
    lifted[1:, 1:] = metric_odd
    tangents = []
    for vectors, weight, metric, partner, waves in (
        (even, even_matrix, metric_even, lifted, k),
        (odd, odd_matrix, metric_odd, metric_even[1:, 1:], wavenumber),
    ):
        gap = waves**2 - waves[:, None] ** 2
        np.fill_diagonal(gap, 1.0)
        turn = -(waves[:, None] * partner * waves + metric * waves**2) / gap
        np.fill_diagonal(turn, -0.5 * np.diag(metric))
        carried = vectors.T @ weight(pillar, orders) @ vectors @ turn
        tangents.append(vectors.T @ weight(d_pillar, orders) @ vectors + carried + carried.T)
    d_wavenumber = -0.5 * wavenumber * (np.diag(metric_odd) + np.diag(metric_even)[1:])
    return AxisBasis(d_wavenumber, tangents[0], tangents[1])


def _cosine_integrals(
    period_nm: float, size_nm: float, orders: int, formulation: Formulation
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Cosine integrals over the pillar and the period, and their derivatives by the size, by a complex step.

    The closed forms are analytic in the fill and the wall, so that nothing cancels.
    """
    fill, step = size_nm / period_nm, 1e-30
    wall_map, per_fill = WallMap(fill, 1.0, 1.0), 1.0
    if formulation == "adaptive":
        wall_map = stretched(period_nm, size_nm, orders)
        # The wall's place is linear in the fill.
        low, high = (stretched(1.0, share, orders).wall_fraction for share in (0.25, 0.75))
        per_fill = (high - low) / 0.5
    fill_step, wall_step = fill + 1j * step, wall_map.wall_fraction + 1j * step * per_fill
    k = np.arange(2 * orders + 1)
    pillar = Interval(0.0, wall_step, fill_step, 1.0 - wall_map.slope_inside).cosine_integral(k)  # type: ignore[arg-type]
    outside = Interval(wall_step, 1.0, 1.0 - fill_step, wall_map.slope_outside - 1.0)  # type: ignore[arg-type]
    whole = pillar + outside.cosine_integral(k)
    values = np.asarray(pillar.real), np.asarray(whole.real)
    return values, (pillar.imag / (step * period_nm), whole.imag / (step * period_nm))


def _layer_tangents(
    basis: TransverseBasis,
    d_u: AxisParity | None,
    d_v: AxisParity | None,
    k0_per_nm: float,
    eps_pillar: complex,
    eps_around: complex,
    d_eps_pillar: complex = 0.0,
) -> tuple[Matrix, Matrix]:
    """Derivatives dP and dQ of :func:`metafab.cell.rcwa.layers.factorisation.layer_matrices`.

    Args:
        basis: symmetry class, n coefficients.
        d_u: derivative of the axis along x; None where it does not change.
        d_v: derivative of the axis along y; None where it does not change.
        eps_pillar: permittivity of the pillar; that of a uniform medium leaves the change of its wave numbers alone.
        eps_around: permittivity around the pillar.
        d_eps_pillar: derivative of the pillar's permittivity.

    Returns:
        dP and dQ in the (TM, TE) basis, each of shape (n, n).
    """
    u, v = basis.u, basis.v
    d_u, d_v = d_u or _unchanged(u), d_v or _unchanged(v)
    n_u = u.label_a.size * v.label_a.size
    step = eps_pillar - eps_around
    rule_u, rule_v = (inverse_rule(x, eps_pillar, eps_around) for x in (u.a, v.b))
    # eps_u = rule(u) (x) v + eps_around (1 (x) (1 - v)), and the same with u and v exchanged for eps_v.
    d_inverse = -d_eps_pillar / eps_pillar**2
    d_eps_u = kron(_inverse_rule_tangent(rule_u, d_u.a, eps_pillar, eps_around, d_inverse * u.a), v.a)
    d_eps_u = d_eps_u + kron(rule_u - eps_around * np.eye(len(u.a)), d_v.a)
    d_eps_v = kron(u.b, _inverse_rule_tangent(rule_v, d_v.b, eps_pillar, eps_around, d_inverse * v.b))
    d_eps_v = d_eps_v + kron(d_u.b, rule_v - eps_around * np.eye(len(v.b)))
    eta_z = inverse_of_direct_rule(u.b, v.a, eps_pillar, eps_around)
    d_eps_z = step * (kron(d_u.b, v.a) + kron(u.b, d_v.a)) + d_eps_pillar * kron(u.b, v.a)
    d_eta_z = -eta_z @ d_eps_z @ eta_z

    from_e_z, from_h_z = _longitudinal(u, v, k0_per_nm)
    d_from_e_z, d_from_h_z = _longitudinal(d_u, d_v, k0_per_nm)
    half_p = d_from_e_z @ eta_z @ from_e_z.T
    half_q = d_from_h_z @ from_h_z.T
    p = -(half_p + half_p.T + from_e_z @ d_eta_z @ from_e_z.T)
    q = -(half_q + half_q.T).astype(d_eps_u.dtype)
    q[:n_u, :n_u] += d_eps_u
    q[n_u:, n_u:] += d_eps_v
    return basis.to_tm_te(p), basis.to_tm_te(q)


def _longitudinal(u: AxisParity, v: AxisParity, k0_per_nm: float) -> tuple[FloatArray, FloatArray]:
    """B and C: the contributions of E_z and H_z to the transverse equations."""
    k_u, k_v = _wavenumber(u) / k0_per_nm, _wavenumber(v) / k0_per_nm
    from_e_z = np.concatenate([kron(k_u, np.eye(len(v.a))), kron(np.eye(len(u.b)), k_v.T)])
    from_h_z = np.concatenate([kron(np.eye(len(u.a)), k_v), -kron(k_u.T, np.eye(len(v.b)))])
    return from_e_z, from_h_z


def _unchanged(axis: AxisParity) -> AxisParity:
    return AxisParity(0.0 * axis.a, 0.0 * axis.b, axis.label_a, axis.label_b, 0.0 * axis.wavenumber)


def _inverse_rule_tangent(
    rule: Matrix, d_overlap: FloatArray, eps_pillar: complex, eps_around: complex, also: Matrix
) -> Matrix:
    return np.asarray(-rule @ (d_overlap * (1.0 / eps_pillar - 1.0 / eps_around) + also) @ rule)


def _wavenumber(axis: AxisParity) -> FloatArray:
    same = axis.label_a[:, None] == axis.label_b
    return np.asarray(np.where(same, axis.wavenumber[axis.label_b], 0.0))
