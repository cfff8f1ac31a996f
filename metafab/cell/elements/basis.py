"""Functions of a supercell: their numbers over the mesh, and their values at the quadrature points of each element."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from metafab.cell.elements.line import (
    Fold,
    Line,
    Places,
    folds,
    graded_quadrature,
    half_turn_folds,
    mirrored_line,
    periodic_line,
    shapes,
)
from metafab.cell.elements.mesh import Geometry, Mesh, corner_function, geometry, mesh_of, singular_exponent
from metafab.cell.rcwa.basis.coordinates import IntArray
from metafab.cell.rcwa.symmetry import permittivity
from metafab.cell.supercell import Supercell
from metafab.core.conventions import FloatArray, Polarisation

#: Polynomial order of an element far smaller than the wavelength; or the orders of all pillars and of all gaps, which
#: give each site of a supercell the functions that it has alone.
Resolution: TypeAlias = float | tuple[int, int]

#: Orders of an element beyond the resolution's, per wavelength in its medium.
_PER_WAVELENGTH = 2.5
#: Plane waves along an axis over the functions along it.
_WAVES = 1.25
#: Quadrature nodes along a side: those of the polynomials, and per radian of the fastest plane wave over the element.
_NODES, _NODES_PER_RADIAN = 5, 0.55


def polynomial_orders(
    mesh: Mesh, supercell: Supercell, resolution: Resolution
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Orders of the elements along x and along y: the resolution, and more for elements of more wavelengths."""
    if isinstance(resolution, tuple):
        n_y, n_x = supercell.shape
        return resolution * n_x, resolution * n_y
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
    """Mesh and numbering of the functions."""

    mesh: Mesh  #: Vertices.
    along_x: Line  #: Numbering along x.
    along_y: Line  #: Numbering along y.
    tau: float  #: Exponent of the corners' functions; 1 for none.
    corner: IntArray  #: Shape of the mesh's vertices, number of each corner's function; -1 for none.
    #: Shape of ``corner``, factor from the function to that of the corner (mirrored corners share one).
    corner_sign: FloatArray
    most_waves: tuple[int, int]  #: Largest numbers (m_x, m_y) of the plane waves.
    nodes: IntArray  #: Shape (2, ...) over the mesh's elements, quadrature nodes along each side of an element.
    #: Folds of E and of E_z that keep only functions with the light's parity: about the mirror along x of a row, or
    #: under a half turn of a block. None keeps all.
    fold: tuple[Fold, Fold] | None = None

    @property
    def counts(self) -> tuple[int, int, int]:
        """Functions along u, along v, and of corners, before they are folded."""
        x, y = self.along_x, self.along_y
        return x.edge_count * y.nodal_count, x.nodal_count * y.edge_count, int(self.corner.max()) + 1

    @property
    def sizes(self) -> tuple[int, int]:
        """Functions of E and of E_z."""
        if self.fold is not None:
            return len(self.fold[0].first), len(self.fold[1].first)
        return sum(self.counts), self.along_x.nodal_count * self.along_y.nodal_count + self.counts[2]


