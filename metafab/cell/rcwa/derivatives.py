"""Derivatives of the Jones matrices by sizes, height and index, from one solution and its reverse.

P and Q are symmetric, so that for a field (e, h) and a second one (a, b) of the same equations, lit from either side,
d/dz (a^T dh - de^T b) = i (a^T dQ e - b^T dP h). Integrated over z this is the Lorentz reciprocity of the truncated
equations: with Y the admittance of the zero order on the side that the second field is lit from and its amplitude e_0,

    2 e_0^T Y d(amplitudes) = i int (a^T dQ e - b^T dP h) dz,

exactly, for the change dP, dQ of the truncated matrices, the stretched coordinate included, and at any angle: the
second field has the same wave vectors, and stands for light that returns along the first. With F of half the layer
(:mod:`metafab.cell.rcwa.scattering.doubling`) and the sums and differences of the fields at the two faces, the integral
is

    -1/2 [(a(0) - a(d))^T d(P^-1 F) (e(0) - e(d)) - (a(0) + a(d))^T d(Q F^-1) (e(0) + e(d))],

so that dF has weights of rank two, which the doubling in reverse turns into weights of dP and dQ: the derivatives of t
and r together cost about a third of the solution. Where rounding forbids doubling, modes make the integral a closed
form. In the half spaces only the evanescent waves of the stretched basis change; the zero order does not. A taller
layer has one more sheet of P and Q at its far face, where the integrand is known without an integral.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.coordinates import Formulation, Matrix
from metafab.cell.rcwa.basis.tangent import like, outline_tangent
from metafab.cell.rcwa.jones import SolvedClass, ZeroOrder, solved_classes
from metafab.cell.rcwa.layers.tangents import LayerChange, RectangleLayer, WaveTangents, uniform_product
from metafab.cell.rcwa.scattering.doubling import Doubling
from metafab.cell.rcwa.scattering.half_space import PlaneWaves
from metafab.cell.rcwa.scattering.modes import FaceFields, layer_modes, match_modes
from metafab.cell.rcwa.scattering.reverse import pull_back_doubled
from metafab.cell.rcwa.symmetry import permittivity, polarisations_swap
from metafab.core.conventions import ComplexArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.executor import one_blas_thread

#: Replaces a propagation constant of zero: at a Rayleigh anomaly the derivative is infinite.
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
    if faults := _untreated(cell):
        raise InputError("cell", faults)
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    total = np.zeros((4, 2, 2, 2), dtype=np.complex128)
    with one_blas_thread():
        for solved in solved_classes(cell, orders, formulation, keep=True):
            t += solved.case.incident.T @ solved.faces.transmitted
            r += solved.case.incident.T @ solved.faces.reflected
            change = _ClassTangents(solved)
            total += np.stack([*change.by_sizes(orders, formulation), change.by_height(), change.by_index()])
    return PillarDerivatives(t, r, total[:, 0], total[:, 1])


def size_slopes(cell: PillarCell, solved: ZeroOrder, orders: int, formulation: Formulation) -> ComplexArray | None:
    """Derivatives of t_xx, t_yy, r_xx, r_yy by width and length, 1/nm, shape (2, 4); None for cells not treated.

    ``solved`` is the solution of ``cell`` with ``orders`` cosines, whose classes were kept.
    """
    if _untreated(cell):
        return None
    with one_blas_thread():
        by_size = sum(_ClassTangents(each).by_sizes(orders, formulation) for each in solved.kept)
    by_size = np.asarray(by_size)
    if polarisations_swap(cell):
        by_size = by_size + by_size[::-1, :, ::-1, ::-1]
    return np.asarray(np.einsum("skii->ski", by_size).reshape(2, 4))


def _untreated(cell: PillarCell) -> list[Fault]:
    faults = cell.untreated("derivatives", treated=("angle_deg",))
    sizes = (("width_nm", cell.width_nm), ("length_nm", cell.length_nm))
    return faults + [
        Fault(name, f"above 0 and below the period of {period:g} nm", f"{size:g} nm")
        for (name, size), period in zip(sizes, cell.period_nm, strict=True)
        if not 0.0 < size < period
    ]


class _Field(NamedTuple):
    """Transverse fields at the near and at the far face of the layer, shape (n, p) each."""

    near_e: ComplexArray
    near_h: ComplexArray
    far_e: ComplexArray
    far_h: ComplexArray
    sent: tuple[ComplexArray, ComplexArray]  #: E of the waves that leave at the near face, and at the far face.

    @property
    def sums(self) -> tuple[ComplexArray, ComplexArray]:
        """E and H of the near face plus those of the far one."""
        return self.near_e + self.far_e, self.near_h + self.far_h

    @property
    def differences(self) -> tuple[ComplexArray, ComplexArray]:
        """E and H of the near face less those of the far one."""
        return self.near_e - self.far_e, self.near_h - self.far_h


#: int (a^T dQ e - b^T dP h) dz over the layer for a change of it, shape (2, p, p): [a lit from the far or near side,
#: column of a, column of e].
_Integral = Callable[[LayerChange], ComplexArray]


class _ClassTangents:
    """Derivatives of t and r of one solved symmetry class, shape (2, 2, 2) each: [t or r, out, in]."""

    def __init__(self, solved: SolvedClass) -> None:
        case, incoming, outgoing = solved.case, solved.incoming, solved.outgoing
        assert isinstance(incoming, PlaneWaves) and isinstance(outgoing, PlaneWaves)
        self._case, self._waves = case, (incoming, outgoing)
        self._p, self._q = case.matrices() if solved.lit is None else (solved.lit.p, solved.lit.q)
        cell, basis = case.cell, case.basis
        eps = permittivity(cell.n_pillar), permittivity(cell.n_ambient)
        self._layer = RectangleLayer.of(basis, cell.k0_per_nm, *eps)
        self._columns = np.flatnonzero(case.incident.any(axis=0))
        incident, nothing = case.incident[:, self._columns], np.zeros((basis.size, self._columns.size), np.complex128)
        from_far, far_incident = self._lit_from_far(solved)
        self._first = self._field(incident, nothing, solved.faces.reflected, solved.faces.transmitted)
        self._seconds = self._field(nothing, far_incident, from_far.transmitted, from_far.reflected), self._first
        if solved.lit is not None:
            self._integral = _by_doubling(self._p, self._q, solved.lit.half, self._first, self._seconds)
        else:
            self._integral = _by_modes(self._p, self._q, case.thickness_k0(), self._first, self._seconds)
        lit = zip((far_incident, incident), (outgoing, incoming), strict=True)
        self._sides = [np.linalg.pinv(2.0 * e.T @ (_admittance(waves)[:, None] * incident)) for e, waves in lit]

    def by_sizes(self, orders: int, formulation: Formulation) -> ComplexArray:
        """By width and length, shape (2, 2, 2, 2), at the truncation of the solution."""
        cell, basis, k0_per_nm = self._case.cell, self._case.basis, self._case.cell.k0_per_nm
        found = []
        for axis, size_nm in enumerate((cell.width_nm, cell.length_nm)):
            tangent = outline_tangent(cell.period_nm[axis], size_nm, orders, formulation)
            d_axis = like((basis.u, basis.v)[axis], tangent)
            turned = WaveTangents.of(basis, d_axis, axis, k0_per_nm)
            total = self._integral(self._layer.by_size(d_axis, axis, turned))
            found.append(self._amplitudes(total + self._of_half_spaces(turned)))
        return np.stack(found)

    def by_height(self) -> ComplexArray:
        """By the layer's thickness."""
        e, h, k0_per_nm = self._first.far_e, self._first.far_h, self._case.cell.k0_per_nm
        total = [each.far_e.T @ self._q @ e - each.far_h.T @ self._p @ h for each in self._seconds]
        return self._amplitudes(k0_per_nm * np.stack(total))

    def by_index(self) -> ComplexArray:
        """By the pillar's index."""
        return self._amplitudes(self._integral(self._layer.by_index()))

    def _lit_from_far(self, solved: SolvedClass) -> tuple[FaceFields, ComplexArray]:
        """Fields that light from the far side excites, and its transverse E, shape (n, p)."""
        if solved.lit is not None:
            return solved.lit.from_far, solved.lit.far_incident[:, self._columns]
        modes, (incoming, outgoing) = layer_modes(self._p, self._q), self._waves
        incident = solved.case.incident
        faces = match_modes(modes, solved.case.thickness_k0(), outgoing, incoming, incident)
        return faces, incident[:, self._columns]

    def _field(self, near: ComplexArray, far: ComplexArray, sent_near: ComplexArray, sent_far: ComplexArray) -> _Field:
        """Fields at both faces, of incident E ``near`` and ``far``, shape (n, p), and all outgoing E, shape (n, 2)."""
        sent_near, sent_far = sent_near[:, self._columns], sent_far[:, self._columns]
        y_near, y_far = (_admittance(each)[:, None] for each in self._waves)
        h_near, h_far = y_near * (near - sent_near), y_far * (sent_far - far)
        return _Field(near + sent_near, h_near, far + sent_far, h_far, (sent_near, sent_far))

    def _of_half_spaces(self, turned: WaveTangents) -> ComplexArray:
        """The integral over both half spaces, of outgoing waves: the zero order drops out, as it does not change.

        Both fields have the same propagation constant in each wave, which makes the integral a closed form.
        """
        total = np.zeros((2, self._columns.size, self._columns.size), dtype=np.complex128)
        indices = self._case.n_in, self._case.n_out
        for side, (n, waves) in enumerate(zip(indices, self._waves, strict=True)):
            length = 0.5j / np.where(waves.beta == 0.0, _SMALLEST, waves.beta)[:, None]
            admittance, e = _admittance(waves)[:, None], self._first.sent[side]
            of_e, of_h = uniform_product(self._case.basis, turned, permittivity(n), e, admittance * e)
            integrated = length * (of_e - admittance * of_h)
            total += np.stack([each.sent[side].T @ integrated for each in self._seconds])
        return total

    def _amplitudes(self, total: ComplexArray) -> ComplexArray:
        """Derivatives of t and r from the integrals, shape (2, p, p)."""
        found = np.zeros((2, 2, 2), dtype=np.complex128)
        for k, side in enumerate(self._sides):
            found[k][np.ix_(self._columns, self._columns)] = 1j * side @ total[k]
        return found


