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
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from metafab.cell.elements.line import Line, Places, mirrored_line, periodic_line
from metafab.cell.elements.mesh import Geometry, Mesh, corner_function, geometry, mesh_of, singular_exponent
from metafab.cell.elements.shapes import graded_quadrature, shapes
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix
from metafab.cell.rcwa.scattering.half_space import distinct_root
from metafab.cell.rcwa.symmetry import permittivity
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation

#: Orders of an element beyond the resolution's, per wavelength in its medium.
_PER_WAVELENGTH = 2.5
#: Plane waves along an axis over the functions along it.
_WAVES = 1.25
#: Quadrature nodes along a side: those of the polynomials, and per radian of the fastest plane wave over the element.
_NODES, _NODES_PER_RADIAN = 5, 0.55


@dataclass(frozen=True)
class RealWaves:
    """Plane waves of one kind, TM or TE: cos or sin of k_x x times cos or sin of k_y y, normalised over the period.

    Attributes:
        k_squared: shape (n,), in-plane wave number squared, 1/nm^2.
        overlap: shape (n, N), integral of each function of E and the unit field along (TM) or across (TE) the wave
            vector; 0 for k = 0.
    """

    k_squared: FloatArray
    overlap: FloatArray


@dataclass(frozen=True)
class Layer:
    """A supercell in a basis of N functions of the transverse E.

    Attributes:
        p: shape (N, N).
        q: shape (N, N).
        tm: overlaps with TM waves.
        te: overlaps with TE waves.
        uniform: shape (2, N), integral of E_x and of E_y of each function over the period, over its root.
        orders: shape (n_orders, 2, N), mean over the period of E_x and E_y times exp(-i k r) of each order.
        area_nm2: area of the period.
    """

    p: Matrix
    q: Matrix
    tm: RealWaves
    te: RealWaves
    uniform: FloatArray
    orders: ComplexArray
    area_nm2: float

    def admittance(self, eps: complex, k0_per_nm: float) -> ComplexArray:
        """Y of a half space: h = Y e for outgoing waves, shape (N, N), symmetric."""
        total = np.sqrt(complex(eps)) * (self.uniform.T @ self.uniform)
        for waves, is_tm in ((self.tm, True), (self.te, False)):
            beta = distinct_root(eps - waves.k_squared / k0_per_nm**2)
            weight = eps / beta if is_tm else beta
            for part, unit in ((weight.real, 1.0), (weight.imag, 1j)):
                some = part != 0.0
                total += unit * ((waves.overlap[some].T * part[some]) @ waves.overlap[some])
        return np.asarray(total)


