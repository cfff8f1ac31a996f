"""Scattering of incident waves by one layer without its modes: admittance doubling from a thin slab.

In a layer e'' = -A e with A = P Q and z in units of 1/k0. With W^2 = A, the fields at the faces of a slab of thickness
d obey

    P h(0) = i (F e(0) - G e(d)),      P h(d) = i (G e(0) - F e(d)),      F = W cot(W d),    G = W / sin(W d),

and both matrices are functions of A, without a branch of the root. A thin slab has F from Lambert's continued fraction
of x cot x, and G of twice the thickness from cot x = (cot(x/2) - tan(x/2)) / 2. Each further doubling is one linear
system, F(2 d) = F - G F^-1 G / 2 and G(2 d) = G F^-1 G / 2. The part of an evanescent mode in G decays, and nothing
grows with the thickness.

Half the layer is enough. The sum and the difference of the fields at the two faces are the fields of a slab with a
magnetic and with an electric mirror in its middle. P and Q are symmetric, so that no further inverse is needed:

    F_half^T (h(0) - h(d)) = -i Q (e(0) + e(d)),       P (h(0) + h(d)) = i F_half (e(0) - e(d)).

With outgoing waves on either side these are two equations for two sets of amplitudes. Light from the far side is solved
in the same linear system. If rounding breaks reciprocity between the two, the caller uses mode matching.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.linalg import lapack

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.scattering.half_space import PlaneWaves
from metafab.cell.rcwa.scattering.modes import FaceFields
from metafab.core.conventions import ComplexArray

#: x cot x as a ratio of two polynomials in x^2, a row each: Lambert's continued fraction cut after nine partial
#: quotients 1, 3, .., 17. For real x the error is 1e-13 at 1.5. For x = i y the value is wrong by a factor 1 - 2 q,
#: with q = 4e-3 at y = 16, 0.06 at 32 and 0.25 at 64; each doubling squares q.
_LAMBERT = np.array(
    [[34459425.0, -16216200.0, 945945.0, -13860.0, 45.0], [34459425.0, -4729725.0, 135135.0, -990.0, 1.0]]
)
#: Largest x of a travelling mode in the thin slab.
THIN = 1.5
#: Largest accepted violation of reciprocity, as an amplitude. Amplitudes by doubling and by modes then differ by up to
#: a hundred times this.
CONSISTENT = 1e-10


def solve_by_doubling(
    p: Matrix,
    q: Matrix,
    thickness_k0: float,
    incoming: PlaneWaves,
    outgoing: PlaneWaves,
    incident: ComplexArray,
    largest_a: float = np.inf,
) -> FaceFields | None:
    """Solve one layer for the fields that the waves ``incident`` excite; None if rounding is too large.

    ``p`` and ``q`` are those of the layer, shape (n, n); ``incoming`` and ``outgoing`` plane waves of the half spaces
    that the light comes from and behind. ``incident``, shape (n, k), is the transverse E of k waves where the layer
    begins. ``largest_a`` bounds the real part of the eigenvalues of A, where a bound is known.
    """
    with np.errstate(all="ignore"):  # non-finite values fail the reciprocity test below
        half = doubled(p, q, thickness_k0, largest_a, last=1)
        if half is None:
            return None
        f, _ = half
        # Columns: the incident waves, then equal amplitudes from the far side.
        n, count = incident.shape
        near_wave = np.divide(incident, incoming.e[:, None], out=np.zeros_like(incident), where=incident != 0.0)
        near_h, far_h = incoming.h[:, None] * near_wave, outgoing.h[:, None] * incident
        far_e = outgoing.e[:, None] * incident
        sums = f.T @ np.hstack([near_h, far_h]) + 1j * (q @ np.hstack([incident, far_e]))
        differences = p @ np.hstack([near_h, -far_h]) - 1j * (f @ np.hstack([incident, -far_e]))
        # With r and w the outgoing amplitudes, near and far:
        # (F^T H - i Q E) (r, w) = sums  and  (P H + i F E) (r, -w) = differences.
        electric = [p * waves.h + (1j * waves.e) * f for waves in (incoming, outgoing)]
        magnetic = [f.T * waves.h - (1j * waves.e) * q for waves in (incoming, outgoing)]
        response = _solve(electric[1], np.hstack([electric[0], differences]))
        if response is None:
            return None
        reduced = magnetic[1] @ response
        reduced[:, :n] += magnetic[0]
        reduced[:, n:] += sums
        r = _solve(reduced[:, :n], reduced[:, n:])
        if r is None:
            return None
        e_near, e_far = incoming.e[:, None] * r, outgoing.e[:, None] * (response[:, :n] @ r - response[:, n:])
        # Lorentz reciprocity: transmission from the near to the far side, and back.
        forward, backward = e_far[:, :count].T @ far_h, near_h.T @ e_near[:, count:]
        scale = max(np.abs(near_h).max(), np.abs(far_h).max())
        inconsistency = float(np.abs(forward - backward).max() / scale)
    # The comparison fails for NaN too.
    return FaceFields(e_far[:, :count], e_near[:, :count], inconsistency) if inconsistency <= CONSISTENT else None


def slab(p: Matrix, q: Matrix, thickness_k0: float, largest_a: float = np.inf) -> tuple[Matrix, Matrix] | None:
    """P^-1 F and P^-1 G of a layer of P and Q, all of shape (n, n); both symmetric; None where a matrix is singular.

    ``largest_a`` bounds the real part of the eigenvalues of A, where one is known.
    """
    with np.errstate(all="ignore"):  # non-finite values reach the result, which the caller tests
        whole = doubled(p, q, thickness_k0, largest_a, last=0)
        both = None if whole is None else _solve(p, np.hstack(whole))
    return None if both is None else (both[:, : len(p)], both[:, len(p) :])


def doubled(p: Matrix, q: Matrix, thickness: float, largest_a: float, *, last: int) -> tuple[Matrix, Matrix] | None:
    """F and G of the layer by doubling, without the ``last`` doublings (at least one yields G); None if it fails."""
    powers = _powers(p, q)
    halvings = _halvings(powers, thickness, largest_a)
    if halvings is None:
        return None
    f, g = _thin_slab(powers, thickness / 2.0**halvings), powers[0]
    for doubling in range(halvings - last):
        g_over_f = None if f is None else _quotient(g, f)
        if f is None or g_over_f is None:
            return None
        # G F^-1 G in this order: rounding errors that do not commute would grow in another.
        g = g_over_f @ g if doubling else f + g_over_f
        g *= 0.5
        f -= g
    return None if f is None else (f, g)


def pull_back_doubled(
    p: Matrix, q: Matrix, thickness: float, largest_a: float, f_bar: Matrix, *, last: int
) -> tuple[Matrix, Matrix]:
    """Derivatives of sum(f_bar * F) by P and by Q, all of shape (n, n): the steps of :func:`doubled` in reverse.

    ``f_bar`` is the weight of each element of F, which :func:`doubled` returns with the other arguments. ValueError if
    the layer is singular.
    """
    powers = _powers(p, q)
    halvings = _halvings(powers, thickness, largest_a)
    f = None if halvings is None else _thin_slab(powers, thickness / 2.0**halvings)
    if f is None or halvings is None:
        raise ValueError("`p`, `q`: expected a layer that doubling solves, got a singular one")
    thin, g, ratios = f.copy(), powers[0], []
    for doubling in range(halvings - last):
        ratios.append(np.asarray(_quotient(g, f)))
        g = 0.5 * (ratios[-1] @ g if doubling else f + ratios[-1])
        f = f - g
    # F' = F - G', G' = G F^-1 G / 2; F and G are functions of one matrix and commute.
    g_bar = np.zeros_like(f_bar)
    for ratio in reversed(ratios[1:]):
        late = g_bar - f_bar
        turned = ratio.T @ late
        g_bar = 0.5 * (late @ ratio.T + turned)
        f_bar = f_bar - 0.5 * turned @ ratio.T
    a_bar = np.zeros_like(f_bar)
    if ratios:
        # G' = (F + A F^-1) / 2 of the thin slab.
        late = 0.5 * (g_bar - f_bar)
        over = np.asarray(_solve(thin, late.T)).T
        a_bar = over
        f_bar = f_bar + late - ratios[0].T @ over
    a_bar = a_bar + _pull_back_thin_slab(powers, thickness / 2.0**halvings, thin, f_bar)
    return np.asarray(a_bar @ q.T), np.asarray(p.T @ a_bar)


def _powers(p: Matrix, q: Matrix) -> Matrix:
    """Powers 1 to 4 of A = P Q, shape (4, n, n)."""
    _keep_freed_memory()
    powers = np.empty((4, *p.shape), dtype=np.result_type(p, q))
    np.matmul(p, q, out=powers[0])
    for k, (one, other) in enumerate(((0, 0), (1, 0), (1, 1)), start=1):
        np.matmul(powers[one], powers[other], out=powers[k])
    return powers


def _halvings(powers: Matrix, thickness: float, largest_a: float) -> int | None:
    """Number of halvings from the layer to a thin slab; None where A is not finite."""
    # ||A^4||^(1/4) bounds the eigenvalues of A more tightly than ||A||.
    largest = float(np.abs(powers[3]).sum(axis=0).max()) ** 0.25
    steepest = np.sqrt(largest) * thickness
    if not 0.0 < steepest < np.inf:
        return None
    travelling = min(steepest, np.sqrt(largest_a) * thickness)
    return max(1, int(np.ceil(max(0.5 * np.log2(steepest), np.log2(travelling / THIN)))))


@cache
def _keep_freed_memory() -> None:
    """Let the C library keep a few freed MB, which saves a fifth of the time at 100 unknowns.

    glibc keeps up to twice the largest mapped block that was ever freed. This frees such a block without touching it.
    """
    np.empty(16 << 20, dtype=np.uint8)


def _thin_slab(powers: Matrix, thickness: float) -> Matrix | None:
    """F of a thin slab from ``powers`` 1 to 4 of A, shape (4, n, n)."""
    numerator, denominator = _lambert(powers, thickness)
    return _quotient(numerator, denominator)


def _lambert(powers: Matrix, thickness: float) -> Matrix:
    """Numerator and denominator of F of a thin slab, shape (2, n, n)."""
    scaled = _lambert_coefficients(thickness)
    parts = np.tensordot(scaled[:, 1:], powers, axes=1)
    n = powers.shape[1]
    parts.reshape(2, n * n)[:, :: n + 1] += scaled[:, :1]
    return np.asarray(parts)


def _lambert_coefficients(thickness: float) -> Matrix:
    """Coefficients of the powers 0 to 4 of A in both, shape (2, 5)."""
    scaled = _LAMBERT * thickness ** (2.0 * np.arange(5))
    scaled[1] *= thickness
    return np.asarray(scaled)


def _pull_back_thin_slab(powers: Matrix, thickness: float, f: Matrix, f_bar: Matrix) -> Matrix:
    """Derivative of sum(f_bar * F) by A, with F = N D^-1 of a thin slab; shape (n, n)."""
    coefficients = _lambert_coefficients(thickness)
    n_bar = np.asarray(_solve(_lambert(powers, thickness)[1], f_bar.T)).T
    d_bar = -f.T @ n_bar
    one, two, three, four = (coefficients[0, k] * n_bar + coefficients[1, k] * d_bar for k in range(1, 5))
    a, squared = powers[0].T, powers[1].T
    two = two + four @ squared + squared @ four + three @ a
    return np.asarray(one + squared @ three + two @ a + a @ two)


def _quotient(numerator: Matrix, denominator: Matrix) -> Matrix | None:
    """``numerator`` times the inverse of ``denominator``; None where that does not exist."""
    # LAPACK takes the transpose of a row-major array without a copy.
    quotient = _solve(denominator.T, numerator.T)
    return None if quotient is None else quotient.T


def _solve(matrix: Matrix, columns: Matrix) -> Matrix | None:
    """Solve by LAPACK directly, as NumPy's checks take as long as a small system; None if singular."""
    gesv = lapack.dgesv if matrix.dtype == columns.dtype == np.float64 else lapack.zgesv
    _, _, solution, info = gesv(matrix, columns)
    return np.asarray(solution) if info == 0 else None