def _by_doubling(p: Matrix, q: Matrix, half: Doubling, first: _Field, seconds: tuple[_Field, _Field]) -> _Integral:
    """The integral by the doubling in reverse."""
    lu, pivots, _ = lapack.zgetrf(np.asarray(half.f, dtype=np.complex128))
    (e_sum, h_sum), (e_gap, _) = first.sums, first.differences
    over_f = lapack.zgetrs(lu, pivots, e_sum)[0]
    a_sum, b_sum = (np.hstack([each.sums[k] for each in seconds]) for k in (0, 1))
    b_gap = np.hstack([each.differences[1] for each in seconds])
    over_p = -1j * lapack.zgetrs(lu, pivots, b_sum, trans=1)[0]
    left = -0.5 * np.stack([over_p.T, 1j * b_gap.T], axis=-1)
    by_a = [pull_back_doubled(half, left, np.stack(pair, axis=1)) for pair in zip(e_gap.T, over_f.T, strict=True)]

    def integral(change: LayerChange) -> ComplexArray:
        d_a = change.of_a(p, q).ravel()
        total = np.stack([each.reshape(len(each), -1) @ d_a for each in by_a], axis=-1)
        total += 0.5 * (a_sum.T @ (change.q @ over_f)) - 0.5j * (over_p.T @ change.p_product(h_sum))
        return total.reshape(2, -1, len(by_a))

    return integral


