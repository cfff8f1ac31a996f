"""Plane waves of a birefringent half space with principal axes x, y, z, in the basis of a symmetry class.

In (TM, TE) P is diagonal, 1 - k^2 / eps_z for TM and 1 for TE, and Q couples the TM and the TE wave of one wave vector:
the equations of :mod:`metafab.cell.halfspace` for each pair. Where a class holds one of the two by itself, it is a wave
of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.scattering.eigenmodes import PlaneWaves, distinct_root
from metafab.core.conventions import ComplexArray


@dataclass(frozen=True)
class TensorWaves:
    """Outgoing plane waves: e = ``e`` w, h = +-``h`` w for waves along +-z.

    Attributes:
        e: shape (n, n), one wave a column; no column has more than one wave vector.
        h: shape (n, n).
    """

    e: ComplexArray
    h: ComplexArray


def tensor_waves(basis: TransverseBasis, k0_per_nm: float, index: tuple[complex, complex, complex]) -> TensorWaves:
    """Outgoing waves of a half space with ``index`` along x, y and z."""
    eps_x, eps_y, eps_z = (n * n for n in map(complex, index))
    k_squared = basis.k_squared / k0_per_nm**2
    n_u = basis.u.label_a.size * basis.v.label_a.size
    of_e = np.where(np.arange(basis.size) < n_u, eps_x, eps_y)
    q = basis.turn(np.diag(of_e)) - np.diag(np.where(basis.is_tm, 0.0, k_squared))
    p = 1.0 - np.where(basis.is_tm, k_squared / eps_z, 0.0)

    e, beta_squared = np.eye(basis.size, dtype=np.complex128), p * np.diag(q)
    pairs = np.stack([basis.pair_u, basis.pair_v], axis=1)
    rows, columns = pairs[:, :, None], pairs[:, None, :]
    beta_squared[pairs], e[rows, columns] = np.linalg.eig(p[rows] * q[rows, columns])
    h = q @ e / distinct_root(beta_squared)
    # Near the edge of a cone of light h is huge: waves of unit size instead.
    size = np.maximum(np.abs(e).max(axis=0), np.abs(h).max(axis=0))
    return TensorWaves(e / size, h / size)


def as_matrices(waves: PlaneWaves | TensorWaves) -> tuple[ComplexArray, ComplexArray]:
    """E and H of e = E w, h = H w, each of shape (n, n)."""
    if isinstance(waves, TensorWaves):
        return waves.e, waves.h
    return np.diag(waves.e), np.diag(waves.h)


def magnetic(waves: PlaneWaves | TensorWaves, field: ComplexArray) -> ComplexArray:
    """H of outgoing waves with transverse E ``field``, shape (n, any); 0 where a wave has no E at all."""
    if isinstance(waves, TensorWaves):
        return np.asarray(waves.h @ np.linalg.solve(waves.e, field))
    return np.asarray((waves.h / np.where(waves.e == 0.0, np.inf, waves.e))[:, None] * field)
