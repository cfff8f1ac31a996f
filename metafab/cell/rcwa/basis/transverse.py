"""Transverse field of one symmetry class: its coefficients, paired to TM and TE plane waves.

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
    """Coefficients of E_u and E_v, those of equal wave vector rotated to (TM, TE): diagonal in every uniform medium.

    Where only one of E_u and E_v has a wave vector, that coefficient is TM (along it) or TE (across it). A wave vector
    of zero counts as TE.

    Attributes:
        u: families along x.
        v: families along y.
        k_squared: shape (n,), in-plane wave number squared of each coefficient, 1/nm^2; E_u first, then E_v.
        is_tm: shape (n,), whether the coefficient is TM.
        pair_u, pair_v: shape (pairs,), coefficients of E_u and of E_v that share a wave vector.
        along: shape (2, pairs), the unit vector (u, v) along it.
        with_e_z: shape (n_z,), the coefficient that each coefficient of E_z drives: TM, or without a wave vector.
        k_with_e_z: shape (n_z,), wave number that takes E_z to that coefficient, 1/nm; negative for an unpaired
            coefficient of negative wave number.
    """

    u: AxisParity
    v: AxisParity
    k_squared: FloatArray
    is_tm: np.ndarray
    pair_u: IntArray
    pair_v: IntArray
    along: FloatArray
    with_e_z: IntArray
    k_with_e_z: FloatArray

    @property
    def size(self) -> int:
        """Number of coefficients n."""
        return int(self.k_squared.size)

    def turn(self, matrix: Matrix) -> Matrix:
        """Change the basis of a symmetric ``matrix``, shape (n, n), from (E_u, E_v) to (TM, TE); shape (n, n)."""
        return self.turn_rows(self.turn_rows(matrix).T)

    def turn_rows(self, columns: Matrix) -> Matrix:
        """Change the basis of ``columns``, shape (n, any), from (E_u, E_v) to (TM, TE); shape (n, any)."""
        turned = np.array(columns, order="C")
        e_u, e_v = turned[self.pair_u], turned[self.pair_v]
        a_u, a_v = self.along[:, :, None]
        turned[self.pair_u] = a_u * e_u + a_v * e_v
        turned[self.pair_v] = a_u * e_v - a_v * e_u
        return turned

    def zero_order(self) -> ComplexArray:
        """Incident E_x = 1 and E_y = 1 as columns, shape (n, 2); zero where the class does not hold them."""
        field = np.zeros((self.size, 2), dtype=np.complex128)
        n_u = self.u.label_a.size * self.v.label_a.size
        if self.u.label_a[0] == 0 and self.v.label_a[0] == 0:
            field[0, 0] = 1.0
        if self.u.label_b[0] == 0 and self.v.label_b[0] == 0:
            field[n_u, 1] = 1.0
        return np.asarray(self.turn_rows(field))


def transverse_basis(u: AxisParity, v: AxisParity) -> TransverseBasis:
    """The transverse basis of the symmetry class with families ``u`` along x and ``v`` along y."""
    labels = (axis.tobytes() for axis in (u.label_a, u.label_b, v.label_a, v.label_b))
    label, pair_u, pair_v, with_e_z = _pairs(*labels)
    n_u = u.label_a.size * v.label_a.size
    k_u, k_v = u.wavenumber[label[0]], v.wavenumber[label[1]]
    k_squared = k_u**2 + k_v**2

    norm = np.sqrt(k_squared[pair_u])
    resting = norm == 0.0
    along = np.stack([k_u[pair_u], k_v[pair_u]]) / np.where(resting, 1.0, norm)
    along[0, resting] = 1.0

    alone = np.concatenate([k_u[:n_u], k_v[n_u:]])
    is_tm = alone != 0.0
    is_tm[pair_u] = True
    is_tm[pair_v] = False
    alone[pair_u] = norm
    return TransverseBasis(u, v, k_squared, is_tm, pair_u, pair_v, along, with_e_z, alone[with_e_z])


@lru_cache(maxsize=64)
def _pairs(u_a: bytes, u_b: bytes, v_a: bytes, v_b: bytes) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Labels (2, n) of all coefficients; pairs of E_u and E_v of equal label; coefficients that E_z drives.

    Arguments are the bytes of the axes' labels, which can be hashed.
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
