"""How ill-conditioned a layer's modes are, and what rounding can do to an answer that was found by them.

Eigenvectors E of A = P Q exist for every layer met in practice, but two of them may come close to each other (at an
exceptional point they meet, and A has no full set). By the theorem of Bauer and Fike (Golub and Van Loan, Matrix
Computations, section 7.2) an error dA moves the eigenvalues beta^2 by at most cond(E) |dA|; rounding is an error of
about the largest eigenvalue times the precision of the arithmetic. On silicon, metals and indices of a thousand,
amplitudes by modes and by doubling were found nearer to each other than that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from metafab.cell.rcwa.basis.axis import Matrix
from metafab.cell.rcwa.scattering.eigenmodes import LayerModes


class Conditioning(NamedTuple):
    """Of the modes of one layer, or the worst of several.

    Attributes:
        condition: condition number of the eigenvectors in the 1-norm; 0 where no modes were used.
        rounding: what it makes of the rounding of double precision, in beta^2.
    """

    condition: float = 0.0
    rounding: float = 0.0

    def worse(self, other: Conditioning) -> Conditioning:
        """The larger of each."""
        return Conditioning(max(self.condition, other.condition), max(self.rounding, other.rounding))


#: Where no modes were used.
NO_MODES = Conditioning()


def conditioning(modes: LayerModes) -> Conditioning:
    """Conditioning of the modes of one layer."""
    number = condition(modes.e)
    return Conditioning(number, float(np.finfo(np.float64).eps) * number * float(np.abs(modes.beta).max()) ** 2)


def condition(matrix: Matrix) -> float:
    """Condition number of a square matrix in the 1-norm, by LAPACK's estimate from its LU factors; inf if singular."""
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
