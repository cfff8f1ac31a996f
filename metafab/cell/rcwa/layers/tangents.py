"""Derivatives of P and Q of a layer and of a uniform medium by the pillar's sizes and its index.

B and C of :mod:`metafab.cell.rcwa.layers.factorisation` hold one wave number k in each column: B in a row of a TM wave,
C in that of a TE wave. As the map of an axis changes, so do the wave vectors. The part of the change along a wave
vector changes its k; the part across couples the TM and the TE wave of that wave vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.rcwa.basis.axis import AxisParity
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.layers.factorisation import inverse_of_direct_rule, inverse_rule, kron
from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class WaveTangents:
    """Change of the wave vectors of n coefficients, in units of k0."""

    squared: FloatArray  #: Shape (n,), change of k^2.
    #: Shape (pairs,), |k| times the change across the wave vector of each pair of a TM and a TE wave.
    across: FloatArray

    @classmethod
    def of(cls, basis: TransverseBasis, d_axis: AxisParity, axis: int, k0_per_nm: float) -> WaveTangents:
        """Change with ``axis`` 0 (x) or 1 (y), whose derivative is ``d_axis``."""
        repeated = np.repeat if axis == 0 else np.tile
        other, one = (basis.v, basis.u) if axis == 0 else (basis.u, basis.v)
        labels = (one.label_a, other.label_a), (one.label_b, other.label_b)
        label = np.concatenate([repeated(own, across.size) for own, across in labels])
        change = d_axis.wavenumber[label]
        of_pair = change[basis.pair_u] * (-basis.along[1] if axis == 0 else basis.along[0])
        length = np.sqrt(basis.k_squared[basis.pair_u])
        return cls(2.0 * one.wavenumber[label] * change / k0_per_nm**2, length * of_pair / k0_per_nm**2)


@dataclass(frozen=True)
class LayerChange:
    """dP and dQ of a layer in (TM, TE): dP couples the rows that E_z drives with each other and with their TE waves."""

    basis: TransverseBasis  #: Symmetry class, n coefficients.
    p_driven: Matrix  #: Shape (n_z, n_z), dP between rows ``with_e_z``.
    p_pairs: Matrix  #: Shape (pairs, n_z), dP between rows ``pair_v`` and columns ``with_e_z``, and its transpose.
    q: Matrix  #: Shape (n, n), dQ.

    def p_product(self, h: Matrix) -> Matrix:
        """Product dP h, for ``h`` of shape (n, any)."""
        driven, pairs = self.basis.with_e_z, self.basis.pair_v
        product = np.zeros((len(h), h.shape[1]), dtype=np.complex128)
        product[driven] = self.p_driven @ h[driven] + self.p_pairs.T @ h[pairs]
        product[pairs] += self.p_pairs @ h[driven]
        return product

    def of_a(self, p: Matrix, q: Matrix) -> Matrix:
        """Change of A = P Q, shape (n, n)."""
        driven = self.basis.with_e_z
        change = self.p_product(q)
        change += self.q
        # P is 1 but for the rows that E_z drives.
        change[driven] += (p[driven[:, None], driven] - np.eye(driven.size)) @ self.q[driven]
        return change


@dataclass(frozen=True)
class RectangleLayer:
    """A layer that holds a rectangle, with the matrices that its derivatives share."""

    basis: TransverseBasis  #: Symmetry class, n coefficients.
    k0_per_nm: float  #: Wave number of vacuum.
    eps_pillar: complex  #: Permittivity of the pillar.
    eps_around: complex  #: Permittivity around it.
    rule_u: Matrix  #: Shape (n_a, n_a), permittivity normal to the walls across x.
    rule_v: Matrix  #: Shape (n_b, n_b), likewise across y.
    eta_z: Matrix  #: Shape (n_z, n_z), inverse of the permittivity for E_z.

    @classmethod
    def of(cls, basis: TransverseBasis, k0_per_nm: float, eps_pillar: complex, eps_around: complex) -> RectangleLayer:
        """The layer of a rectangle between ``eps_around``."""
        rule_u, rule_v = (inverse_rule(x, eps_pillar, eps_around) for x in (basis.u.a, basis.v.b))
        eta_z = inverse_of_direct_rule(basis.u.b, basis.v.a, eps_pillar, eps_around)
        return cls(basis, k0_per_nm, eps_pillar, eps_around, rule_u, rule_v, eta_z)

    def by_size(self, d_axis: AxisParity, axis: int, waves: WaveTangents) -> LayerChange:
        """The change by the size along ``axis`` 0 (x) or 1 (y)."""
        u, v, around = self.basis.u, self.basis.v, self.eps_around
        step, inverse_step = self.eps_pillar - around, 1.0 / around - 1.0 / self.eps_pillar
        # eps_u = rule(u) (x) v + eps_around (1 (x) (1 - v)), and the same with u and v exchanged for eps_v.
        if axis == 0:
            d_eps_u = kron(inverse_step * (self.rule_u @ d_axis.a @ self.rule_u), v.a)
            d_eps_v = kron(d_axis.b, self.rule_v - around * np.eye(len(v.b)))
            d_eps_z = step * kron(d_axis.b, v.a)
        else:
            d_eps_u = kron(self.rule_u - around * np.eye(len(u.a)), d_axis.a)
            d_eps_v = kron(u.b, inverse_step * (self.rule_v @ d_axis.b @ self.rule_v))
            d_eps_z = step * kron(u.b, d_axis.a)
        change = self._by_permittivity(d_eps_u, d_eps_v, d_eps_z)
        # The part of dB and dC in P = 1 - B eta_z B^T and Q = .. - C C^T.
        basis = self.basis
        driven, k = basis.with_e_z, basis.k_with_e_z / self.k0_per_nm
        over_k = np.divide(1.0, k, out=np.zeros_like(k), where=k != 0.0)
        eta_z_k, column = self.eta_z * k, _columns(basis)
        along = (0.5 * waves.squared[driven] * over_k)[:, None] * eta_z_k
        across = (waves.across * over_k[column])[:, None] * eta_z_k[column]
        q = change.q
        np.einsum("ii->i", q)[:] -= np.where(basis.is_tm, 0.0, waves.squared)
        q[basis.pair_u, basis.pair_v] += waves.across
        q[basis.pair_v, basis.pair_u] += waves.across
        return replace(change, p_driven=change.p_driven - along - along.T, p_pairs=-across)

    def by_index(self) -> LayerChange:
        """The change by the pillar's index."""
        u, v, d_eps = self.basis.u, self.basis.v, 2.0 * np.sqrt(complex(self.eps_pillar))
        scale = d_eps / self.eps_pillar**2
        d_eps_u = kron(scale * (self.rule_u @ u.a @ self.rule_u), v.a)
        d_eps_v = kron(u.b, scale * (self.rule_v @ v.b @ self.rule_v))
        return self._by_permittivity(d_eps_u, d_eps_v, d_eps * kron(u.b, v.a))

    def _by_permittivity(self, d_eps_u: Matrix, d_eps_v: Matrix, d_eps_z: Matrix) -> LayerChange:
        basis, n_u, k = self.basis, len(d_eps_u), self.basis.k_with_e_z / self.k0_per_nm
        q = np.zeros((basis.size, basis.size), dtype=np.complex128)
        q[:n_u, :n_u], q[n_u:, n_u:] = d_eps_u, d_eps_v
        p_driven = k[:, None] * (self.eta_z @ d_eps_z @ self.eta_z) * k
        return LayerChange(basis, p_driven, np.zeros((basis.pair_v.size, k.size)), basis.to_tm_te(q))


def uniform_product(
    basis: TransverseBasis, waves: WaveTangents, eps: complex, e: Matrix, h: Matrix
) -> tuple[Matrix, Matrix]:
    """Return dQ e and dP h of a uniform medium of permittivity ``eps``; ``e``, ``h`` and results of shape (n, any)."""
    of_te = np.where(basis.is_tm, 0.0, waves.squared)
    d_q, d_p = -of_te[:, None] * e, (of_te - waves.squared)[:, None] / eps * h
    for result, field, across in ((d_q, e, waves.across), (d_p, h, -waves.across / eps)):
        result[basis.pair_u] += across[:, None] * field[basis.pair_v]
        result[basis.pair_v] += across[:, None] * field[basis.pair_u]
    return d_q, d_p


def _columns(basis: TransverseBasis) -> IntArray:
    """Coefficient of E_z that drives each pair, shape (pairs,)."""
    place = np.zeros(basis.size, dtype=np.intp)
    place[basis.with_e_z] = np.arange(basis.with_e_z.size)
    return place[basis.pair_u]
