"""Truncation raised until the error is what was asked, and the bound on that error.

The truncations form a ladder. How much nearer to the truth a rung is than an earlier one was measured on 96 pillars of
four materials, resonances among them, against references of 13 to 15 orders (benchmarks/cell.py repeats it for
silicon); with d(M, k) the largest difference of any amplitude between M and k orders,

    error(M) <= max( floor(M), max over k of share(M, k) d(M, k) ).

Differences see what is special about a pillar (a sharp resonance that the truncation shifts); the floor is what two
truncations can agree on by accident. A last difference so large that the ladder has not begun to converge counts in
full. Where the permittivity changes its sign (metals) the field at the corners has no limit that Fourier methods
approach steadily; there every difference counts threefold.
The largest error over bound found is 0.71; tests/physics/test_rcwa_certificate.py also looks far from these pillars.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis import Formulation
from metafab.cell.rcwa.jones import ZeroOrder, axis_orders, zero_order
from metafab.cell.response import CellNumerics, CellResponse, PillarCell
from metafab.core.errors import SolverError


@dataclass(frozen=True)
class Rung:
    """One truncation of the ladder.

    Attributes:
        orders: cosines along the longer period.
        floor: least bound that is ever given here.
        shares: (earlier orders, share of the difference to them that bounds the error), the nearest first.
    """

    orders: int
    floor: float
    shares: tuple[tuple[int, float], ...]


_LADDERS: dict[Formulation, tuple[Rung, ...]] = {
    "adaptive": (
        Rung(3, np.inf, ()),
        Rung(5, 6e-4, ((3, 0.4),)),
        Rung(6, 3e-4, ((5, 1.2), (3, 0.1))),
        Rung(7, 1.2e-4, ((6, 1.0), (5, 0.4))),
        Rung(8, 8e-5, ((7, 1.0), (6, 0.4), (5, 0.15))),
        Rung(9, 6e-5, ((8, 1.0), (7, 0.4))),
        Rung(10, 5e-5, ((9, 1.0), (8, 1.0))),
        Rung(12, 3.5e-5, ((10, 1.0), (9, 1.0))),
        Rung(14, 2e-5, ((12, 1.5), (10, 1.0))),
        Rung(16, 1.2e-5, ((14, 1.5), (12, 1.0))),
    ),
    # Plain harmonics converge algebraically: half the orders are at least twice as far from the truth.
    "fourier": (
        Rung(3, np.inf, ()),
        Rung(4, np.inf, ()),
        Rung(6, 5e-2, ((3, 1.5), (4, 1.5))),
        Rung(8, 2e-2, ((4, 1.5), (6, 1.5))),
        Rung(12, 1e-2, ((6, 1.5), (8, 1.5))),
        Rung(16, 5e-3, ((8, 1.5), (12, 1.5))),
        Rung(24, 2e-3, ((12, 1.5), (16, 1.5))),
    ),
}
#: Last differences above this are those of a ladder that has not begun to converge.
_NOT_CONVERGING = 5e-2
#: What a difference counts where the permittivity changes its sign.
_UNSTEADY = 3.0
#: Tighter targets than this leave out the rung of six orders, which could not meet them.
_TIGHT = 2e-4


def solve(cell: PillarCell, numerics: CellNumerics = CellNumerics()) -> CellResponse:  # noqa: B008 (frozen)
    """Jones matrices of ``cell``, with a bound on their error that is at most the target where it converged.

    The truncation is raised up to ``numerics.max_orders``. If the target is not met there, the best solution comes
    back with ``converged`` false and the error that it has.

    Raises:
        InputError: see :func:`metafab.cell.rcwa.jones.zero_order`.
        SolverError: an amplitude is not a finite number.
    """
    started = time.perf_counter()
    solved: dict[int, ZeroOrder] = {}
    error, orders = np.inf, 0
    for rung in _LADDERS[numerics.formulation]:
        if (rung.orders > numerics.max_orders and solved) or _is_idle(rung, numerics):
            continue
        orders = rung.orders
        solved[orders] = zero_order(cell, orders, numerics.formulation)
        error = bound(rung, solved, steady=not _is_metal(cell))
        if error <= numerics.target_error:
            break
    last = solved[orders]
    if not (np.isfinite(last.t).all() and np.isfinite(last.r).all()):
        raise SolverError(f"rcwa gave no finite amplitudes with {orders} orders for {cell}")
    x, y = axis_orders(cell, orders)
    return CellResponse(
        cell=cell,
        numerics=numerics,
        t=last.t,
        r=last.r,
        error=float(error),
        converged=bool(error <= numerics.target_error),
        resolution=(2 * x + 1) * (2 * y + 1),
        seconds=time.perf_counter() - started,
        details={
            "formulation": numerics.formulation,
            "orders_x": x,
            "orders_y": y,
            "coefficients": last.coefficients,
            "truncations": len(solved),
            "transmitted_power_x": float(last.transmitted_power[0]),
            "transmitted_power_y": float(last.transmitted_power[1]),
            "reflected_power_x": float(last.reflected_power[0]),
            "reflected_power_y": float(last.reflected_power[1]),
        },
    )


def bound(rung: Rung, solved: dict[int, ZeroOrder], *, steady: bool = True) -> float:
    """Bound on the error of ``solved[rung.orders]`` from the earlier solutions; infinite where there are none.

    ``steady`` tells whether the permittivity keeps its sign, so that the measured shares apply.
    """
    parts = [
        (distance(solved[rung.orders], solved[earlier]), share) for earlier, share in rung.shares if earlier in solved
    ]
    if not parts:
        return float("inf")
    if not steady:
        return max(rung.floor, *(_UNSTEADY * difference for difference, _ in parts))
    if parts[0][0] > _NOT_CONVERGING:
        return parts[0][0]
    return max(rung.floor, *(share * difference for difference, share in parts))


def distance(one: ZeroOrder, other: ZeroOrder) -> float:
    """Largest absolute difference of any amplitude."""
    return float(max(np.abs(one.t - other.t).max(), np.abs(one.r - other.r).max()))


def _is_metal(cell: PillarCell) -> bool:
    return (complex(cell.n_pillar) ** 2).real * (complex(cell.n_ambient) ** 2).real < 0.0


def _is_idle(rung: Rung, numerics: CellNumerics) -> bool:
    return numerics.formulation == "adaptive" and rung.orders == 6 and numerics.target_error < _TIGHT