def _by_modes(p: Matrix, q: Matrix, thickness: float, first: _Field, seconds: tuple[_Field, _Field]) -> _Integral:
    """The integral by the layer's modes."""
    modes = layer_modes(p, q)
    beta = modes.beta
    total, gap = beta[:, None] + beta, beta[:, None] - beta
    decay = np.exp(1j * beta * thickness)
    along = (decay[:, None] * decay - 1.0) / (1j * total)
    close = np.abs(gap) * thickness < 1e-4
    # Opposite waves of nearly equal beta: the first terms of the series in gap, else the difference.
    series = thickness * np.exp(0.5j * total * thickness) * (1.0 - (gap * thickness) ** 2 / 24.0)
    against = np.where(close, series, (decay[:, None] - decay) / (1j * np.where(close, 1.0, gap)))

    def amplitudes(field: _Field) -> tuple[Matrix, Matrix]:
        """c+ of each mode where the layer begins, c- where it ends."""
        forward = np.linalg.solve(modes.e, field.near_e) + np.linalg.solve(modes.h, field.near_h)
        backward = np.linalg.solve(modes.e, field.far_e) - np.linalg.solve(modes.h, field.far_h)
        return 0.5 * forward, 0.5 * backward

    (forward, backward), others = amplitudes(first), [amplitudes(each) for each in seconds]

    def integral(change: LayerChange) -> ComplexArray:
        from_q, from_p = modes.e.T @ change.q @ modes.e, modes.h.T @ change.p_product(modes.h)
        same, opposite = (from_q - from_p) * along, (from_q + from_p) * against
        return np.stack(
            [
                ahead.T @ (same @ forward + opposite @ backward) + behind.T @ (same @ backward + opposite @ forward)
                for ahead, behind in others
            ]
        )

    return integral


def _admittance(waves: PlaneWaves) -> ComplexArray:
    return np.asarray(waves.h / np.where(waves.e == 0.0, _SMALLEST, waves.e))