def basis_of(
    supercell: Supercell, polarisation: Polarisation, resolution: Resolution, *, folded: bool = False
) -> Basis:
    """Basis of a supercell at a resolution.

    Args:
        supercell: the pillars.
        polarisation: of the incident light; it chooses the parity of one row. A block serves both polarisations.
        resolution: see :data:`Resolution`.
        folded: keep only the functions with the light's parity, in a row that is its mirror image about its middle or
            in a block that is its image under a half turn.
    """
    mesh, cell = mesh_of(supercell), supercell.cell
    orders_x, orders_y = polynomial_orders(mesh, supercell, resolution)
    tau = singular_exponent(permittivity(cell.n_pillar).real, permittivity(cell.n_ambient).real)
    sites_b, sites_a = (np.arange(count) // 2 for count in mesh.shape)
    enriched = mesh.solid[np.ix_(sites_b, sites_a)] & (tau < 1.0)
    number, sign = np.full(mesh.shape, -1), np.ones(mesh.shape)
    if supercell.shape[0] > 1:
        along_y = periodic_line(orders_y)
        number[enriched] = np.arange(np.count_nonzero(enriched))
    else:
        along_y = mirrored_line((orders_y[0], orders_y[1]), even=polarisation == "x")
        number[:, enriched[0]] = np.arange(np.count_nonzero(enriched[0]))
        sign[0] = 1.0 if along_y.even else -1.0
    along_x = periodic_line(orders_x)
    # With fixed orders the waves of one site, so that equal rows of a block are the row alone.
    parts = supercell.shape[::-1] if isinstance(resolution, tuple) else (1, 1)
    waves = tuple(
        part * math.ceil(0.5 * _WAVES * sum(orders) / part)
        for part, orders in zip(parts, (orders_x, orders_y), strict=True)
    )
    nodes = np.empty((2, *mesh.shape), dtype=np.intp)
    for b, a in np.ndindex(*mesh.shape):
        for axis, order in enumerate((orders_x[a], orders_y[b])):
            radians = 2.0 * math.pi * waves[axis] * float(np.ptp(mesh.corners(b, a)[axis])) / mesh.period_nm[axis]
            nodes[axis, b, a] = order + _NODES + math.ceil(_NODES_PER_RADIAN * radians)
    basis = Basis(mesh, along_x, along_y, tau, number, sign, (waves[0], waves[1]), nodes)
    if not folded:
        return basis
    if supercell.shape[0] > 1:
        return replace(basis, fold=half_turn_folds(along_x, along_y, number))
    across = along_y.nodal_count, along_y.edge_count
    return replace(basis, fold=folds(along_x, across, number[0], even=polarisation == "x"))


@dataclass(frozen=True)
class Element:
    """Functions of one element at its quadrature points, of which there are q."""

    place: IntArray  #: Shape (k,), numbers of the functions of E.
    e: FloatArray  #: Shape (2, k, q), E_x and E_y.
    curl: FloatArray  #: Shape (k, q).
    place_z: IntArray  #: Shape (k_z,), numbers of the functions of E_z.
    e_z: FloatArray  #: Shape (k_z, q).
    weight: FloatArray  #: Shape (q,), nm^2.
    at: FloatArray  #: Shape (2, q), x and y, nm.
    is_pillar: bool  #: Whether the element lies in a pillar.


def element(basis: Basis, b: int, a: int) -> Element:
    """Functions of element (b, a)."""
    mesh = basis.mesh
    corners = mesh.corners(b, a)
    x, y = basis.along_x, basis.along_y
    (at_u, weight_u), (at_v, weight_v) = (graded_quadrature(int(count)) for count in basis.nodes[:, b, a])
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
    fold_e, fold_z = basis.fold or (None, None)
    numbers_e, (e_x, e_y, curl) = _merged(np.concatenate(at_e), [*fields, curl / place.area], fold_e)
    numbers_z, (e_z,) = _merged(np.concatenate(at_z), [e_z], fold_z)
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


def _merged(place: IntArray, functions: list[FloatArray], fold: Fold | None) -> tuple[IntArray, list[FloatArray]]:
    """Sum of the functions of equal number (those that a mirror identifies); points flattened."""
    if fold is not None:
        kept = fold.number[place] >= 0
        place = place[kept]
        functions = [each[kept] * fold.factor[place, None, None] for each in functions]
        place = fold.number[place]
    distinct, inverse = np.unique(place, return_inverse=True)
    merged = []
    for each in functions:
        total = np.zeros((len(distinct), each[0].size))
        np.add.at(total, inverse, each.reshape(len(each), -1))
        merged.append(total)
    return distinct, merged


def elements_of(basis: Basis) -> list[Element]:
    """All elements of a mesh, row by row."""
    return [element(basis, b, a) for b, a in np.ndindex(*basis.mesh.shape)]
