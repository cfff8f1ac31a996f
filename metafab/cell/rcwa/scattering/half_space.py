"""Outgoing plane waves of a half space in the basis of a symmetry class, isotropic or birefringent.

In (TM, TE) P is diagonal, 1 - k^2 / eps_z for TM and 1 for TE. In an isotropic half space Q is diagonal too. With
principal axes x, y and z, Q couples the TM and the TE wave of one wave vector: the equations of
:mod:`metafab.cell.fresnel` for each pair. A TM or TE wave that a class holds without its partner is a wave of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.core.conventions import ComplexArray

#: Smallest propagation constant over k0: below it the two directions of a mode or a wave coincide.
_SMALLEST_BETA = 1e-9


@dataclass(frozen=True)
class PlaneWaves:
    """Outgoing plane waves of an isotropic half space: e = ``e`` w, h = +-``h`` w for waves along +-z, diagonal.

    A TE wave has w = E and a TM wave eps w = H, so that neither diverges at a Rayleigh anomaly.
    """

    beta: ComplexArray  #: Shape (n,), propagation constant over k0, Im >= 0.
    e: ComplexArray  #: Shape (n,).
    h: ComplexArray  #: Shape (n,).


@dataclass(frozen=True)
class TensorWaves:
    """Outgoing plane waves of a birefringent half space: e = ``e`` w, h = +-``h`` w for waves along +-z."""

    e: ComplexArray  #: Shape (n, n), one wave a column; each column holds one wave vector.
    h: ComplexArray  #: Shape (n, n).


#: Outgoing waves of either kind of half space.
Waves = PlaneWaves | TensorWaves


def plane_waves(basis: TransverseBasis, k0_per_nm: float, eps: complex) -> PlaneWaves:
    """Outgoing plane waves of the half space with permittivity ``eps``."""
    beta = decaying_root(eps - basis.k_squared / k0_per_nm**2)
    return PlaneWaves(beta, np.where(basis.is_tm, beta, 1.0), np.where(basis.is_tm, eps, beta))


def tensor_waves(basis: TransverseBasis, k0_per_nm: float, index: tuple[complex, complex, complex]) -> TensorWaves:
    """Outgoing waves of a half space with ``index`` along x, y and z."""
    eps_x, eps_y, eps_z = (n * n for n in map(complex, index))
    k_squared = basis.k_squared / k0_per_nm**2
    n_u = basis.u.label_a.size * basis.v.label_a.size
    of_e = np.where(np.arange(basis.size) < n_u, eps_x, eps_y)
    q = basis.to_tm_te(np.diag(of_e)) - np.diag(np.where(basis.is_tm, 0.0, k_squared))
    p = 1.0 - np.where(basis.is_tm, k_squared / eps_z, 0.0)

    e, beta_squared = np.eye(basis.size, dtype=np.complex128), p * np.diag(q)
    pairs = np.stack([basis.pair_u, basis.pair_v], axis=1)
    rows, columns = pairs[:, :, None], pairs[:, None, :]
    beta_squared[pairs], e[rows, columns] = np.linalg.eig(p[rows] * q[rows, columns])
    h = q @ e / distinct_root(beta_squared)
    # Near the edge of a light cone h is huge: scale the waves to unit size.
    size = np.maximum(np.abs(e).max(axis=0), np.abs(h).max(axis=0))
    return TensorWaves(e / size, h / size)


def as_matrices(waves: Waves) -> tuple[ComplexArray, ComplexArray]:
    """E and H of e = E w and h = H w, each of shape (n, n)."""
    if isinstance(waves, TensorWaves):
        return waves.e, waves.h
    return np.diag(waves.e), np.diag(waves.h)


def magnetic(waves: Waves, field: ComplexArray) -> ComplexArray:
    """Transverse H of outgoing waves with transverse E ``field``, both of shape (n, any); 0 where a wave has no E."""
    if isinstance(waves, TensorWaves):
        return np.asarray(waves.h @ np.linalg.solve(waves.e, field))
    return np.asarray((waves.h / np.where(waves.e == 0.0, np.inf, waves.e))[:, None] * field)


def distinct_root(beta_squared: Matrix) -> ComplexArray:
    """:func:`decaying_root` kept away from zero, so that the two directions differ; any shape."""
    beta = decaying_root(beta_squared)
    return np.where(np.abs(beta) < _SMALLEST_BETA, _SMALLEST_BETA, beta)


def decaying_root(beta_squared: Matrix) -> ComplexArray:
    """Square root with Im > 0, or with Re >= 0 where rounding leaves the sign of Im open; any shape."""
    root = np.sqrt(np.asarray(beta_squared, dtype=np.complex128))
    backward = root.imag < -1e-12 * np.abs(root.real)
    return np.where(backward, -root, root)
