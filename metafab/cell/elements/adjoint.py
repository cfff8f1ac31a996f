"""Derivatives of transmitted orders by the sizes of all pillars, by the adjoint of the solution in reverse.

A linear functional L of the orders has dL = m^T (db - dA z) with A z = b the equations at both faces and A m the
functional's weights (A is symmetric). The derivative of L by F of half the layer
(:class:`metafab.cell.elements.solve.FaceSystem`) is then a sum of two outer products; the doubling in reverse turns it
into derivatives by P and Q, and these become derivatives by the Gram matrices. The plane waves of the half spaces enter
as fields at the faces. All sums run over elements. A size changes only the pillar's element and the eight around it:
their change is a central difference of closed forms at fixed numbers of functions and nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.elements.assembly import Grams, Layer, Waves, gradient_of
from metafab.cell.elements.basis import Basis, Element, basis_of, element, elements_of
from metafab.cell.elements.mesh import mesh_of
from metafab.cell.elements.solve import FaceSystem, exchanged_places, face_system, other_light
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix
from metafab.cell.rcwa.scattering.reverse import pull_back_doubled
from metafab.cell.rcwa.symmetry import permittivity
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, Polarisation
from metafab.core.errors import InputError
from metafab.core.parallel.executor import one_blas_thread

#: Change of a size in the central differences of an element's sums, nm.
_STEP_NM = 0.02


@dataclass(frozen=True)
class OrderGradients:
    """Orders of a supercell for one incident polarisation, and derivatives of functionals of them."""

    order: IntArray  #: Shape (n_orders, 2).
    t: ComplexArray  #: Shape (n_orders, 2), E_x and E_y of each order over incident E.
    #: Shape (k, n_y, n_x, 2), derivative of the sum of weights times ``t`` by the width and the length of each pillar,
    #: 1/nm; 0 at sites without a pillar.
    gradient: ComplexArray


def order_gradients(
    supercell: Supercell, light: Polarisation, resolution: float, weights: ComplexArray
) -> OrderGradients:
    """Differentiate functionals of the orders of a row or block by all sizes.

    For a real function g of the orders, take 2 dg/dt (with t and its conjugate as independent) as weights; the real
    part of the gradient is that of g. ``weights``, shape (k, n_orders, 2), are of each order's E_x and E_y in the k
    functionals; ``resolution`` is as in :func:`metafab.cell.elements.solve.orders_at`. InputError for pillars
    that touch or are no rectangles, SolverError if the layer is singular.
    """
    if faults := supercell.cell.untreated("derivatives by sizes"):
        raise InputError("supercell", faults)
    order = supercell.propagating_orders(light)
    if supercell.shape[1] == 1 < supercell.shape[0]:
        places = exchanged_places(supercell, light)
        of_turned = weights[:, np.argsort(places), ::-1]
        turned = order_gradients(supercell.exchanged(), other_light(light), resolution, of_turned)
        gradient = turned.gradient.transpose(0, 2, 1, 3)[..., ::-1]
        return OrderGradients(order, turned.t[places, ::-1], gradient)
    with one_blas_thread():
        basis = basis_of(supercell, light, resolution)
        solved = _Solved.of(supercell, light, basis, order)
        gradient = _gradients([_Adjoint(solved, each) for each in weights], supercell, basis)
    return OrderGradients(order, solved.layer.orders @ solved.fields[1], gradient)


def _gradients(adjoints: list[_Adjoint], supercell: Supercell, basis: Basis) -> ComplexArray:
    """Derivatives of the functionals by the sizes, shape (k, n_y, n_x, 2)."""
    gradient = np.zeros((len(adjoints), *supercell.shape, 2), dtype=np.complex128)
    n_b, n_a = basis.mesh.shape
    for row, column in np.argwhere(basis.mesh.solid):
        around = {((2 * row + b) % n_b, (2 * column + a) % n_a) for b in (-1, 0, 1) for a in (-1, 0, 1)}
        for axis in range(2):
            for sign in (1.0, -1.0):
                size_nm = supercell.size_nm.copy()
                size_nm[row, column, axis] += sign * _STEP_NM
                moved = replace(basis, mesh=mesh_of(replace(supercell, size_nm=size_nm)))
                for each in (element(moved, b, a) for b, a in around):
                    shares = [adjoint.of_element(each) for adjoint in adjoints]
                    gradient[:, row, column, axis] += np.array(shares) * sign / (2.0 * _STEP_NM)
    return gradient


@dataclass(frozen=True)
class _Solved:
    """A solved supercell: all that the functionals of its orders share."""

    cell: PillarCell  #: Materials and light.
    axis: int  #: Index of the incident polarisation.
    waves: Waves  #: Plane waves and transmitted orders.
    layer: Layer  #: P, Q and overlaps.
    system: FaceSystem  #: Equations at both faces.
    fields: ComplexArray  #: Shape (2, N), e at both faces.
    inverse: Matrix  #: Shape (N, N), inverse of the Gram matrix of E.
    lifted: Matrix  #: Shape (N, n_z), D S_eps^-1 of :meth:`metafab.cell.elements.assembly.Grams.over_eps_z`.

    @classmethod
    def of(cls, supercell: Supercell, light: Polarisation, basis: Basis, order: IntArray) -> _Solved:
        """Solve a row along x or a block."""
        cell, elements, waves = supercell.cell, elements_of(basis), Waves(basis, order)
        grams = Grams.of(elements, gradient_of(basis))
        layer = waves.overlaps(elements, *grams.p_and_q(cell.layer, cell.k0_per_nm))
        system = face_system(layer, supercell, (light,), keep=True)
        fields = system.solve(2.0 * system.source, np.zeros_like(system.source))[..., 0]
        lifted = grams.over_eps_z(cell.layer)
        return cls(cell, POLARISATIONS.index(light), waves, layer, system, fields, grams.inverse, lifted)


class _Adjoint:
    """Weights of everything that an element adds to one functional of the orders."""

    def __init__(self, solved: _Solved, weights: ComplexArray) -> None:
        cell, layer, system, axis, k0 = solved.cell, solved.layer, solved.system, solved.axis, solved.cell.k0_per_nm
        self._eps = permittivity(cell.n_ambient), permittivity(cell.n_pillar)
        self._waves, self._weights = solved.waves, weights
        functional = np.einsum("oc,ocj->j", weights, layer.orders)[:, None]
        multiplier = system.solve(np.zeros_like(functional), functional)[..., 0]
        (near, far), (near_m, far_m) = solved.fields, multiplier
        # Weights of X and Z are outer products; so are those of F.
        gap, gap_m, mean, mean_m = near - far, near_m - far_m, near + far, near_m + far_m
        by_p, by_f = np.linalg.solve(layer.p.T, gap_m), np.linalg.solve(system.half.f, mean_m)
        left, right = np.stack([by_p, system.z @ mean], axis=1), np.stack([gap, by_f], axis=1)
        a_bar = pull_back_doubled(system.half, -1j * left[None], right)[0]
        q_bar = layer.p.T @ a_bar
        p_bar = a_bar @ layer.q.T + 1j * np.outer(by_p, system.x @ gap)
        self._of_e_eps: Matrix = q_bar + 1j * np.outer(by_f, mean)
        self._of_curl = -self._of_e_eps / k0**2
        self._of_e = -solved.inverse @ p_bar @ solved.inverse
        self._of_z: Matrix = solved.lifted.T @ p_bar @ solved.lifted / k0**2
        # At each face, dA couples e with the multiplier: the plane waves of either are paired with the other.
        partners, amplitudes = [], []
        for n, pair in ((cell.n_in[axis], (near, near_m)), (cell.n_out[axis], (far, far_m))):
            eps = complex(permittivity(n))
            tm, te = layer.weights(eps, k0)
            for one, other in (pair, pair[::-1]):
                waves = (tm * (layer.tm.overlap @ one), te * (layer.te.overlap @ one))
                uniform = np.sqrt(eps) * (layer.uniform @ one)
                partners.append(other)
                amplitudes.append((-2.0 * waves[0], -2.0 * waves[1], -2.0 * uniform))
        tm, te, uniform = (np.array(each) for each in zip(*amplitudes, strict=True))
        self._faces = np.array(partners), (tm, te, uniform)
        self._source = near_m, axis, 4.0 * complex(cell.n_in[axis])
        self._far = far

    def of_element(self, each: Element) -> complex:
        """Share of an element in the functional, up to a constant."""
        at_e, at_z = np.ix_(each.place, each.place), np.ix_(each.place_z, each.place_z)
        eps = self._eps[each.is_pillar]
        of_e = self._of_e[at_e] + eps * self._of_e_eps[at_e]
        density = sum(np.sum(component * (of_e @ component), axis=0) for component in each.e)
        density = density + np.sum(each.curl * (self._of_curl[at_e] @ each.curl), axis=0)
        density = density + eps * np.sum(each.e_z * (self._of_z[at_z] @ each.e_z), axis=0)
        partners, amplitude = self._faces
        fields = np.einsum("kj,cjq->kcq", partners[:, each.place], each.e, optimize=True)
        density = density + np.sum(fields * self._waves.fields(amplitude, each.at), axis=(0, 1))
        multiplier, axis, factor = self._source
        density = density + factor * (multiplier[each.place] @ each.e[axis])
        turned = np.exp(-1j * (self._waves.k_order @ each.at)) / self._waves.area_nm2
        far = np.einsum("j,cjq->cq", self._far[each.place], each.e)
        density = density + np.einsum("oc,oq,cq->q", self._weights, turned, far, optimize=True)
        return complex(np.sum(density * each.weight))