def polynomial_orders(mesh: Mesh, supercell: Supercell, resolution: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Orders of the elements along x and along y: the resolution, and more for elements of more wavelengths."""
    cell = supercell.cell
    counts: list[tuple[int, ...]] = []
    for axis, place in enumerate((mesh.x, mesh.y.T)):
        gaps = np.diff(np.concatenate([place, place[:, :1] + mesh.period_nm[axis]], axis=1), axis=1).max(axis=0)
        index = np.where(np.arange(len(gaps)) % 2 == 0, complex(cell.n_pillar).real, complex(cell.n_ambient).real)
        wavelengths = gaps * index / cell.wavelength_nm
        counts.append(tuple(int(p) for p in np.maximum(2, np.rint(resolution + _PER_WAVELENGTH * wavelengths))))
    return counts[0], counts[1]


@dataclass(frozen=True)
class Basis:
    """Mesh and numbering of the functions.

    Attributes:
        mesh: vertices.
        along_x: numbering along x.
        along_y: numbering along y.
        tau: exponent of the corners' functions; 1 for none.
        corner: shape of the mesh's vertices, number of each corner's function; -1 for none.
        corner_sign: shape of ``corner``, factor from the function to that of the corner (mirrored corners share one).
        period_nm: (x, y) period.
        most_waves: largest numbers (m_x, m_y) of the plane waves.
    """

    mesh: Mesh
    along_x: Line
    along_y: Line
    tau: float
    corner: IntArray
    corner_sign: FloatArray
    most_waves: tuple[int, int]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Functions along u, along v, and of corners."""
        x, y = self.along_x, self.along_y
        return x.edge_count * y.nodal_count, x.nodal_count * y.edge_count, int(self.corner.max()) + 1


def basis_of(supercell: Supercell, polarisation: Polarisation | None, resolution: float) -> Basis:
    """Basis of a supercell at a resolution.

    Args:
        supercell: the pillars.
        polarisation: of the incident light, for one row, whose mirror it keeps; None for any block.
        resolution: polynomial order of an element far smaller than the wavelength.
    """
    mesh, cell = mesh_of(supercell), supercell.cell
    orders_x, orders_y = polynomial_orders(mesh, supercell, resolution)
    tau = singular_exponent(permittivity(cell.n_pillar).real, permittivity(cell.n_ambient).real)
    sites_b, sites_a = (np.arange(count) // 2 for count in mesh.shape)
    enriched = mesh.solid[np.ix_(sites_b, sites_a)] & (tau < 1.0)
    number, sign = np.full(mesh.shape, -1), np.ones(mesh.shape)
    if polarisation is None:
        along_y = periodic_line(orders_y)
        number[enriched] = np.arange(np.count_nonzero(enriched))
    else:
        along_y = mirrored_line((orders_y[0], orders_y[1]), even=polarisation == "x")
        number[:, enriched[0]] = np.arange(np.count_nonzero(enriched[0]))
        sign[0] = 1.0 if along_y.even else -1.0
    waves = tuple(math.ceil(0.5 * _WAVES * sum(orders)) for orders in (orders_x, orders_y))
    return Basis(mesh, periodic_line(orders_x), along_y, tau, number, sign, (waves[0], waves[1]))


@dataclass(frozen=True)
class Element:
    """Functions of one element at its quadrature points, of which there are q.

    Attributes:
        place: shape (k,), numbers of the functions of E.
        e: shape (2, k, q), E_x and E_y.
        curl: shape (k, q).
        place_z: shape (k_z,), numbers of the functions of E_z.
        e_z: shape (k_z, q).
        weight: shape (q,), nm^2.
        at: shape (2, q), x and y, nm.
        is_pillar: whether it is one.
    """

    place: IntArray
    e: FloatArray
    curl: FloatArray
    place_z: IntArray
    e_z: FloatArray
    weight: FloatArray
    at: FloatArray
    is_pillar: bool


def element(basis: Basis, b: int, a: int) -> Element:
    """Functions of element (b, a)."""
    mesh = basis.mesh
    corners = mesh.corners(b, a)
    x, y = basis.along_x, basis.along_y
    rules = []
    for line, number, extent, waves, period in (
        (x, a, np.ptp(corners[0]), basis.most_waves[0], mesh.period_nm[0]),
        (y, b, np.ptp(corners[1]), basis.most_waves[1], mesh.period_nm[1]),
    ):
        radians = 2.0 * math.pi * waves * extent / period
        rules.append(graded_quadrature(line.orders[number] + _NODES + math.ceil(_NODES_PER_RADIAN * radians)))
    (at_u, weight_u), (at_v, weight_v) = rules
    u, v = shapes(x.orders[a], at_u), shapes(y.orders[b], at_v)
    place = geometry(corners, u, v)
    n_u, n_v, _ = basis.counts

    def product(of_u: FloatArray, of_v: FloatArray, first: Places, second: Places) -> FloatArray:
        signed = (of_u[first.local] * first.sign[:, None])[:, None, :, None]
        both = signed * (of_v[second.local] * second.sign[:, None])[None, :, None, :]
        return both.reshape(-1, *both.shape[2:])

    def numbers(first: Places, second: Places, count: int) -> IntArray:
        return np.asarray((first.place[:, None] * count + second.place).ravel())

    edge_u, edge_v, nodal_u, nodal_v = x.edge[a], y.edge[b], x.nodal[a], y.nodal[b]
    e_u, e_v = product(u.edge, v.nodal, edge_u, nodal_v), product(u.nodal, v.edge, nodal_u, edge_v)
    fields = np.concatenate(
        [np.stack(place.physical(e_u, np.zeros(1))), np.stack(place.physical(np.zeros(1), e_v))], axis=1
    )
    curl = np.concatenate(
        [-product(u.edge, v.nodal_slope, edge_u, nodal_v), product(u.nodal_slope, v.edge, nodal_u, edge_v)]
    )
    e_z = product(u.nodal, v.nodal, nodal_u, nodal_v)
    at_e = [numbers(edge_u, nodal_v, y.nodal_count), n_u + numbers(nodal_u, edge_v, y.edge_count)]
    at_z = [numbers(nodal_u, nodal_v, y.nodal_count)]
    is_pillar = mesh.is_pillar(b, a)
    for i, j, number, sign, value, slope in _corner_functions(basis, b, a, place, is_pillar=is_pillar):
        hat = u.nodal[i][:, None] * v.nodal[j]
        hat_x, hat_y = place.physical(u.nodal_slope[i][:, None] * v.nodal[j], u.nodal[i][:, None] * v.nodal_slope[j])
        field = np.stack([slope[0] * hat + value * hat_x, slope[1] * hat + value * hat_y])
        fields = np.concatenate([fields, sign * field[:, None]], axis=1)
        curl = np.concatenate([curl, np.zeros((1, *hat.shape))])
        e_z = np.concatenate([e_z, sign * (value * hat)[None]])
        at_e.append(np.array([n_u + n_v + number]))
        at_z.append(np.array([x.nodal_count * y.nodal_count + number]))
    weight = weight_u[:, None] * weight_v * place.area
    numbers_e, (e_x, e_y, curl) = _merged(np.concatenate(at_e), [*fields, curl / place.area])
    numbers_z, (e_z,) = _merged(np.concatenate(at_z), [e_z])
    at = np.stack([place.x.ravel(), place.y.ravel()])
    return Element(numbers_e, np.stack([e_x, e_y]), curl, numbers_z, e_z, weight.ravel(), at, is_pillar)


def _corner_functions(
    basis: Basis, b: int, a: int, place: Geometry, *, is_pillar: bool
) -> Iterator[tuple[int, int, int, float, FloatArray, tuple[FloatArray, FloatArray]]]:
    """End along u and v, number, sign, value and gradient of the function of each enriched corner of an element."""
    mesh, corners = basis.mesh, basis.mesh.corners(b, a)
    for j in range(2):
        for i in range(2):
            vertex = (b + j) % mesh.shape[0], (a + i) % mesh.shape[1]
            number = int(basis.corner[vertex])
            if number >= 0:
                at = float(corners[0][j, i]), float(corners[1][j, i])
                inwards = 1 if vertex[1] % 2 == 0 else -1, 1 if vertex[0] % 2 == 0 else -1
                value, slope_x, slope_y = corner_function(basis.tau, place, at, inwards, inside=is_pillar)
                yield i, j, number, float(basis.corner_sign[vertex]), value, (slope_x, slope_y)


def _merged(place: IntArray, functions: list[FloatArray]) -> tuple[IntArray, list[FloatArray]]:
    """Sum of the functions of equal number (vertices that a mirror identifies); points flattened."""
    distinct, inverse = np.unique(place, return_inverse=True)
    merged = []
    for each in functions:
        total = np.zeros((len(distinct), each[0].size))
        np.add.at(total, inverse, each.reshape(len(each), -1))
        merged.append(total)
    return distinct, merged


def layer_of(supercell: Supercell, polarisation: Polarisation | None, resolution: float, orders: IntArray) -> Layer:
    """P and Q of a supercell and its overlaps with plane waves.

    Args:
        supercell: the pillars.
        polarisation: of the incident light, for one row; None for any block.
        resolution: polynomial order of an element far smaller than the wavelength.
        orders: shape (n_orders, 2), transmitted orders.
    """
    basis, cell = basis_of(supercell, polarisation, resolution), supercell.cell
    n_e, n_z = sum(basis.counts), basis.along_x.nodal_count * basis.along_y.nodal_count + basis.counts[2]
    eps = permittivity(cell.n_ambient), permittivity(cell.n_pillar)
    dtype = np.result_type(*map(type, eps))
    gram, gram_eps, curl, gram_z = (np.zeros((n, n), kind) for n, kind in
                                    ((n_e, float), (n_e, dtype), (n_e, float), (n_z, dtype)))  # fmt: skip
    waves = _Waves(basis, orders, n_e)
    for b in range(basis.mesh.shape[0]):
        for a in range(basis.mesh.shape[1]):
            each = element(basis, b, a)
            at_e, at_z = np.ix_(each.place, each.place), np.ix_(each.place_z, each.place_z)
            of_e = sum((component * each.weight) @ component.T for component in each.e)
            gram[at_e] += of_e
            gram_eps[at_e] += eps[each.is_pillar] * of_e
            curl[at_e] += (each.curl * each.weight) @ each.curl.T
            gram_z[at_z] += eps[each.is_pillar] * ((each.e_z * each.weight) @ each.e_z.T)
            waves.add(each)
    gradient = _gradient(basis, n_e, n_z)
    q = gram_eps - curl / cell.k0_per_nm**2
    p = np.linalg.inv(gram) - gradient @ np.linalg.solve(gram_z, gradient.T) / cell.k0_per_nm**2
    return waves.layer(0.5 * (p + p.T), q)


def _gradient(basis: Basis, n_e: int, n_z: int) -> FloatArray:
    """D: each function of E_z -> its gradient among the functions of E."""
    x, y, (n_u, n_v, corners) = basis.along_x, basis.along_y, basis.counts
    matrix = np.zeros((n_e, n_z))
    plain = n_z - corners
    matrix[:n_u, :plain] = np.kron(x.gradient(), np.eye(y.nodal_count))
    matrix[n_u : n_u + n_v, :plain] = np.kron(np.eye(x.nodal_count), y.gradient())
    matrix[n_u + n_v :, plain:] = np.eye(corners)
    return matrix


class _Waves:
    """Overlaps with plane waves, summed over elements."""

    def __init__(self, basis: Basis, orders: IntArray, count: int) -> None:
        self._basis, self._area = basis, basis.mesh.period_nm[0] * basis.mesh.period_nm[1]
        self._even = basis.along_y.even
        m_x, m_y = basis.most_waves
        # Functions along each axis as (number, phase): cos(k x - phase).
        self._x = [(m, phase) for m in range(m_x + 1) for phase in (0.0, 0.5 * math.pi) if m or not phase]
        both = (0.0, 0.5 * math.pi)
        # E_x of a TM wave has the parity of its scalar, E_x of a TE wave the other one.
        self._y_tm, self._y_te = (
            [
                (m, phase)
                for m in range(m_y + 1)
                for phase in (both if self._even is None else both[:1] if even else both[1:])
                if m or not phase
            ]
            for even in (self._even, not self._even)
        )
        self._tm = np.zeros((len(self._x) * len(self._y_tm), count))
        self._te = np.zeros((len(self._x) * len(self._y_te), count))
        self._uniform = np.zeros((2, count))
        self._k_order = 2.0 * np.pi * orders / np.array(basis.mesh.period_nm)
        self._orders = np.zeros((len(orders), 2, count), dtype=np.complex128)

    def _k(self, y: list[tuple[int, float]]) -> tuple[FloatArray, FloatArray]:
        """(k_x, k_y) of every product of a function along x and one of ``y``."""
        k_x, k_y = (
            2.0 * np.pi / period * np.array([m for m, _ in numbers])
            for period, numbers in zip(self._basis.mesh.period_nm, (self._x, y), strict=True)
        )
        return np.repeat(k_x, len(y)), np.tile(k_y, len(self._x))

    def add(self, each: Element) -> None:
        """Add the overlaps of one element."""
        weighted = each.e * each.weight
        for target, y, (first, second, sign) in (
            (self._tm, self._y_tm, (0, 1, 1.0)),
            (self._te, self._y_te, (1, 0, -1.0)),
        ):
            x_wave, x_slope = self._waves(0, self._x, each.at[0])
            y_wave, y_slope = self._waves(1, y, each.at[1])
            along_x = (x_slope[:, None] * y_wave).reshape(-1, each.weight.size)
            along_y = (x_wave[:, None] * y_slope).reshape(-1, each.weight.size)
            # TM: E along the gradient. TE: along (-d/dy, d/dx).
            overlap = along_x @ weighted[first].T + sign * (along_y @ weighted[second].T)
            k = np.hypot(*self._k(y))[:, None]
            target[:, each.place] += np.divide(overlap, k, out=np.zeros_like(overlap), where=k > 0.0)
        own = weighted.sum(axis=-1) / math.sqrt(self._area)
        if self._even is None:
            self._uniform[:, each.place] += own
        else:
            axis = 0 if self._even else 1
            self._uniform[axis, each.place] += own[axis]
        turned = np.exp(-1j * (self._k_order @ each.at)) / self._area
        self._orders[:, :, each.place] += np.einsum("oq,cjq->ocj", turned, weighted, optimize=True)

    def _waves(self, axis: int, numbers: list[tuple[int, float]], at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Functions and their derivatives at places, each of shape (n, q)."""
        period = self._basis.mesh.period_nm[axis]
        k = 2.0 * np.pi / period * np.array([m for m, _ in numbers])[:, None]
        phase = k * at - np.array([phase for _, phase in numbers])[:, None]
        norm = np.where(k == 0.0, 1.0, math.sqrt(2.0)) / math.sqrt(period)
        return norm * np.cos(phase), -norm * k * np.sin(phase)

    def layer(self, p: Matrix, q: Matrix) -> Layer:
        """The layer with these overlaps."""
        tm, te = (
            RealWaves(np.sum(np.square(self._k(y)), axis=0), overlap)
            for y, overlap in ((self._y_tm, self._tm), (self._y_te, self._te))
        )
        return Layer(p, q, tm, te, self._uniform, self._orders, self._area)


def incident(layer: Layer, polarisation: Polarisation, n: complex) -> ComplexArray:
    """Twice the h of an incident wave of unit amplitude in a medium of index ``n``, shape (N,)."""
    return np.asarray(2.0 * complex(n) * math.sqrt(layer.area_nm2) * layer.uniform[POLARISATIONS.index(polarisation)])
