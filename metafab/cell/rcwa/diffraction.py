"""Efficiencies of single diffraction orders, where a cell is wide enough for more than the zero order to leave.

The waves of the truncated basis correspond to orders: label m of an axis to order m (and -m, where a mirror plane gives
the two equal power). The efficiency of an order is the power along z of its TM and TE wave over that of the incident
wave. Without absorption the efficiencies of all orders on both sides add up to 1.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.axis import AxisParity
from metafab.cell.rcwa.basis.coordinates import Formulation, IntArray
from metafab.cell.rcwa.certificate import implied_bound, ladder
from metafab.cell.rcwa.convergence import convergence
from metafab.cell.rcwa.jones import solved_classes
from metafab.cell.rcwa.slicing import slicing, smooth_array
from metafab.cell.rcwa.symmetry import in_plane_per_nm
from metafab.cell.response import CellNumerics
from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import one_blas_thread

Order = tuple[int, int]
#: Order -> shape (2,), efficiency for incident x and y.
Efficiencies = dict[Order, FloatArray]


@dataclass(frozen=True)
class DiffractedOrder:
    """One order that leaves on one side."""

    #: (m, n): its wave vector in the plane is that of the incident light plus 2 pi (m / period_x, n / period_y); in a
    #: hexagonal lattice the cell is the centred one of two rows, so that period_y is two row distances.
    order: Order
    #: Angle from the axis in the medium that the order leaves into; by the index along x if it has several.
    polar_deg: float
    #: Direction of its wave vector in the plane, counter-clockwise from +x, in (-180, 180]; 0 on the axis.
    azimuth_deg: float
    efficiency_x: float  #: Its power over the incident power, for light with E along x in the plane of the cell.
    efficiency_y: float  #: Its power over the incident power, for light with E along y.


@dataclass(frozen=True)
class Diffraction:
    """All orders that leave a cell."""

    transmitted: tuple[DiffractedOrder, ...]  #: Transmitted orders, sorted by n, then m.
    reflected: tuple[DiffractedOrder, ...]  #: Reflected orders, likewise.
    error: float  #: Estimate of the largest error of any efficiency.
    converged: bool  #: Whether ``error`` is at most the target.
    truncation: int  #: Cosines along each axis, or polynomial order of spectral elements.


def diffraction(cell: PillarCell, numerics: CellNumerics = CellNumerics()) -> Diffraction:  # noqa: B008 (frozen)
    """Efficiencies of every order that leaves ``cell``, to ``numerics.target_error`` where that can be reached.

    In an absorbing half space the orders are those that propagate by the real part of its index, with the power
    at the face of the layer. Errors as :func:`metafab.cell.rcwa.jones.zero_order`.
    """
    cut = slicing(cell, numerics)
    solved: dict[int, FloatArray] = {}
    sides = [propagating_orders(cell, index) for index in (cell.n_out, cell.n_in)]
    farthest = max(abs(number) for side in sides for order in side for number in order)
    error, orders = math.inf, 0
    # The claims of the certificate were measured on amplitudes, not on efficiencies.
    rate = replace(convergence(cell), is_measured=False)
    for orders in ladder(numerics, rate):
        solved[orders] = smooth_array(cell, cut.steps, partial(_listed, cell, orders, numerics.formulation, sides))
        if len(solved) > 1 and orders >= farthest:
            changes = {count: float(np.abs(solved[orders] - solved[count]).max()) for count in sorted(solved)[:-1]}
            error = implied_bound(orders, changes, rate, numerics.formulation) + 2.0 * cut.error
            error = max(error, rate.least_error(orders))
        if error <= numerics.target_error:
            break
    count = len(sides[0])
    transmitted = diffracted(cell, sides[0], cell.n_out[0], solved[orders][:count])
    reflected = diffracted(cell, sides[1], cell.n_in[0], solved[orders][count:])
    return Diffraction(transmitted, reflected, error, error <= numerics.target_error, orders)


def diffracts(cell: PillarCell) -> bool:
    """Whether orders other than the zero order leave ``cell``, on either side."""
    return any(len(propagating_orders(cell, index)) > 1 for index in (cell.n_in, cell.n_out))


def propagating_orders(cell: PillarCell, index: tuple[complex, complex]) -> tuple[Order, ...]:
    """Orders (m, n) that propagate in a half space with ``index`` for x and y polarisation; sorted by n, then m."""
    reach = max(complex(n).real for n in index) / cell.wavelength_nm
    start = np.array(in_plane_per_nm(cell)) / (2.0 * math.pi)
    # The centred cell of a hexagonal lattice is two rows long, and every other of its orders is dark.
    every = 2 if cell.is_staggered else 1
    length_x, length_y = cell.period_nm[0], every * cell.period_nm[1]
    most = [math.ceil((reach + abs(at)) * length) for at, length in zip(start, (length_x, length_y), strict=True)]
    return tuple(
        (m, n)
        for n in range(-most[1], most[1] + 1)
        for m in range(-most[0], most[0] + 1)
        if (m + n) % every == 0 and math.hypot(start[0] + m / length_x, start[1] + n / length_y) < reach
    )


def efficiencies(
    cell: PillarCell, orders: int, formulation: Formulation = "adaptive", steps: int = 1
) -> tuple[Efficiencies, Efficiencies]:
    """Transmitted and reflected efficiencies of every order of the basis at one truncation; 0 for evanescent orders.

    Returns:
        Two dictionaries from orders to arrays of shape (2,), for incident x and y.
    """
    sides: tuple[Efficiencies, Efficiencies] = (defaultdict(lambda: np.zeros(2)), defaultdict(lambda: np.zeros(2)))
    with one_blas_thread():
        for solved in solved_classes(cell, orders, formulation, steps):
            u, v = solved.case.basis.u, solved.case.basis.v
            both = [(m, n) for m in _orders(u, u.label_a) for n in _orders(v, v.label_a)]
            both += [(m, n) for m in _orders(u, u.label_b) for n in _orders(v, v.label_b)]
            for side, powers in zip(sides, solved.shares_of_power(), strict=True):
                for (all_m, all_n), power in zip(both, powers, strict=True):
                    for m in all_m:
                        for n in all_n:
                            side[m, n] = side[m, n] + power / (len(all_m) * len(all_n))
    return dict(sides[0]), dict(sides[1])


def _listed(
    cell: PillarCell, orders: int, formulation: Formulation, sides: Sequence[Sequence[Order]], steps: int
) -> FloatArray:
    """Efficiencies of all orders of both ``sides``, shape (n_orders, 2); 0 for orders outside the basis."""
    powers = efficiencies(cell, orders, formulation, steps)
    return np.array([power.get(order, (0.0, 0.0)) for power, side in zip(powers, sides, strict=True) for order in side])


def _orders(axis: AxisParity, labels: IntArray) -> list[tuple[int, ...]]:
    """Orders of each function of a family: one if it travels, two of equal power if it has a parity."""
    count = (axis.wavenumber.size - 1) // 2
    if axis.label_a.size == axis.label_b.size:
        return [(int(label),) if label <= count else (int(count - label),) for label in labels]
    return [(int(label), -int(label)) if label else (0,) for label in labels]


def diffracted(
    cell: PillarCell, side: Sequence[Order], index: complex, efficiency: FloatArray
) -> tuple[DiffractedOrder, ...]:
    """Return the orders of one side, which leave into a medium of ``index``, with efficiencies (n_orders, 2)."""
    return tuple(
        DiffractedOrder(order, *_direction(cell, order, index), float(of_x), float(of_y))
        for order, (of_x, of_y) in zip(side, efficiency, strict=True)
    )


def _direction(cell: PillarCell, order: Order, index: complex) -> tuple[float, float]:
    """Polar angle and azimuth of an order in a medium of ``index``, degrees."""
    start_x, start_y = in_plane_per_nm(cell)
    k_x = start_x + 2.0 * math.pi * order[0] / cell.period_nm[0]
    length_y = cell.period_nm[1] * (2 if cell.is_staggered else 1)
    k_y = start_y + 2.0 * math.pi * order[1] / length_y
    across = math.hypot(k_x, k_y) * cell.wavelength_nm / (2.0 * math.pi * complex(index).real)
    return math.degrees(math.asin(min(across, 1.0))), math.degrees(math.atan2(k_y, k_x)) if across else 0.0
