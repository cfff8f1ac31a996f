"""One axis of the unit cell in a truncated basis: wave numbers, and the pillar's overlap with the basis functions.

A scalar along one axis is expanded in 1, cos(2 pi m u / U) (even) and sin(2 pi m u / U) (odd), m = 1 .. M, of the
adapted coordinate u. With F the Gram matrix of the weight dx/du and D the derivative, the second derivative in x
is the symmetric definite pair (D F_odd^-1 D^T, F_even). Its solutions are the plane waves of the empty cell in the
truncated basis; the constant is one of them exactly. Expanding in these waves instead of the harmonics makes every
uniform medium diagonal. Only two things remain of the stretched coordinate:

- ``wavenumber``  kappa_m in place of 2 pi m / U, and
- ``even``, ``odd``  the overlap <m| pillar |n> in place of the Toeplitz matrices of the indicator function.

The rest is ordinary Fourier modal theory. A one-form (E_u = dx/du E_x) is expanded in the dual basis, so that the
metric disappears from the equations (Weiss et al., Opt. Express 17, 8051, 2009).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metafab.cell.rcwa.basis.coordinates import Formulation, IntArray, cosine_integrals_upto, map_intervals
from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class AxisBasis:
    """Basis of one axis."""

    wavenumber: FloatArray  #: Shape (M,), rad/nm, ascending and positive.
    even: FloatArray  #: Shape (M + 1, M + 1), the pillar's indicator between even functions; the constant comes first.
    odd: FloatArray  #: Shape (M, M), the pillar's indicator between odd functions.


@dataclass(frozen=True)
class AxisParity:
    """The two families of functions along an axis that the fields of one symmetry class need.

    A field component uses family ``a`` or ``b``. The derivative takes a function of one family to the function of the
    other with equal label, times i ``wavenumber[label]``. (Odd functions are i sin, so that this holds for all.)
    Label 0 is the zero order.
    """

    a: FloatArray  #: Shape (n_a, n_a), the pillar's indicator in family a.
    b: FloatArray  #: Shape (n_b, n_b), the pillar's indicator in family b.
    label_a: IntArray  #: Shape (n_a,), labels in family a.
    label_b: IntArray  #: Shape (n_b,), labels in family b.
    wavenumber: FloatArray  #: Shape (labels,), rad/nm.


def outline_bases(
    period_nm: float, sizes_nm: tuple[float, ...], orders: int, formulation: Formulation
) -> tuple[AxisBasis, ...]:
    """Bases of an axis over a shared map, with the overlaps, for outlines of 0 to the period; equal sizes share one.

    ``orders`` are M cosines besides the constant; ``formulation``: whether x(u) gathers resolution at the walls.
    """
    distinct = tuple(sorted(set(sizes_nm)))
    bases = _bases(period_nm, distinct, orders, formulation)
    return tuple(bases[distinct.index(size)] for size in sizes_nm)


@lru_cache(maxsize=1024)
def _bases(
    period_nm: float, sizes_nm: tuple[float, ...], orders: int, formulation: Formulation
) -> tuple[AxisBasis, ...]:
    """Bases of outlines of distinct ascending sizes."""
    intervals = map_intervals(period_nm, sizes_nm, orders, formulation)
    k = np.arange(2 * orders + 1)
    wavenumber, even, odd = plane_waves_of_axis(period_nm, cosine_integrals_upto(intervals, k, 1.0), orders)
    bases = []
    for size in sizes_nm:
        outline = cosine_integrals_upto(intervals, k, size / period_nm)
        in_even, in_odd = even.T @ even_matrix(outline, orders) @ even, odd.T @ odd_matrix(outline, orders) @ odd
        bases.append(AxisBasis(wavenumber, 0.5 * (in_even + in_even.T), 0.5 * (in_odd + in_odd.T)))
    return tuple(bases)


def plane_waves_of_axis(period_nm: float, whole: FloatArray, orders: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Plane waves of the empty cell in the basis of M ``orders``.

    ``whole``, shape (2 M + 1,), holds the cosine integrals of dx/du over the period. Wave numbers have shape (M,),
    rad/nm; even functions (M + 1, M + 1), and odd functions (M, M), are columns over the harmonics.
    """
    # The inverse instead of SciPy's triangular solver: on matrices this small each call is the cost.
    to_even, to_odd = (np.linalg.inv(np.linalg.cholesky(weight(whole, orders))) for weight in (even_matrix, odd_matrix))
    # L_even^-1 D L_odd^-T has the wave numbers as singular values and the constant as its left null vector.
    harmonics = 2.0 * np.pi / period_nm * np.arange(1, orders + 1)
    left, wavenumber, right_t = np.linalg.svd((to_even[:, 1:] * harmonics) @ to_odd.T)
    # Singular values descend, and the null vector comes last.
    left, wavenumber, right = left[:, ::-1], wavenumber[::-1], right_t[::-1].T
    # Signs that do not depend on rounding: the constant positive, and each sine's leading harmonic.
    sign = np.sign(right[np.argmax(np.abs(right), axis=0), np.arange(orders)])
    left = left * np.concatenate([[np.sign(left[0, 0])], sign])
    return wavenumber, to_even.T @ left, to_odd.T @ (right * sign)


