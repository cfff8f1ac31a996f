"""Scattering of incident waves by one layer without its modes: admittance doubling from a thin slab.

In a layer e'' = -A e with A = P Q and z in units of 1/k0. With W^2 = A, the fields at the faces of a slab of thickness
d obey

    P h(0) = i (F e(0) - G e(d)),      P h(d) = i (G e(0) - F e(d)),      F = W cot(W d),    G = W / sin(W d),

and both matrices are functions of A, without a branch of the root. A thin slab has F from a rational function for
x cot x, and G of twice the thickness from cot x = (cot(x/2) - tan(x/2)) / 2. Each further doubling is one linear
system, F(2 d) = F - G F^-1 G / 2 and G(2 d) = G F^-1 G / 2. The part of an evanescent mode in G decays, and nothing
grows with the thickness.

Half the layer is enough. The sum and the difference of the fields at the two faces are the fields of a slab with a
magnetic and with an electric mirror in its middle. P and Q are symmetric, so that no further inverse is needed:

    F_half^T (h(0) - h(d)) = -i Q (e(0) + e(d)),       P (h(0) + h(d)) = i F_half (e(0) - e(d)).

With outgoing waves on either side these are two equations for two sets of amplitudes. Light from the far side is solved
in the same linear system. If rounding breaks reciprocity between the two, the caller uses mode matching.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.scattering.faces import amplitudes, lossless_amplitudes, solved
from metafab.cell.rcwa.scattering.half_space import PlaneWaves
from metafab.cell.rcwa.scattering.modes import FaceFields
from metafab.core.conventions import ComplexArray

#: x cot x as a ratio of two polynomials in x^2, a row each: equal to it at x = 1.7, 1.95, 2.1 and 2.2, and in five
#: terms of the series at 0. Up to x = 2.2 the phase of a mode is off by 2e-14 at most; Lambert's continued fraction,
#: equal in nine terms, is off by 9e-11 there. For x = i y the value is wrong by a factor 1 - 2 q, with q = 5e-8 at
#: y = 4, 9e-4 at 12, 0.04 at 28 and 0.2 at 64; each doubling squares q.
_COTANGENT = np.array(
    [
        [32786393.311864022, -15435253.015907574, 902956.3225197974, -13335.988004896979, 44.15515006480016],
        [32786393.311864022, -4506455.245286234, 129391.09213247562, -959.8816615668621, 1.0],
    ]
)
#: Largest x of a travelling mode in the thin slab.
THIN = 2.2
#: Largest y of an evanescent mode in the thin slab of up to four halvings: rounding grows as its eighth power.
_STEEP = 28.0
#: Largest accepted violation of reciprocity, as an amplitude. Amplitudes by doubling and by modes then differ by up to
#: a hundred times this.
CONSISTENT = 1e-10


@dataclass(frozen=True)
class DoublingSteps:
    """Steps of a doubling, for derivatives in reverse mode."""

    powers: Matrix  #: Shape (4, n, n), powers 1 to 4 of A = P Q.
    thin_k0: float  #: Thickness of the thin slab times k0.
    thin: Matrix  #: Shape (n, n), F of the thin slab.
    ratios: tuple[Matrix, ...]  #: G F^-1 before each doubling, shape (n, n) each.
    #: LU factors of the transposes of the thin slab's denominator and of its F.
    factors: tuple[tuple[Matrix, Matrix], ...]


@dataclass(frozen=True)
class Doubling:
    """F and G of a layer."""

    f: Matrix  #: Shape (n, n).
    g: Matrix  #: Shape (n, n).
    steps: DoublingSteps | None  #: Where they are kept.


@dataclass(frozen=True)
class LitLayer:
    """Fields that waves from either side excite at the faces of one layer, n coefficients and p waves."""

    faces: FaceFields  #: Light from the near side.
    from_far: FaceFields  #: Light from the far side with the transverse E of ``far_incident``.
    far_incident: ComplexArray  #: Shape (n, p).
    p: Matrix  #: Shape (n, n), P of the layer.
    q: Matrix  #: Shape (n, n), Q of the layer.
    half: Doubling  #: F and G of half the layer.


def solve_by_doubling(
    p: Matrix,
    q: Matrix,
    thickness_k0: float,
    incoming: PlaneWaves,
    outgoing: PlaneWaves,
    incident: ComplexArray,
    largest_a: float = np.inf,
    *,
    keep: bool = False,
) -> LitLayer | None:
    """Solve one layer for the fields that the waves ``incident`` excite; None if rounding is too large.

    ``p`` and ``q`` are those of the layer, shape (n, n); ``incoming`` and ``outgoing`` plane waves of the half spaces
    before and behind it. ``incident``, shape (n, k), is the transverse E of k waves at the near face. ``largest_a``
    bounds the real part of the eigenvalues of A, where a bound is known. The steps of the doubling are kept for
    :func:`metafab.cell.rcwa.scattering.reverse.pull_back_doubled` if ``keep`` is true.
    """
    with np.errstate(all="ignore"):  # non-finite values fail the reciprocity test below
        half = doubled(p, q, thickness_k0, largest_a, omitted=1, keep=keep)
        if half is None:
            return None
        f = half.f
        # Columns: the incident waves, then equal amplitudes from the far side.
        count = incident.shape[1]
        near_wave = np.divide(incident, incoming.e[:, None], out=np.zeros_like(incident), where=incident != 0.0)
        near_h, far_h = incoming.h[:, None] * near_wave, outgoing.h[:, None] * incident
        far_e = outgoing.e[:, None] * incident
        sums = f.T @ np.hstack([near_h, far_h]) + 1j * (q @ np.hstack([incident, far_e]))
        differences = p @ np.hstack([near_h, -far_h]) - 1j * (f @ np.hstack([incident, -far_e]))
        for leaving in (lossless_amplitudes, amplitudes):
            left = leaving(p, q, f, (incoming, outgoing), sums, differences)
            if left is None:
                continue
            e_near, e_far = (side.e[:, None] * w for side, w in zip((incoming, outgoing), left, strict=True))
            # Lorentz reciprocity: transmission from the near to the far side, and back.
            forward, backward = e_far[:, :count].T @ far_h, near_h.T @ e_near[:, count:]
            scale = max(np.abs(near_h).max(), np.abs(far_h).max())
            inconsistency = float(np.abs(forward - backward).max() / scale)
            if inconsistency <= CONSISTENT:  # NaN fails it too
                break
        else:
            return None
    faces = FaceFields(e_far[:, :count], e_near[:, :count], inconsistency)
    return LitLayer(faces, FaceFields(e_near[:, count:], e_far[:, count:], inconsistency), far_e, p, q, half)


def slab(p: Matrix, q: Matrix, thickness_k0: float, largest_a: float = np.inf) -> tuple[Matrix, Matrix] | None:
    """P^-1 F and P^-1 G of a layer of P and Q, all of shape (n, n); both symmetric; None where a matrix is singular.

    ``largest_a`` bounds the real part of the eigenvalues of A, where one is known.
    """
    with np.errstate(all="ignore"):  # non-finite values reach the result, which the caller tests
        whole = doubled(p, q, thickness_k0, largest_a, omitted=0)
        both = None if whole is None else solved(p, np.hstack([whole.f, whole.g]))
    return None if both is None else (both[:, : len(p)], both[:, len(p) :])


def doubled(
    p: Matrix, q: Matrix, thickness_k0: float, largest_a: float, *, omitted: int, keep: bool = False
) -> Doubling | None:
    """F and G of a layer without its last ``omitted`` doublings: of half of it for 1. None if a matrix is singular."""
    powers = _powers(p, q)
    halvings = _halvings(powers, thickness_k0, largest_a)
    if halvings is None:
        return None
    thin_k0 = thickness_k0 / 2.0**halvings
    ratios: list[Matrix] = []
    factors: list[tuple[Matrix, Matrix]] | None = [] if keep else None
    numerator, denominator = cotangent(powers, thin_k0)
    f, g = _quotient(numerator, denominator, factors), powers[0]
    thin = f
    # The first doubling has A in place of G: G of the thin slab is not known.
    for doubling in range(halvings - omitted):
        ratio = None if f is None else _quotient(g, f, None if doubling else factors)
        if f is None or ratio is None:
            return None
        # G F^-1 G in this order: rounding errors that do not commute would grow in another.
        g = ratio @ g if doubling else f + ratio
        g *= 0.5
        f = f - g
        if keep:
            ratios.append(ratio)
    if f is None or thin is None:
        return None
    steps = None if factors is None else DoublingSteps(powers, thin_k0, thin, tuple(ratios), tuple(factors))
    return Doubling(f, g, steps)


def _powers(p: Matrix, q: Matrix) -> Matrix:
    """Powers 1 to 4 of A = P Q, shape (4, n, n)."""
    _keep_freed_memory()
    powers = np.empty((4, *p.shape), dtype=np.result_type(p, q))
    np.matmul(p, q, out=powers[0])
    for k, (one, other) in enumerate(((0, 0), (1, 0), (1, 1)), start=1):
        np.matmul(powers[one], powers[other], out=powers[k])
    return powers


def _halvings(powers: Matrix, thickness_k0: float, largest_a: float) -> int | None:
    """Number of halvings from the layer to a thin slab; None where A is not finite."""
    # ||A^4||^(1/4) bounds the eigenvalues of A more tightly than ||A||.
    largest = float(np.abs(powers[3]).sum(axis=0).max()) ** 0.25
    steepest = np.sqrt(largest) * thickness_k0
    if not 0.0 < steepest < np.inf:
        return None
    travelling = min(steepest, np.sqrt(largest_a) * thickness_k0)
    halvings = 1
    while travelling > THIN * 2**halvings or steepest > _steep(halvings) * 2**halvings:
        halvings += 1
    return halvings


def _steep(halvings: int) -> float:
    """Largest y of an evanescent mode in the thin slab, so that F of half the layer is off by 4e-6 of it at most."""
    return float(max(2**halvings, min(_STEEP, 4 * (2**halvings - 1))))


@cache
def _keep_freed_memory() -> None:
    """Let the C library keep a few freed MB, which saves a fifth of the time at 100 unknowns.

    glibc keeps up to twice the largest mapped block that was ever freed. This frees such a block without touching it.
    """
    np.empty(16 << 20, dtype=np.uint8)


def cotangent(powers: Matrix, thickness_k0: float) -> Matrix:
    """Numerator and denominator of F of a thin slab, shape (2, n, n), from ``powers`` 1 to 4 of A, shape (4, n, n)."""
    scaled, n = cotangent_terms(thickness_k0), powers.shape[1]
    # Real and imaginary parts as columns of a real product: the coefficients are real.
    parts = (scaled[:, 1:] @ powers.reshape(4, n * n).view(np.float64)).view(powers.dtype)
    parts[:, :: n + 1] += scaled[:, :1]
    return np.asarray(parts.reshape(2, n, n))


def cotangent_terms(thickness_k0: float) -> Matrix:
    """Coefficients of the powers 0 to 4 of A in numerator and denominator, shape (2, 5)."""
    scaled = _COTANGENT * thickness_k0 ** (2.0 * np.arange(5))
    scaled[1] *= thickness_k0
    return np.asarray(scaled)


def _quotient(
    numerator: Matrix, denominator: Matrix, factors: list[tuple[Matrix, Matrix]] | None = None
) -> Matrix | None:
    """``numerator`` times the inverse of ``denominator``; None where that does not exist."""
    # LAPACK takes the transpose of a row-major array without a copy.
    quotient = solved(denominator.T, numerator.T, factors)
    return None if quotient is None else quotient.T
