"""Derivative of the basis of one axis by the size of its outline.

The basis functions rotate among each other as the map follows the pillar: perturbation theory of the definite pair
(D F_odd^-1 D^T, F_even) and of its odd partner, whose eigenvalues are equal to its own and all distinct.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from metafab.cell.rcwa.basis.axis import (
    AxisBasis,
    AxisParity,
    even_matrix,
    odd_matrix,
    plane_waves_of_axis,
    symmetric_axis,
    travelling_axis,
)
from metafab.cell.rcwa.basis.coordinates import Formulation, Interval, WallMap, stretched
from metafab.core.conventions import FloatArray


@lru_cache(maxsize=1024)
def outline_tangent(period_nm: float, size_nm: float, orders: int, formulation: Formulation) -> AxisBasis:
    """Derivative of :func:`metafab.cell.rcwa.basis.axis.outline_bases` of one outline by its size, 1/nm."""
    (pillar, whole), (d_pillar, d_whole) = _cosine_integrals(period_nm, size_nm, orders, formulation)
    wavenumber, even, odd = plane_waves_of_axis(period_nm, whole, orders)
    metric_even, metric_odd = even.T @ even_matrix(d_whole, orders) @ even, odd.T @ odd_matrix(d_whole, orders) @ odd
    k = np.concatenate([[0.0], wavenumber])
    lifted = np.zeros_like(metric_even)
    lifted[1:, 1:] = metric_odd
    tangents = []
    for vectors, weight, metric, partner, waves in (
        (even, even_matrix, metric_even, lifted, k),
        (odd, odd_matrix, metric_odd, metric_even[1:, 1:], wavenumber),
    ):
        gap = waves**2 - waves[:, None] ** 2
        np.fill_diagonal(gap, 1.0)
        turn = -(waves[:, None] * partner * waves + metric * waves**2) / gap
        np.fill_diagonal(turn, -0.5 * np.diag(metric))
        carried = vectors.T @ weight(pillar, orders) @ vectors @ turn
        tangents.append(vectors.T @ weight(d_pillar, orders) @ vectors + carried + carried.T)
    d_wavenumber = -0.5 * wavenumber * (np.diag(metric_odd) + np.diag(metric_even)[1:])
    return AxisBasis(d_wavenumber, tangents[0], tangents[1])


def _cosine_integrals(
    period_nm: float, size_nm: float, orders: int, formulation: Formulation
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Cosine integrals over the pillar and the period, and their derivatives by the size, by a complex step.

    The closed forms are analytic in the fill and the wall, so that nothing cancels.
    """
    fill, step = size_nm / period_nm, 1e-30
    wall_map, per_fill = WallMap(fill, 1.0, 1.0), 1.0
    if formulation == "adaptive":
        wall_map = stretched(period_nm, size_nm, orders)
        # The wall's place is linear in the fill.
        low, high = (stretched(1.0, share, orders).wall_fraction for share in (0.25, 0.75))
        per_fill = (high - low) / 0.5
    fill_step, wall_step = fill + 1j * step, wall_map.wall_fraction + 1j * step * per_fill
    k = np.arange(2 * orders + 1)
    pillar = Interval(0.0, wall_step, fill_step, 1.0 - wall_map.slope_inside).cosine_integral(k)  # type: ignore[arg-type]
    outside = Interval(wall_step, 1.0, 1.0 - fill_step, wall_map.slope_outside - 1.0)  # type: ignore[arg-type]
    whole = pillar + outside.cosine_integral(k)
    values = np.asarray(pillar.real), np.asarray(whole.real)
    return values, (pillar.imag / (step * period_nm), whole.imag / (step * period_nm))


def like(axis: AxisParity, tangent: AxisBasis) -> AxisParity:
    """Return ``tangent`` in the families of ``axis``; the incident wave number of a travelling wave does not change."""
    if axis.label_a.size == axis.label_b.size:
        return travelling_axis(tangent, 0.0)
    return symmetric_axis(tangent, even_first=bool(axis.label_a[0] == 0))
