"""Maxwell's equations of one layer as two matrices, by Li's factorisation rules for a rectangle.

In units of 1/k0 along z, for e = (E_u, E_v) and h = (H_v, -H_u),

    de/dz = i P h,    P = 1 - B N^-1 B^T,                         B = [K_u;  K_v^T] (from E_z),
    dh/dz = i Q e,    Q = [[eps_u, 0], [0, eps_v]] - C C^T,       C = [K_v; -K_u^T] (from H_z),

with N the matrix of the permittivity for E_z and i K the derivative from family b to family a. All are real where the
permittivity is real. E_u is normal to two walls and tangential to the other two: its permittivity follows the inverse
rule along u within each interval of v, then the direct rule along v (Li, J. Opt. Soc. Am. A 14, 2758, 1997). For a
rectangle that is a sum of two Kronecker products of one-dimensional matrices.
"""

from __future__ import annotations

import numpy as np

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.core.conventions import FloatArray


def layer_matrices(
    basis: TransverseBasis, k0_per_nm: float, eps_pillar: complex, eps_around: complex
) -> tuple[Matrix, Matrix]:
    """P and Q of a layer that holds a rectangle, in the (TM, TE) basis of n coefficients: shape (n, n) each.

    A real permittivity of the pillar gives real matrices where the symmetry class allows it.
    """
    u, v = basis.u, basis.v
    contrast_u, contrast_v = (contrast(x, eps_pillar, eps_around) for x in (u.a, v.b))
    eta_z = inverse_of_direct_rule(u.b, v.a, eps_pillar, eps_around)
    return assembled(basis, k0_per_nm, kron(contrast_u, v.a), kron(u.b, contrast_v), eta_z, eps_around)


def assembled(
    basis: TransverseBasis, k0_per_nm: float, contrast_u: Matrix, contrast_v: Matrix, eta_z: Matrix, eps_around: complex
) -> tuple[Matrix, Matrix]:
    """P and Q in the (TM, TE) basis from the permittivity matrix of each component of E.

    Args:
        basis: symmetry class, n coefficients.
        contrast_u: shape (n_u, n_u), permittivity for E_u less ``eps_around``.
        contrast_v: shape (n_v, n_v), permittivity for E_v less ``eps_around``.
        eta_z: shape (n_z, n_z), inverse of the permittivity for E_z.
        eps_around: permittivity around the pillar.

    Returns:
        P and Q, each of shape (n, n).
    """
    # In (TM, TE), E_z drives only the TM wave and H_z only the TE wave of equal wave vector.
    n_u = len(contrast_u)
    q = np.zeros((basis.size, basis.size), dtype=np.result_type(contrast_u, contrast_v))
    q[:n_u, :n_u], q[n_u:, n_u:] = contrast_u, contrast_v
    q = basis.to_tm_te(q)
    _diagonal(q)[:] += eps_around - np.where(basis.is_tm, 0.0, basis.k_squared / k0_per_nm**2)
    k = basis.k_with_e_z / k0_per_nm
    p = np.eye(basis.size, dtype=eta_z.dtype)
    p[basis.with_e_z[:, None], basis.with_e_z] -= k[:, None] * eta_z * k
    return p, q


def largest_eigenvalue(eps_pillar: complex, eps_around: complex) -> float:
    """Bound on the real part of the eigenvalues of P Q: the larger permittivity; infinite for metals.

    No mode of a dielectric layer is slower than light in the denser material, at any truncation. Surface modes of a
    metal can be.
    """
    eps = (complex(eps_pillar), complex(eps_around))
    dielectric = all(abs(each.imag) <= each.real for each in eps)
    return max(map(abs, eps)) if dielectric else float("inf")


def inverse_rule(overlap: Matrix, eps_pillar: complex, eps_around: complex) -> Matrix:
    """Permittivity for a field normal to the walls, by Li's inverse rule: shape (n, n).

    ``overlap``, of the same shape, is the pillar's indicator along the axis.
    """
    mixed = overlap * (1.0 / eps_pillar - 1.0 / eps_around)
    _diagonal(mixed)[:] += 1.0 / eps_around
    return np.linalg.inv(mixed)


def contrast(overlap: FloatArray, eps_pillar: complex, eps_around: complex) -> Matrix:
    """:func:`inverse_rule` less the permittivity around the pillar; ``overlap`` and result of shape (n, n)."""
    rule = inverse_rule(overlap, eps_pillar, eps_around)
    _diagonal(rule)[:] -= eps_around
    return rule


def inverse_of_direct_rule(u: FloatArray, v: FloatArray, eps_pillar: complex, eps_around: complex) -> Matrix:
    """Inverse of eps_around + (eps_pillar - eps_around) u (x) v from the eigenvectors of the two small factors.

    ``u``, shape (n, n), and ``v``, shape (m, m), are symmetric; the inverse has the shape (n m, n m).
    """
    value_u, vector_u = np.linalg.eigh(u)
    value_v, vector_v = np.linalg.eigh(v)
    weight = 1.0 / (eps_around + (eps_pillar - eps_around) * value_u[:, None] * value_v)
    outer_u, outer_v = ((x[:, None] * x).reshape(-1, len(x)) for x in (vector_u, vector_v))
    product = (outer_u @ weight @ outer_v.T).reshape(len(u), len(u), len(v), len(v))
    return np.asarray(product.transpose(0, 2, 1, 3).reshape(len(u) * len(v), -1))


def _diagonal(matrix: Matrix) -> Matrix:
    """Writable view of the diagonal of a square matrix."""
    return np.asarray(np.einsum("ii->i", matrix))


def kron(u: Matrix, v: Matrix) -> Matrix:
    """Kronecker product of ``u``, shape (n, m), and ``v``, shape (p, q); shape (n p, m q)."""
    product = u[:, None, :, None] * v[None, :, None, :]
    return np.asarray(product.reshape(u.shape[0] * v.shape[0], u.shape[1] * v.shape[1]))
