"""Matrices of a supercell's layer, and the overlaps of its functions with the plane waves of the half spaces.

The transverse E is a sum of edge elements (Nedelec) and of the gradients of the corners' functions, E_z of continuous
elements and the corners' functions themselves. With h = (H_y, -H_x) tested by the functions of E, z in units of 1/k0,
and M the Gram matrix of E (M_eps with the permittivity), K that of its curl, S_eps that of E_z and D the gradient,

    de/dz = i P h,    P = M^-1 - D S_eps^-1 D^T / k0^2,
    dh/dz = i Q e,    Q = M_eps - K / k0^2,

both symmetric. A half space has h = Y e, with Y the sum of the admittances of plane waves over their overlaps with the
functions of E. No function of the layer is expanded in plane waves: their number only has to resolve the basis.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from metafab.cell.elements.basis import Basis, Element
from metafab.cell.pillar import Slice
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix
from metafab.cell.rcwa.scattering.half_space import distinct_root
from metafab.cell.rcwa.symmetry import permittivity
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation


@dataclass(frozen=True)
class RealWaves:
    """Plane waves of one kind, TM or TE: cos or sin of k_x x times cos or sin of k_y y, normalised over the period."""

    k_squared: FloatArray  #: Shape (n,), in-plane wave number squared, 1/nm^2.
    #: Shape (n, N), integral of each function of E and the unit field along (TM) or across (TE) the wave vector; 0 for
    #: k = 0.
    overlap: FloatArray


@dataclass(frozen=True)
class Layer:
    """A supercell in a basis of N functions of the transverse E."""

    p: Matrix  #: Shape (N, N).
    q: Matrix  #: Shape (N, N).
    tm: RealWaves  #: Overlaps with TM waves.
    te: RealWaves  #: Overlaps with TE waves.
    #: Shape (2, N), integral of E_x and of E_y of each function over the period, divided by the root of its area.
    uniform: FloatArray
    #: Shape (n_orders, 2, N), mean over the period of E_x and E_y times exp(-i k r) of each order.
    orders: ComplexArray
    area_nm2: float  #: Area of the period.

    def weights(self, eps: complex, k0_per_nm: float) -> tuple[ComplexArray, ComplexArray]:
        """Admittances of the TM and of the TE waves in a medium, each of shape (n,)."""
        tm, te = (distinct_root(eps - waves.k_squared / k0_per_nm**2) for waves in (self.tm, self.te))
        return eps / tm, te

    def admittance(self, eps: complex, k0_per_nm: float) -> ComplexArray:
        """Y of a half space: h = Y e for outgoing waves, shape (N, N), symmetric."""
        total = np.sqrt(complex(eps)) * (self.uniform.T @ self.uniform)
        for waves, weight in zip((self.tm, self.te), self.weights(eps, k0_per_nm), strict=True):
            for part, unit in ((weight.real, 1.0), (weight.imag, 1j)):
                some = part != 0.0
                total += unit * ((waves.overlap[some].T * part[some]) @ waves.overlap[some])
        return np.asarray(total)


@dataclass(frozen=True)
class Grams:
    """Gram matrices of N functions of E and n_z of E_z over a mesh; ``_in`` over the pillars alone."""

    e: FloatArray  #: Shape (N, N), of E.
    e_in: FloatArray  #: Shape (N, N).
    inverse: FloatArray  #: Shape (N, N), inverse of ``e``.
    curl: FloatArray  #: Shape (N, N), of the curl of E.
    z: FloatArray  #: Shape (n_z, n_z), of E_z.
    z_in: FloatArray  #: Shape (n_z, n_z).
    gradient: FloatArray  #: Shape (N, n_z), gradient of each function of E_z among those of E.

    @classmethod
    def of(cls, elements: Iterable[Element], gradient: FloatArray) -> Grams:
        """Sum over the elements; ``gradient`` has the shape (N, n_z)."""
        n_e, n_z = gradient.shape
        (e, e_in, curl), (z, z_in) = np.zeros((3, n_e, n_e)), np.zeros((2, n_z, n_z))
        for each in elements:
            at_e, at_z = np.ix_(each.place, each.place), np.ix_(each.place_z, each.place_z)
            of_e = sum((component * each.weight) @ component.T for component in each.e)
            of_z = (each.e_z * each.weight) @ each.e_z.T
            e[at_e] += of_e
            curl[at_e] += (each.curl * each.weight) @ each.curl.T
            z[at_z] += of_z
            if each.is_pillar:
                e_in[at_e] += of_e
                z_in[at_z] += of_z
        return cls(e, e_in, np.asarray(np.linalg.inv(e)), curl, z, z_in, gradient)

    def p_and_q(self, layer: Slice, k0_per_nm: float) -> tuple[Matrix, Matrix]:
        """P and Q of a layer, each of shape (N, N), symmetric."""
        around = permittivity(layer.n_around)
        contrast = permittivity(layer.n_inside) - around
        q = around * self.e + contrast * self.e_in - self.curl / k0_per_nm**2
        p = self.inverse - self.over_eps_z(layer) @ self.gradient.T / k0_per_nm**2
        return 0.5 * (p + p.T), q

    def over_eps_z(self, layer: Slice) -> Matrix:
        """D S_eps^-1 of a layer, shape (N, n_z)."""
        around = permittivity(layer.n_around)
        of_z = around * self.z + (permittivity(layer.n_inside) - around) * self.z_in
        return np.asarray(np.linalg.solve(of_z, self.gradient.T).T)


def gradient_of(basis: Basis) -> FloatArray:
    """D: each function of E_z -> its gradient among the functions of E, shape (N, n_z)."""
    x, y, (n_u, n_v, corners) = basis.along_x, basis.along_y, basis.counts
    plain = x.nodal_count * y.nodal_count
    matrix = np.zeros((n_u + n_v + corners, plain + corners))
    matrix[:n_u, :plain] = np.kron(x.gradient(), np.eye(y.nodal_count))
    matrix[n_u : n_u + n_v, :plain] = np.kron(np.eye(x.nodal_count), y.gradient())
    matrix[n_u + n_v :, plain:] = np.eye(corners)
    return matrix if basis.fold is None else basis.fold[1].folded(matrix, into=basis.fold[0])


class Waves:
    """Real plane waves of a supercell, and its transmitted orders.

    Args:
        basis: mesh and numbering.
        orders: shape (n_orders, 2), transmitted orders.
    """

    def __init__(self, basis: Basis, orders: IntArray) -> None:
        self._count, self._period = basis.sizes[0], basis.mesh.period_nm
        self._even = basis.along_y.even
        self.area_nm2 = self._period[0] * self._period[1]
        self.k_order = 2.0 * np.pi * orders / np.array(self._period)
        m_x, m_y = basis.most_waves
        # E_x is a derivative of the scalar over x in TM waves and over y in TE waves. So it has the parity of the TM
        # scalar along y, and of the TE scalar along x; the other scalars have the opposite one. Under a mirror along x,
        # E_x has the parity that it has about the row's axis.
        even_x = None if basis.fold is None or self._even is None else not self._even
        #: Functions along x and along y, each of TM and of TE waves.
        self._numbers = tuple(_numbers(m_x, even_x)), tuple(_numbers(m_y, self._even))

    def k_squared(self, kind: int) -> FloatArray:
        """In-plane wave number squared of the TM (0) or TE (1) waves, shape (n,), 1/nm^2."""
        k_x, k_y = (self._k(axis, numbers) for axis, numbers in enumerate(of[kind] for of in self._numbers))
        return np.asarray(np.add.outer(k_x**2, k_y**2).ravel())

    def _k(self, axis: int, numbers: FloatArray) -> FloatArray:
        return np.asarray(2.0 * np.pi / self._period[axis] * numbers[:, 0])

    def _along(self, axis: int, numbers: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Functions along an axis and their derivatives at places, each of shape (n, q)."""
        k = self._k(axis, numbers)[:, None]
        phase = k * at - numbers[:, 1:]
        norm = np.where(k == 0.0, 1.0, math.sqrt(2.0)) / math.sqrt(self._period[axis])
        return norm * np.cos(phase), -norm * k * np.sin(phase)

    def _inverse_k(self, kind: int) -> FloatArray:
        k = np.sqrt(self.k_squared(kind))
        return np.divide(1.0, k, out=np.zeros_like(k), where=k > 0.0)

    def overlaps(self, elements: list[Element], p: Matrix, q: Matrix) -> Layer:
        """The layer with its overlaps."""
        total = [np.zeros((self.k_squared(kind).size, self._count)) for kind in (0, 1)]
        uniform = np.zeros((2, self._count))
        orders = np.zeros((len(self.k_order), 2, self._count), dtype=np.complex128)
        for each in elements:
            weighted = each.e * each.weight
            for kind, target in enumerate(total):
                x, d_x = self._along(0, self._numbers[0][kind], each.at[0])
                y, d_y = self._along(1, self._numbers[1][kind], each.at[1])
                by_x, by_y = ((a[:, None] * b).reshape(-1, each.weight.size) for a, b in ((d_x, y), (x, d_y)))
                # TM: E along the gradient (d/dx, d/dy). TE: along (-d/dy, d/dx).
                e_x, e_y = weighted if kind == 0 else (weighted[1], -weighted[0])
                target[:, each.place] += by_x @ e_x.T + by_y @ e_y.T
            uniform[:, each.place] += weighted.sum(axis=-1) / math.sqrt(self.area_nm2)
            turned = np.exp(-1j * (self.k_order @ each.at)) / self.area_nm2
            orders[:, :, each.place] += np.einsum("oq,cjq->ocj", turned, weighted, optimize=True)
        if self._even is not None:
            uniform[1 if self._even else 0] = 0.0
        tm, te = (
            RealWaves(self.k_squared(kind), self._inverse_k(kind)[:, None] * target)
            for kind, target in enumerate(total)
        )
        return Layer(p, q, tm, te, uniform, orders, self.area_nm2)

    def fields(self, amplitude: tuple[ComplexArray, ComplexArray, ComplexArray], at: FloatArray) -> ComplexArray:
        """Sums of plane waves at places, shape (k, 2, q).

        Args:
            amplitude: of the TM and TE waves, and of the uniform fields along x and y, shape (k, n) each.
            at: shape (2, q), x and y, nm.
        """
        total = np.repeat(amplitude[2][..., None] / math.sqrt(self.area_nm2), at.shape[1], axis=-1)
        for kind in (0, 1):
            x, d_x = self._along(0, self._numbers[0][kind], at[0])
            y, d_y = self._along(1, self._numbers[1][kind], at[1])
            weight = (amplitude[kind] * self._inverse_k(kind)).reshape(-1, len(x), len(y))
            by_x, by_y = (np.sum(a * (weight @ b), axis=1) for a, b in ((d_x, y), (x, d_y)))
            total += np.stack([by_x, by_y] if kind == 0 else [-by_y, by_x], axis=1)
        return np.asarray(total)


def _numbers(most: int, even: bool | None) -> Iterator[FloatArray]:
    """(number m, phase) of cos(k x - phase) along an axis, of TM and of TE waves, shape (n, 2) each, m to ``most``.

    ``even`` is the parity of the scalar of TM waves; that of TE waves has the other one. None for both.
    """
    both = (0.0, 0.5 * math.pi)
    for parity in (even, None if even is None else not even):
        phases = both if parity is None else both[:1] if parity else both[1:]
        yield np.array([(m, phase) for m in range(most + 1) for phase in phases if m or not phase])


def incident(layer: Layer, polarisation: Polarisation, n: complex) -> ComplexArray:
    """Twice the h of an incident wave of unit amplitude in a medium of index ``n``, shape (N,)."""
    return np.asarray(2.0 * complex(n) * math.sqrt(layer.area_nm2) * layer.uniform[POLARISATIONS.index(polarisation)])
