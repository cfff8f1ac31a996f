"""Modes of a layer that is uniform along z, and the plane waves of a half space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis.axis import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.core.conventions import ComplexArray

#: Below this propagation constant (over k0) the two directions of a mode or a wave coincide; it is moved up to here.
_SMALLEST_BETA = 1e-9


@dataclass(frozen=True)
class LayerModes:
    """Modes exp(+-i beta k0 z): e = E (c+ + c-), h = H (c+ - c-).

    Attributes:
        beta: shape (n,), propagation constant over k0, Im >= 0.
        e: shape (n, n), one mode a column.
        h: shape (n, n).
    """

    beta: ComplexArray
    e: ComplexArray
    h: ComplexArray


@dataclass(frozen=True)
class PlaneWaves:
    """Outgoing plane waves of a half space, diagonal: e = ``e`` w, h = +-``h`` w for waves along +-z.

    A TE wave has w = E and a TM wave eps w = H, so that neither blows up at a Rayleigh anomaly.

    Attributes:
        beta: shape (n,), propagation constant over k0, Im >= 0.
        e: shape (n,).
        h: shape (n,).
    """

    beta: ComplexArray
    e: ComplexArray
    h: ComplexArray


def layer_modes(p: Matrix, q: Matrix) -> LayerModes:
    """Modes of de/dz = i P h, dh/dz = i Q e: eigenvectors of P Q, beta the root that decays along +z."""
    beta_squared, e = np.linalg.eig(p @ q)
    beta = distinct_root(beta_squared)
    return LayerModes(beta, e, q @ e / beta)


def plane_waves(basis: TransverseBasis, k0_per_nm: float, eps: complex) -> PlaneWaves:
    """Outgoing plane waves of the half space ``eps``."""
    beta = decaying_root(eps - basis.k_squared / k0_per_nm**2)
    return PlaneWaves(beta, np.where(basis.is_tm, beta, 1.0), np.where(basis.is_tm, eps, beta))


def distinct_root(beta_squared: Matrix) -> ComplexArray:
    """:func:`decaying_root`, kept so far from zero that the two directions differ and one can divide by it."""
    beta = decaying_root(beta_squared)
    return np.where(np.abs(beta) < _SMALLEST_BETA, _SMALLEST_BETA, beta)


def decaying_root(beta_squared: Matrix) -> ComplexArray:
    """Square root with Im > 0, or Re >= 0 where rounding leaves the imaginary part's sign open."""
    root = np.sqrt(np.asarray(beta_squared, dtype=np.complex128))
    backward = root.imag < -1e-12 * np.abs(root.real)
    return np.where(backward, -root, root)
