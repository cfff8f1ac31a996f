"""Jones matrices of a cell with a curved outline at one polynomial order.

With the Gram matrices M of the functions of E, K of their curl, S of E_z and the gradient D, z in units of 1/k0,

    de/dz = i P h,    P = M^-1 - D S_eps^-1 D^T / k0^2,
    dh/dz = i Q e,    Q = M_eps - K / k0^2,

as in :mod:`metafab.cell.elements.assembly`. A half space is the empty cell in the same functions: its TE waves are the
eigenvectors of K e = k^2 M e, its TM waves the gradients of those of D^T M D f = k^2 S f. From the far half space on,
h = Y e is carried from face to face of the layers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from metafab.cell.curved.functions import Functions, functions_of
from metafab.cell.curved.mesh import quarter_mesh
from metafab.cell.elements.assembly import Grams
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.jones import ZeroOrder
from metafab.cell.rcwa.layers.factorisation import largest_eigenvalue
from metafab.cell.rcwa.scattering.doubling import slab
from metafab.cell.rcwa.scattering.half_space import distinct_root
from metafab.cell.rcwa.scattering.modes import NO_MODES
from metafab.cell.rcwa.symmetry import permittivity, polarisations_swap
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.errors import SolverError
from metafab.core.parallel.executor import one_blas_thread

#: Largest eigenvalue of a constant potential over the largest of all.
_STATIC = 1e-12


def zero_order(cell: PillarCell, order: int) -> ZeroOrder:
    """Solve ``cell`` for its Jones matrices with one polynomial order on every element.

    Args:
        cell: a cell that :func:`metafab.cell.curved.mesh.is_treated` accepts.
        order: polynomial order, from 2.

    Raises:
        SolverError: a layer is singular.
    """
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    powers, count = np.zeros((2, 2)), 0
    with one_blas_thread():
        for axis, light in enumerate(POLARISATIONS):
            if axis and polarisations_swap(cell):
                t[1, 1], r[1, 1], powers[:, 1] = t[0, 0], r[0, 0], powers[:, 0]
                break
            solved = _solved(cell, light, order)
            area_nm2, count = solved.matrices.area_nm2, len(solved.uniform)
            mean, incident = solved.uniform / area_nm2, complex(cell.n_in[axis]).real * area_nm2
            t[axis, axis], r[axis, axis] = mean @ solved.transmitted, mean @ solved.reflected
            for side, (e, admittance) in enumerate(((solved.transmitted, solved.far), (solved.reflected, solved.near))):
                powers[side, axis] = np.vdot(e, admittance @ e).real / incident
    return ZeroOrder(t, r, powers[0], powers[1], count, 0.0, NO_MODES)


@dataclass(frozen=True)
class MeshWaves:
    """In-plane wave numbers and fields of the TM and TE waves of a uniform medium, each of unit norm."""

    k_squared_tm: FloatArray  #: Shape (n_tm,), 1/nm^2.
    tm: FloatArray  #: Shape (N, n_tm), M e of each wave.
    k_squared_te: FloatArray  #: Shape (n_te,), 1/nm^2; 0 for the uniform fields of the lights, which come first.
    te: FloatArray  #: Shape (N, n_te), M e of each wave.

    def admittance(self, eps: complex, k0_per_nm: float) -> ComplexArray:
        """Y of a half space: h = Y e for outgoing waves, shape (N, N), symmetric."""
        of_tm, of_te = (distinct_root(eps - k2 / k0_per_nm**2) for k2 in (self.k_squared_tm, self.k_squared_te))
        weight, fields = np.concatenate([eps / of_tm, of_te]), np.concatenate([self.tm, self.te], axis=1)

        def summed(part: FloatArray) -> FloatArray:
            # Among real indices, waves that travel have a real weight, the others an imaginary one.
            some = part != 0.0
            return np.asarray((fields[:, some] * part[some]) @ fields[:, some].T)

        return np.asarray(summed(weight.real) + 1j * summed(weight.imag))


@dataclass(frozen=True)
class MeshMatrices:
    """Matrices of N functions of E over a mesh."""

    grams: Grams  #: Gram matrices.
    uniform: FloatArray  #: Shape (n_lights, N), integral of each function's component along each light.
    area_nm2: float  #: Area of the elements.

    @classmethod
    def of(cls, functions: Functions, axes: list[int]) -> MeshMatrices:
        """Sum over the elements; ``axes`` are those of the lights."""
        uniform = np.zeros((len(axes), len(functions.gradient)))
        for each in functions.elements:
            uniform[:, each.place] += each.e[axes] @ each.weight
        area_nm2 = sum(float(each.weight.sum()) for each in functions.elements)
        return cls(Grams.of(functions.elements, functions.gradient), uniform, area_nm2)

    def waves(self) -> MeshWaves:
        """Plane waves of a half space.

        On a curved mesh the functions only approximate the uniform fields. The part of these that has a curl is
        removed, so that the waves are orthogonal and power is conserved exactly.
        """
        grams = self.grams
        lifted = grams.e @ grams.gradient
        k_tm, potential = eigh(grams.gradient.T @ lifted, grams.z)
        static = k_tm < _STATIC * k_tm[-1]  # a constant potential, where no mirror plane excludes it
        k_tm, potential = k_tm[~static], potential[:, ~static]
        # The gradients and the uniform fields have no curl: the other waves are above these in k.
        k_te, fields = eigh(grams.curl, grams.e)
        first = len(k_tm) + len(self.uniform)
        te = grams.e @ fields[:, first:]
        uniform = self.uniform.T - te @ (fields[:, first:].T @ self.uniform.T)
        uniform /= np.sqrt(np.sum(uniform * (grams.inverse @ uniform), axis=0))
        te = np.concatenate([uniform, te], axis=1)
        k_te = np.concatenate([np.zeros(len(self.uniform)), k_te[first:]])
        return MeshWaves(k_tm, lifted @ (potential / np.sqrt(k_tm)), k_te, te)


def order_efficiencies(cell: PillarCell, order: int, sides: Sequence[Sequence[tuple[int, int]]]) -> FloatArray:
    """Power of the transmitted, then of the reflected orders over the incident power, for x and y light.

    Args:
        cell: as in :func:`zero_order`.
        order: polynomial order, from 2.
        sides: transmitted and reflected orders (m, n), of the centred cell of two rows in a hexagonal lattice.

    Returns:
        Shape (n_orders, 2); 0 where an order propagates for the other light alone.
    """
    length_nm = cell.period_nm[0], cell.period_nm[1] * (2 if cell.is_staggered else 1)
    powers: list[list[float]] = []
    with one_blas_thread():
        for axis, light in enumerate(POLARISATIONS):
            solved = _solved(cell, light, order)
            fields = solved.transmitted, solved.reflected
            powers.append([])
            for field, n, side in zip(fields, (cell.n_out[axis], cell.n_in[axis]), sides, strict=True):
                for number in side:
                    k = 2.0 * math.pi * np.divide(number, length_nm)
                    k_z_squared = (complex(n).real * cell.k0_per_nm) ** 2 - float(k @ k)
                    if k_z_squared <= 0.0:
                        powers[-1].append(0.0)
                        continue
                    amplitude = np.zeros(2, dtype=np.complex128)
                    for each in solved.functions.elements:
                        (cos_x, cos_y), (sin_x, sin_y) = np.cos(k[:, None] * each.at), np.sin(k[:, None] * each.at)
                        # The light's component is even about both mirrors, the other one odd.
                        for of_axis in range(2):
                            wave = cos_x * cos_y if of_axis == axis else -sin_x * sin_y
                            amplitude[of_axis] += field[each.place] @ (each.e[of_axis] @ (each.weight * wave))
                    amplitude /= solved.matrices.area_nm2
                    k_z = math.sqrt(k_z_squared)
                    power = k_z * np.vdot(amplitude, amplitude).real + abs(k @ amplitude) ** 2 / k_z
                    powers[-1].append(float(power) / (cell.k0_per_nm * complex(cell.n_in[axis]).real))
    return np.array(powers).T


@dataclass(frozen=True)
class _Solved:
    """Fields of one light through a cell."""

    functions: Functions
    matrices: MeshMatrices
    uniform: FloatArray  #: Shape (N,), M e of the light's uniform field.
    near: ComplexArray  #: Shape (N, N), admittance of the half space that the light comes from.
    far: ComplexArray  #: Shape (N, N), admittance of the other one.
    transmitted: ComplexArray  #: Shape (N,), E at the far face.
    reflected: ComplexArray  #: Shape (N,), E of the reflected light at the near face.


def _solved(cell: PillarCell, light: Polarisation, order: int) -> _Solved:
    """Solve a cell for one light, from the far half space to the near one and back."""
    axis, k0 = POLARISATIONS.index(light), cell.k0_per_nm
    functions = functions_of(quarter_mesh(cell), light, order)
    matrices = MeshMatrices.of(functions, [axis])
    waves = matrices.waves()
    n_in, n_out = complex(cell.n_in[axis]), complex(cell.n_out[axis])
    near, far = (waves.admittance(permittivity(n), k0) for n in (n_in, n_out))
    upwards = (*cell.under, cell.layer, *cell.over)
    behind, faces = far, []
    for layer in upwards[::-1] if cell.side == "substrate" else upwards:
        largest = largest_eigenvalue(permittivity(layer.n_inside), permittivity(layer.n_around))
        both = slab(*matrices.grams.p_and_q(layer, k0), k0 * layer.height_nm, largest)
        if both is None:
            raise SolverError(f"a layer of {cell} is singular in elements of order {order}")
        phi, gamma = both
        through = np.linalg.solve(behind + 1j * phi, 1j * gamma)
        behind = 1j * (phi - gamma @ through)
        faces.append(through)
    uniform = math.sqrt(matrices.area_nm2) * waves.te[:, 0]
    first = np.linalg.solve(near + behind, 2.0 * n_in * uniform)
    last = first
    for through in reversed(faces):
        last = through @ last
    transmitted, reflected = (np.asarray(e, np.complex128) for e in (last, first - matrices.grams.inverse @ uniform))
    return _Solved(functions, matrices, uniform, near, far, transmitted, reflected)