def symmetric_axis(basis: AxisBasis, *, even_first: bool) -> AxisParity:
    """Functions of definite parity, for light in the axis' mirror plane; family a is even if ``even_first``."""
    even_label = np.arange(basis.wavenumber.size + 1)
    odd_label = even_label[1:]
    wavenumber = np.concatenate([[0.0], basis.wavenumber])
    if even_first:
        return AxisParity(basis.even, basis.odd, even_label, odd_label, wavenumber)
    return AxisParity(basis.odd, basis.even, odd_label, even_label, wavenumber)


def travelling_axis(basis: AxisBasis, incident_per_nm: float) -> AxisParity:
    """Functions without parity, for light with wave number ``incident_per_nm`` along the axis.

    exp(i k_x x) is split off the field, not exp(i k_x u), so that the zero order stays exact in the stretched
    coordinate. The periodic rest is expanded in (cos +- i sin) / sqrt(2) with wave numbers k_x +- kappa_m. The zero
    order comes first, then the plus and the minus functions.
    """
    even = basis.even[1:, 1:]
    side = basis.even[:1, 1:] / np.sqrt(2.0)
    same, opposite = 0.5 * (even + basis.odd), 0.5 * (even - basis.odd)
    overlap = np.block([[basis.even[:1, :1], side, side], [side.T, same, opposite], [side.T, opposite, same]])
    label = np.arange(overlap.shape[0])
    wavenumber = np.concatenate([[0.0], basis.wavenumber, -basis.wavenumber]) + incident_per_nm
    return AxisParity(overlap, overlap, label, label, wavenumber)


def parities(basis: AxisBasis, incident_per_nm: float) -> list[AxisParity]:
    """All symmetry classes of an axis under light with wave number ``incident_per_nm`` along it."""
    if incident_per_nm == 0.0:
        return [symmetric_axis(basis, even_first=True), symmetric_axis(basis, even_first=False)]
    return [travelling_axis(basis, incident_per_nm)]


def even_matrix(integral: FloatArray, orders: int) -> FloatArray:
    """Matrix of a weight between 1 and sqrt(2) cos(m u), shape (M + 1, M + 1), from its integrals, shape (2 M + 1,)."""
    apart, together = _harmonics(orders)
    matrix = integral[apart] + integral[together]
    matrix[0] /= np.sqrt(2.0)
    matrix[:, 0] /= np.sqrt(2.0)
    return np.asarray(matrix)


def odd_matrix(integral: FloatArray, orders: int) -> FloatArray:
    """Matrix of a weight between sqrt(2) sin(m u), shape (M, M), from its cosine integrals, shape (2 M + 1,)."""
    apart, together = _harmonics(orders)
    return np.asarray(integral[apart[1:, 1:]] - integral[together[1:, 1:]])


@lru_cache(maxsize=64)
def _harmonics(orders: int) -> tuple[IntArray, IntArray]:
    """Difference and sum of the numbers of two cosines, 0 .. ``orders``."""
    m = np.arange(orders + 1)
    return np.abs(m[:, None] - m), m[:, None] + m
