"""Modes of a layer that is uniform along z, their conditioning, and the effect of rounding on answers by modes.

Eigenvectors E of A = P Q exist for every layer met in practice, but two of them may come close to each other (at an
exceptional point they meet, and A has no full set). By the theorem of Bauer and Fike (Golub and Van Loan, Matrix
Computations, section 7.2) an error dA moves the eigenvalues beta^2 by at most cond(E) |dA|. Rounding is an error of
about the largest eigenvalue times the precision of the arithmetic. On silicon, metals and indices of a thousand,
amplitudes by modes and by doubling differed by less than this bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.scattering.half_space import distinct_root
from metafab.core.conventions import ComplexArray


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
class Conditioning:
    """Conditioning of the modes of one layer, or the worst of several.

    Attributes:
        condition: condition number of the eigenvectors in the 1-norm; 0 where no modes were used.
        rounding: bound on the error of beta^2 from rounding in double precision.
    """

    condition: float = 0.0
    rounding: float = 0.0

    def worse(self, other: Conditioning) -> Conditioning:
        """The larger of each figure."""
        return Conditioning(max(self.condition, other.condition), max(self.rounding, other.rounding))


#: Conditioning where no modes were used.
NO_MODES = Conditioning()


def layer_modes(p: Matrix, q: Matrix) -> LayerModes:
    """Solve de/dz = i P h, dh/dz = i Q e for eigenvectors of P Q; beta is the root that decays along +z.

    Args:
        p: shape (n, n), P of the layer.
        q: shape (n, n), Q of the layer.
    """
    beta_squared, e = np.linalg.eig(p @ q)
    beta = distinct_root(beta_squared)
    return LayerModes(beta, e, q @ e / beta)


def conditioning(modes: LayerModes) -> Conditioning:
    """Conditioning of the modes of one layer."""
    number = condition(modes.e)
    return Conditioning(number, float(np.finfo(np.float64).eps) * number * float(np.abs(modes.beta).max()) ** 2)


def condition(matrix: Matrix) -> float:
    """Condition number of a ``matrix``, shape (n, n), in the 1-norm, by LAPACK's estimate; inf if singular."""
    largest = float(np.abs(matrix).sum(axis=0).max())
    if not np.isfinite(largest):
        return np.inf
    complex_ = matrix.dtype == np.complex128
    factor, estimate = (lapack.zgetrf, lapack.zgecon) if complex_ else (lapack.dgetrf, lapack.dgecon)
    lu, _, info = factor(matrix)
    if info != 0:
        return np.inf
    reciprocal, _ = estimate(lu, largest, norm="1")
    return 1.0 / float(reciprocal) if reciprocal > 0.0 else np.inf
