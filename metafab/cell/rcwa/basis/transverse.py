"""Transverse field of one symmetry class: coefficients of E_u and E_v, combined to TM and TE plane waves.

E_u lives in the families (a, a) of the two axes, E_v in (b, b), E_z in (b, a), H_z in (a, b); H_v goes with E_u and
-H_u with E_v. With light along z a rectangle has four symmetry classes, of which x and y polarised light see one each;
each has a quarter of all coefficients (Li, J. Opt. A 5, 345, 2003; Bai and Li, J. Opt. A 7, 783, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metafab.cell.rcwa.basis.axis import AxisParity
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix
from metafab.core.conventions import ComplexArray, FloatArray


@dataclass(frozen=True)
class TransverseBasis:
    """Basis of the transverse field in which every uniform medium is diagonal.

    Coefficients of E_u and E_v with equal wave vector are rotated to (TM, TE). An unpaired coefficient is TM if its
    field is along the wave vector, TE if it is across. A wave vector of zero counts as TE.
    """

    u: AxisParity  #: Families along x.
    v: AxisParity  #: Families along y.
    #: Shape (n,), in-plane wave number squared of each coefficient, 1/nm^2; E_u first, then E_v.
    k_squared: FloatArray
    is_tm: np.ndarray  #: Shape (n,), whether the coefficient is TM.
    pair_u: IntArray  #: Shape (pairs,), coefficients of E_u that share a wave vector with one of E_v.
    pair_v: IntArray  #: Shape (pairs,), these coefficients of E_v.
    along: FloatArray  #: Shape (2, pairs), unit vector (u, v) along the wave vector of each pair.
    #: Shape (n_z,), index of the coefficient that each coefficient of E_z drives: a TM coefficient, or one of wave
    #: vector zero.
    with_e_z: IntArray
    #: Shape (n_z,), wave number that takes E_z to that coefficient, 1/nm; negative for an unpaired coefficient of
    #: negative wave number.
    k_with_e_z: FloatArray

    @property
    def size(self) -> int:
        """Number of coefficients n."""
        return int(self.k_squared.size)

    def to_tm_te(self, matrix: Matrix) -> Matrix:
        """Change the basis of a symmetric ``matrix``, shape (n, n), from (E_u, E_v) to (TM, TE); shape (n, n)."""
        return self.rows_to_tm_te(self.rows_to_tm_te(matrix).T)

    def rows_to_tm_te(self, columns: Matrix) -> Matrix:
        """Change the basis of ``columns``, shape (n, any), from (E_u, E_v) to (TM, TE); shape (n, any)."""
        rotated = np.array(columns, order="C")
        e_u, e_v = rotated[self.pair_u], rotated[self.pair_v]
        a_u, a_v = self.along[:, :, None]
        rotated[self.pair_u] = a_u * e_u + a_v * e_v
        rotated[self.pair_v] = a_u * e_v - a_v * e_u
        return rotated

    def zero_order(self) -> ComplexArray:
        """Incident E_x = 1 and E_y = 1 as columns, shape (n, 2); zero if the class lacks that wave."""
        field = np.zeros((self.size, 2), dtype=np.complex128)
        n_u = self.u.label_a.size * self.v.label_a.size
        if self.u.label_a[0] == 0 and self.v.label_a[0] == 0:
            field[0, 0] = 1.0
        if self.u.label_b[0] == 0 and self.v.label_b[0] == 0:
            field[n_u, 1] = 1.0
        return np.asarray(self.rows_to_tm_te(field))


def transverse_basis(u: AxisParity, v: AxisParity) -> TransverseBasis:
    """The transverse basis of the symmetry class with families ``u`` along x and ``v`` along y."""
    labels = (axis.tobytes() for axis in (u.label_a, u.label_b, v.label_a, v.label_b))
    label, pair_u, pair_v, with_e_z = _pairs(*labels)
    n_u = u.label_a.size * v.label_a.size
    k_u, k_v = u.wavenumber[label[0]], v.wavenumber[label[1]]
    k_squared = k_u**2 + k_v**2

    norm = np.sqrt(k_squared[pair_u])
    is_zero = norm == 0.0
    along = np.stack([k_u[pair_u], k_v[pair_u]]) / np.where(is_zero, 1.0, norm)
    along[0, is_zero] = 1.0

    k_with = np.concatenate([k_u[:n_u], k_v[n_u:]])
    is_tm = k_with != 0.0
    is_tm[pair_u] = True
    is_tm[pair_v] = False
    k_with[pair_u] = norm
    return TransverseBasis(u, v, k_squared, is_tm, pair_u, pair_v, along, with_e_z, k_with[with_e_z])


@lru_cache(maxsize=64)
def _pairs(u_a: bytes, u_b: bytes, v_a: bytes, v_b: bytes) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Labels (2, n) of all coefficients; pairs of E_u and E_v of equal label; coefficients that E_z drives.

    The arguments are the axes' labels as bytes, which the cache can hash.
    """
    in_e_u, in_e_v, in_e_z = _grid(u_a, v_a), _grid(u_b, v_b), _grid(u_b, v_a)
    stride = 1 + max(in_e_u.max(initial=0), in_e_v.max(initial=0))
    flat_u, flat_v, flat_z = (grid[0] * stride + grid[1] for grid in (in_e_u, in_e_v, in_e_z))
    _, pair_u, pair_v = np.intersect1d(flat_u, flat_v, return_indices=True)
    # E_z drives E_u where both exist, and E_v where E_u does not.
    place = {flat: i + flat_u.size for i, flat in enumerate(flat_v)} | {flat: i for i, flat in enumerate(flat_u)}
    with_e_z = np.array([place[flat] for flat in flat_z], dtype=np.intp)
    return np.concatenate([in_e_u, in_e_v], axis=1), pair_u, pair_v + flat_u.size, with_e_z


def _grid(first: bytes, second: bytes) -> IntArray:
    u, v = np.frombuffer(first, dtype=np.intp), np.frombuffer(second, dtype=np.intp)
    return np.stack([np.repeat(u, v.size), np.tile(v, u.size)])
