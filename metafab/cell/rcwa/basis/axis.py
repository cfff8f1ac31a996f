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

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metafab.cell.rcwa.basis.coordinates import (
    Formulation,
    IntArray,
    axis_map,
    cosine_integrals_upto,
    shared_intervals,
)
from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class AxisBasis:
    """Basis of one axis.

    Attributes:
        wavenumber: shape (M,), rad/nm, ascending and positive.
        even: shape (M + 1, M + 1), the pillar's indicator between even functions; the constant comes first.
        odd: shape (M, M), the pillar's indicator between odd functions.
    """

    wavenumber: FloatArray
    even: FloatArray
    odd: FloatArray


@dataclass(frozen=True)
class AxisParity:
    """The two families of functions along an axis that the fields of one symmetry class need.

    A field component uses family ``a`` or ``b``. The derivative takes a function of one family to the function of the
    other with equal label, times i ``wavenumber[label]``. (Odd functions are i sin, so that this holds for all.)
    Label 0 is the zero order.

    Attributes:
        a: shape (n_a, n_a), the pillar's indicator in family a.
        b: shape (n_b, n_b), the pillar's indicator in family b.
        label_a: shape (n_a,), labels in family a.
        label_b: shape (n_b,), labels in family b.
        wavenumber: shape (labels,), rad/nm.
    """

    a: FloatArray
    b: FloatArray
    label_a: IntArray
    label_b: IntArray
    wavenumber: FloatArray


@lru_cache(maxsize=1024)
def axis_basis(period_nm: float, size_nm: float, orders: int, formulation: Formulation) -> AxisBasis:
    """The basis of one axis with ``orders`` = M cosines besides the constant."""
    to_u = axis_map(period_nm, size_nm, orders, formulation)
    pillar, whole = to_u.cosine_integrals(2 * orders + 1)
    return _bases_over(period_nm, whole, [pillar], orders)[0]


def outline_bases(
    period_nm: float, sizes_nm: tuple[float, ...], orders: int, formulation: Formulation
) -> tuple[AxisBasis, ...]:
    """One basis of an axis over a shared map, with the overlaps of each outline.

    Args:
        period_nm: period along the axis.
        sizes_nm: size of each outline along the axis, 0 to the period; equal sizes share one basis.
        orders: M cosines besides the constant.
        formulation: whether x(u) gathers resolution at the walls.
    """
    distinct = tuple(sorted(set(sizes_nm)))
    if len(distinct) == 1:
        return (axis_basis(period_nm, distinct[0], orders, formulation),) * len(sizes_nm)
    shared = _shared_bases(period_nm, distinct, orders, formulation)
    return tuple(shared[distinct.index(size)] for size in sizes_nm)


@lru_cache(maxsize=256)
def _shared_bases(
    period_nm: float, sizes_nm: tuple[float, ...], orders: int, formulation: Formulation
) -> tuple[AxisBasis, ...]:
    fills = [size / period_nm for size in sizes_nm]
    intervals = shared_intervals(period_nm, fills, orders, formulation)
    k = np.arange(2 * orders + 1)
    whole = cosine_integrals_upto(intervals, k, 1.0)
    outlines = [cosine_integrals_upto(intervals, k, fill) for fill in fills]
    return tuple(_bases_over(period_nm, whole, outlines, orders))


def _bases_over(period_nm: float, whole: FloatArray, outlines: Iterable[FloatArray], orders: int) -> list[AxisBasis]:
    """Bases of several outlines over one map, from cosine integrals (2 M + 1,) of the period and of each outline."""
    wavenumber, even, odd = _plane_waves(period_nm, whole, orders)
    return [
        AxisBasis(wavenumber, _symmetric(even.T @ _even(o, orders) @ even), _symmetric(odd.T @ _odd(o, orders) @ odd))
        for o in outlines
    ]


def axis_tangent(period_nm: float, size_nm: float, orders: int, formulation: Formulation) -> AxisBasis:
    """Derivative of :func:`axis_basis` with respect to ``size_nm``, field by field, 1/nm.

    The basis functions rotate among each other as the map follows the pillar: perturbation theory of the definite pair
    (D F_odd^-1 D^T, F_even) and of its odd partner, whose eigenvalues are equal to its own and all distinct.
    """
    to_u = axis_map(period_nm, size_nm, orders, formulation)
    count = 2 * orders + 1
    (pillar, whole), (d_pillar, d_whole) = to_u.cosine_integrals(count), to_u.cosine_integral_tangents(count)
    wavenumber, even, odd = _plane_waves(period_nm, whole, orders)
    metric_even, metric_odd = even.T @ _even(d_whole, orders) @ even, odd.T @ _odd(d_whole, orders) @ odd
    k = np.concatenate([[0.0], wavenumber])
    lifted = np.zeros_like(metric_even)
    lifted[1:, 1:] = metric_odd
    tangents = []
    for vectors, weight, metric, partner, waves in (
        (even, _even, metric_even, lifted, k),
        (odd, _odd, metric_odd, metric_even[1:, 1:], wavenumber),
    ):
        gap = waves**2 - waves[:, None] ** 2
        np.fill_diagonal(gap, 1.0)
        turn = -(waves[:, None] * partner * waves + metric * waves**2) / gap
        np.fill_diagonal(turn, -0.5 * np.diag(metric))
        carried = vectors.T @ weight(pillar, orders) @ vectors @ turn
        tangents.append(vectors.T @ weight(d_pillar, orders) @ vectors + carried + carried.T)
    d_wavenumber = -0.5 * wavenumber * (np.diag(metric_odd) + np.diag(metric_even)[1:])
    return AxisBasis(d_wavenumber, tangents[0], tangents[1])


def _plane_waves(period_nm: float, whole: FloatArray, orders: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Wave numbers of the empty cell, and its even and odd functions as columns over the harmonics."""
    # The inverse instead of SciPy's triangular solver: on matrices this small each call is the cost.
    to_even, to_odd = (np.linalg.inv(np.linalg.cholesky(weight(whole, orders))) for weight in (_even, _odd))
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


def _even(integral: FloatArray, orders: int) -> FloatArray:
    """Matrix of a weight between 1 and sqrt(2) cos(m u), from its cosine integrals of order 0 .. 2 M."""
    apart, together = _harmonics(orders)
    matrix = integral[apart] + integral[together]
    matrix[0] /= np.sqrt(2.0)
    matrix[:, 0] /= np.sqrt(2.0)
    return np.asarray(matrix)


def _odd(integral: FloatArray, orders: int) -> FloatArray:
    """Matrix of a weight between sqrt(2) sin(m u), m = 1 .. M, from its cosine integrals of order 0 .. 2 M."""
    apart, together = _harmonics(orders)
    return np.asarray(integral[apart[1:, 1:]] - integral[together[1:, 1:]])


@lru_cache(maxsize=64)
def _harmonics(orders: int) -> tuple[IntArray, IntArray]:
    """Difference and sum of the numbers of two cosines, 0 .. ``orders``."""
    m = np.arange(orders + 1)
    return np.abs(m[:, None] - m), m[:, None] + m


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))
