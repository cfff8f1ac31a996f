"""Modes of a layer, their conditioning, and mode matching of one layer between two half spaces.

In mode matching c+ is defined at the near face and c- at the far face, so that exponentials only decay, however tall
the pillar and however evanescent the mode. Modes that decay before the other face do not couple the two faces.

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
from metafab.cell.rcwa.scattering.half_space import PlaneWaves, distinct_root
from metafab.core.conventions import ComplexArray

#: Smallest relative amplitude of a mode at the other face that still couples the two faces.
_NEGLIGIBLE = 1e-18


@dataclass(frozen=True)
class LayerModes:
    """Modes exp(+-i beta k0 z): e = E (c+ + c-), h = H (c+ - c-)."""

    beta: ComplexArray  #: Shape (n,), propagation constant over k0, Im >= 0.
    e: ComplexArray  #: Shape (n, n), one mode a column.
    h: ComplexArray  #: Shape (n, n).


@dataclass(frozen=True)
class Conditioning:
    """Conditioning of the modes of one layer, or the worst of several."""

    condition: float = 0.0  #: Condition number of the eigenvectors in the 1-norm; 0 where no modes were used.
    rounding: float = 0.0  #: Bound on the error of beta^2 from rounding in double precision.

    def worse(self, other: Conditioning) -> Conditioning:
        """The larger of each figure."""
        return Conditioning(max(self.condition, other.condition), max(self.rounding, other.rounding))


#: Conditioning where no modes were used.
NO_MODES = Conditioning()


@dataclass(frozen=True)
class FaceFields:
    """Fields that p incident waves excite at the two faces of a layer."""

    transmitted: ComplexArray  #: Shape (n, p), transverse E where the layer ends.
    reflected: ComplexArray  #: Shape (n, p), transverse E of the reflected waves where the layer begins.
    inconsistency: float  #: Violation of reciprocity by rounding, as an amplitude; 0 where modes were used.
    conditioning: Conditioning = NO_MODES  #: Conditioning of the worst layer's modes; 0 where none were used.


def layer_modes(p: Matrix, q: Matrix) -> LayerModes:
    """Solve de/dz = i P h, dh/dz = i Q e for eigenvectors of P Q, shape (n, n) each.

    beta is the root that decays along +z.
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


def match_modes(
    modes: LayerModes, thickness_k0: float, incoming: PlaneWaves, outgoing: PlaneWaves, incident: ComplexArray
) -> FaceFields:
    """Solve one layer for the fields that the waves ``incident`` excite.

    Args:
        modes: n modes of the layer.
        thickness_k0: thickness times k0.
        incoming: plane waves of the half space that the light comes from.
        outgoing: plane waves of the half space behind.
        incident: shape (n, p), transverse E of p incident waves where the layer begins.
    """
    decay = np.exp(1j * modes.beta * thickness_k0)
    coupled = np.flatnonzero(np.abs(decay) > _NEGLIGIBLE)
    decay = decay[coupled, None]
    near_e, near_h = incoming.h[:, None] * modes.e, incoming.e[:, None] * modes.h
    far_e, far_h = outgoing.h[:, None] * modes.e, outgoing.e[:, None] * modes.h
    # Where it begins:  (near_e + near_h) c+ + (near_e - near_h) X c- = 2 h_in e_inc, with X the decay;
    # where it ends:    (far_e + far_h) c- + (far_e - far_h) X c+ = 0.
    source = 2.0 * incoming.h[:, None] * incident
    solved = np.linalg.solve(near_e + near_h, np.concatenate([source, (near_e - near_h)[:, coupled] * decay.T], axis=1))
    count = incident.shape[1]
    started, reflected_near = solved[:, :count], solved[:, count:]
    reflected_far = np.linalg.solve(far_e + far_h, (far_e - far_h)[:, coupled] * decay.T)
    echo = np.eye(coupled.size) - reflected_near[coupled] @ reflected_far[coupled]
    arriving = np.linalg.solve(echo, started[coupled])
    backward = -reflected_far @ arriving
    forward = started - reflected_near @ backward[coupled]
    at_end, at_begin = backward.copy(), forward.copy()
    at_end[coupled] += decay * arriving
    at_begin[coupled] += decay * backward[coupled]
    return FaceFields(modes.e @ at_end, modes.e @ at_begin - incident, 0.0, conditioning(modes))
