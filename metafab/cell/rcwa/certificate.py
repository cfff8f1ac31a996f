"""Truncation raised until the error is what was asked, and the estimate of that error."""

from __future__ import annotations

import time

import numpy as np

from metafab.cell.rcwa.jones import ZeroOrder, axis_orders, zero_order
from metafab.cell.response import CellNumerics, CellResponse, PillarCell

#: The estimate is this many times the largest change over the last two steps of the sequence.
_SAFETY = 2.0
_FIRST_ORDERS = 3


def solve(cell: PillarCell, numerics: CellNumerics = CellNumerics()) -> CellResponse:  # noqa: B008 (frozen)
    """Jones matrices of ``cell``, with an estimate of their error that is at most the target where it converged.

    The truncation is raised order by order up to ``numerics.max_orders``. If the target is not met there, the best
    solution comes back with ``converged`` false and the error that it has.

    Raises:
        InputError: see :func:`metafab.cell.rcwa.jones.zero_order`.
    """
    started = time.perf_counter()
    sequence: list[ZeroOrder] = []
    error, orders = np.inf, 0
    for orders in range(min(_FIRST_ORDERS, numerics.max_orders), numerics.max_orders + 1):
        sequence.append(zero_order(cell, orders, numerics.formulation))
        error = _estimate(sequence)
        if error <= numerics.target_error:
            break
    last = sequence[-1]
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
            "truncations": len(sequence),
        },
    )


def _estimate(sequence: list[ZeroOrder]) -> float:
    """Bound on the error of the last solution, from how far the last three lie apart."""
    if len(sequence) < 3:
        return float("inf")
    last = sequence[-1]
    return _SAFETY * max(distance(last, earlier) for earlier in sequence[-3:-1])


def distance(one: ZeroOrder, other: ZeroOrder) -> float:
    """Largest absolute difference of any amplitude."""
    return float(max(np.abs(one.t - other.t).max(), np.abs(one.r - other.r).max()))
