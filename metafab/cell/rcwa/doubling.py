"""One incident wave through one layer without its modes: the layer's two-port matrices by doubling its thickness.

In a layer e'' = -A e with A = P Q and z in units of 1/k0. With W^2 = A, the fields at the faces of a slab of thickness
d obey

    P h(0) = i (F e(0) - G e(d)),      P h(d) = i (G e(0) - F e(d)),      F = W cot(W d),    G = W / sin(W d),

and both matrices are functions of A, without a branch of the root. A thin slab has them from their power series; twice
the thickness from cot 2x = (cot x - tan x) / 2 and 1 / sin 2x = (cot x + tan x) / 2,

    F(2 d) = (F - A F^-1) / 2,         G(2 d) = (F + A F^-1) / 2,

one linear system a doubling: this is Newton's iteration for a square root (Higham, Functions of Matrices, chapter 6),
and in some ten doublings cheaper than the eigenvectors of A, up to a hundred unknowns or so. Nothing grows with the
thickness. What rounding does to the iteration grows with the number of doublings; it breaks G^2 = F^2 + A, which is
tested on the fields that were found. Where that fails no answer is given, and the modes are the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lapack
from scipy.special import zeta

from metafab.cell.rcwa.basis import Matrix
from metafab.cell.rcwa.eigenmodes import PlaneWaves
from metafab.core.conventions import ComplexArray

#: x cot x and x / sin x as power series in x^2 (Abramowitz and Stegun 4.3.70, 4.3.68); both converge to |x| = pi.
_ORDER = np.arange(1, 9)
_COT = np.concatenate([[1.0], -2.0 * zeta(2 * _ORDER) / np.pi ** (2 * _ORDER)])
#: Largest |x^2| of a thin slab. Eight terms are off by 2 (x^2 / pi^2)^9: 1e-6 for the most evanescent mode, whose
#: error squares with each doubling, and 1e-11 for one half as steep, 1e-16 at a quarter.
_THIN = 2.0
#: Largest violation of G^2 = F^2 + A, relative to A, that is accepted. Amplitudes were found within a hundred
#: times this of those from the modes, and mostly within ten times.
_CONSISTENT = 1e-10
#: Most unknowns for which this was measured to be faster than the modes, and the iteration to keep its accuracy.
MOST_UNKNOWNS = 120


@dataclass(frozen=True)
class Faces:
    """Field of p incident waves at the two faces of a layer.

    Attributes:
        transmitted: shape (n, p), transverse E where the layer ends.
        reflected: shape (n, p), transverse E of the reflected waves where the layer begins.
        inconsistency: what rounding left of G^2 = F^2 + A, relative to A; 0 where the modes were used.
    """

    transmitted: ComplexArray
    reflected: ComplexArray
    inconsistency: float


def through_by_doubling(
    p: Matrix, q: Matrix, thickness_k0: float, incoming: PlaneWaves, outgoing: PlaneWaves, incident: ComplexArray
) -> Faces | None:
    """Field of the waves ``incident``, or None where rounding would show.

    Args:
        p: shape (n, n), P of the layer.
        q: shape (n, n), Q of the layer.
        thickness_k0: thickness times k0.
        incoming: plane waves of the half space that the light comes from.
        outgoing: plane waves of the half space behind.
        incident: shape (n, p), transverse E of p incident waves where the layer begins.
    """
    a = p @ q
    with np.errstate(all="ignore"):  # What is not finite is refused below.
        ports = _two_port(a, thickness_k0)
        if ports is None:
            return None
        f, g = ports
        # Outgoing: (F e_out - i P h_out) w_out = G e(0). Incoming, e(0) = e_inc + e_in w: F e(0) - G e(d) = -i P h(0).
        beyond = _solve(f * outgoing.e - 1j * p * outgoing.h, g + 0j)
        if beyond is None:
            return None
        seen = f - (g * outgoing.e) @ beyond
        wave = np.divide(incident, incoming.e[:, None], out=np.zeros_like(incident), where=incident != 0.0)
        arriving = -1j * (p @ (incoming.h[:, None] * wave)) - seen @ incident
        back = _solve(seen * incoming.e - 1j * p * incoming.h, arriving)
        if back is None:
            return None
        reflected = incoming.e[:, None] * back
        near = incident + reflected
        far = outgoing.e[:, None] * (beyond @ near)
        inconsistency = max(_inconsistency(a, f, g, field) for field in (near, far))
    return Faces(far, reflected, inconsistency) if inconsistency <= _CONSISTENT else None


def _two_port(a: Matrix, thickness: float) -> tuple[Matrix, Matrix] | None:
    """F and G of the whole layer."""
    a2 = a @ a
    a3 = a2 @ a
    # ||A^k||^(1/k) bounds what the series sees of A, and is nearer to its largest eigenvalue than ||A||.
    largest = max(np.abs(a2).sum(axis=0).max() ** (1 / 2), np.abs(a3).sum(axis=0).max() ** (1 / 3))
    if not 0.0 < largest * thickness**2 < np.inf:
        return None
    doublings = max(1, int(np.ceil(0.5 * np.log2(largest * thickness**2 / _THIN))))
    thin = thickness / 2.0**doublings
    c = _COT * thin ** (2.0 * np.arange(_COT.size) - 1.0)
    diagonal = np.diag_indices(len(a))
    f = c[6] * np.eye(len(a)) + c[7] * a + c[8] * a2
    for k in (3, 0):
        f = a3 @ f + c[k + 1] * a + c[k + 2] * a2
        f[diagonal] += c[k]
    g = f
    for _ in range(doublings):
        turned = _solve(f, a)
        if turned is None:
            return None
        f, g = 0.5 * (f - turned), 0.5 * (f + turned)
    return f, g


def _inconsistency(a: Matrix, f: Matrix, g: Matrix, field: ComplexArray) -> float:
    """|G G e - F F e - A e| over |A e|; infinite where anything is not finite.

    Not over the largest term: near a half-wave thickness F and G are huge, and what they agree on drowns A.
    """
    wanted = a @ field
    left = float(np.abs(g @ (g @ field) - f @ (f @ field) - wanted).max())
    scale = float(np.abs(wanted).max())
    return left / scale if np.isfinite(left) and scale > 0.0 else np.inf


def _solve(matrix: Any, columns: Any) -> Any:
    """LAPACK itself: on small matrices the checks around it cost as much as the work. None where singular."""
    gesv = lapack.zgesv if matrix.dtype == np.complex128 else lapack.dgesv
    _, _, solution, info = gesv(matrix, columns)
    return solution if info == 0 else None
