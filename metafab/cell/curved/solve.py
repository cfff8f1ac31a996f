"""Adaptive polynomial order: it rises until a bound on the error is below the target.

The error has two parts. That of unresolved waves falls exponentially with the order p; that of the singular field at
the rims of the pillar falls as p^-4. Where the two are about equal, they may cancel in a change. With d(p) the largest
change of any amplitude from p - 1 to p, the bound is

    error(p) <= max(floor(p), share(p) d(p), before d(p - 1)),

the last term for ellipses alone, whose elements are the largest, and at least 1 where d exceeds 0.1: the orders have
not begun to converge. Order 5 of a rounded rectangle of low index may take a multiple of d(p)^2 / d(p - 1) instead: the
next change of a geometric series.

Floors and shares were measured on random ellipses and hexagonal lattices of eight materials, resonances among them,
against references of order 9. Rounded rectangles and rings have more and smaller elements, so that a lower order
serves them; they were measured against order 6 and 8. The order of a rounded rectangle is that of the gap; those of
its other elements follow from it (:mod:`metafab.cell.curved.mesh`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.curved.layers import order_efficiencies, zero_order
from metafab.cell.curved.mesh import quarter_mesh
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.diffraction import Diffraction, diffracted, propagating_orders
from metafab.cell.rcwa.jones import ZeroOrder, distance
from metafab.cell.response import CellNumerics, CellResponse, SolverDetails
from metafab.core.errors import SolverError

#: Polynomial order -> (floor, share) of the bound. The change from order 3 to 4 proves little alone: beside a resonance
#: the error of order 4 was 0.99 of it, and in an ellipse of 460 x 38 nm 2.4e-3 at a change of 6e-4. An error of p^-4 is
#: 1.2, 1.4 and 1.7 of the last change at orders 7, 8 and 9.
_CLAIMS = {4: (4e-3, 2.0), 5: (5e-4, 2.0), 6: (2e-4, 2.0), 7: (1e-4, 2.0), 8: (6e-5, 2.4), 9: (4e-5, 2.8)}
#: Largest index in a cell of low index, where the field at the rims is less singular.
_LOW_INDEX = 3.0
#: Share of the change before the last that bounds the error of an ellipse from order 5 on, in cells of high and of low
#: index. Beside a resonance at an index of 3.3 the changes to orders 4, 5 and 6 were 0.029, 6e-4 and 7e-4, and order 5
#: was off by 1.3e-3. In 34 ellipses, 32 random, where the last change was less than a twentieth of the one before,
#: errors were at most 0.043 (high index) and 0.014 (low) of the one before.
_BEFORE, _BEFORE_LOW = 0.1, 0.03
#: Claims of rounded rectangles, whose elements differ in order. On 40 random ones, resonances among them, the error of
#: order 4 was at most 0.26 of a change from order 3 above 1e-3; that of order 5 at most 0.3 of a change above 4e-4, but
#: 0.73 of it in a pillar of index 4.1.
_CLAIMS_ROUNDED = {**_CLAIMS, 4: (8e-4, 0.7), 5: (5e-4, 2.0)}
#: Polynomial order of rounded rectangles of low index -> factor from the next change of a geometric series to the
#: bound. It was measured on 18 random ones; the pillar of index 4.1 named above is off by 37 times that change.
_SHRINKING = {5: 8.0}
#: Claims of rings. On 30 random ones the errors of orders 4, 5 and 6 against order 8 were at most 0.53, 1.1 and 2.1 of
#: the last change; on 100 others that of order 4 was 1.34 of it beside a resonance, and 3.7 at a change of 0.16; on 50
#: more that of order 4 was 2.5 of it in a ring of index 5.
_CLAIMS_RING = {**_CLAIMS, 4: (6e-4, 4.0), 5: (4e-4, 2.0), 6: (4e-4, 2.5), 7: (2e-4, 2.5)}
#: Claims of cross-sections other than ellipses.
_CLAIMS_OF = {"rectangle": _CLAIMS_ROUNDED, "ring": _CLAIMS_RING}
#: Ratio of the two sizes from which claims grow in proportion, and largest growth: elements are long where an elongated
#: outline is bent most. Of 300 random ellipses, the seven tightest bounds were 1.6 to 2.6 times the errors; six of them
#: had ratios of 4 to 12.
_LONG, _LONG_GROWTH = 2.5, 2.0
#: Elements resolve waves guided in a film or cap where 2 p + 1 > phi + phi^(1/3), phi the phase over half the period in
#: it (Ainsworth, SIAM J. Numer. Anal. 42, 553, 2004). On a film of 3.76, 2.4 wavelengths in a period, orders 4 and 5 of
#: an ellipse agreed within 1.8e-4, and both were off by 1.3e-3; order 8 was off by 1.6 of its last change. Where the
#: coarsest order does not resolve them, claims grow by this factor.
_UNRESOLVED_GROWTH = 3.0
#: Last change above which the orders have not begun to converge.
_NOT_CONVERGING = 0.1
#: Coarsest order.
_COARSE = 3
#: Least bound on the error of an efficiency over its change from the order before.
_SHARE = 2.0


@dataclass(frozen=True)
class CurvedDetails(SolverDetails):
    """Figures of a solution by spectral elements."""

    order: int  #: Polynomial order of the finest solution.
    elements: int  #: Elements of a quarter of the cell.
    functions: int  #: Functions of the transverse E in that quarter.
    solutions: int  #: Number of orders that were solved.
    transmitted_power_x: float  #: Power in all transmitted orders over the incident power, for incident x.
    transmitted_power_y: float  #: Likewise for incident y.
    reflected_power_x: float  #: Power in all reflected orders over the incident power, for incident x.
    reflected_power_y: float  #: Likewise for incident y.


def solve(
    cell: PillarCell, numerics: CellNumerics, known: dict[tuple[int, int], ZeroOrder] | None = None
) -> CellResponse:
    """Solve ``cell`` for its Jones matrices, with a bound on their error that is at most the target if it converged.

    If the target is not met at the highest order, that solution is returned with ``converged`` false.

    Args:
        cell: a cell that :func:`metafab.cell.curved.mesh.is_treated` accepts.
        numerics: target error and largest order.
        known: cache of this cell's solutions, (order, 1) -> solution, read and extended: for calls of several targets.

    Raises:
        SolverError: a layer is singular, or an amplitude is not a finite number.
    """
    started = time.perf_counter()
    solved: list[ZeroOrder] = []
    changes: list[float] = []
    known = {} if known is None else known
    for order in range(_COARSE, max(_COARSE + 1, min(numerics.max_orders, max(_CLAIMS))) + 1):
        if (order, 1) not in known:
            known[order, 1] = zero_order(cell, order)
        solved.append(known[order, 1])
        if len(solved) > 1:
            changes.append(distance(solved[-1], solved[-2]))
            error = bound(order, changes, cell)
            if error <= numerics.target_error:
                break
    last = solved[-1]
    if not (np.isfinite(last.t).all() and np.isfinite(last.r).all()):
        raise SolverError(f"spectral elements gave no finite amplitudes of order {order} for {cell}")
    (transmitted_x, transmitted_y), (reflected_x, reflected_y) = last.transmitted_power, last.reflected_power
    return CellResponse(
        cell=cell,
        numerics=replace(numerics, solver="elements"),
        t=last.t,
        r=last.r,
        error=error,
        converged=error <= numerics.target_error,
        resolution=last.coefficients,
        seconds=time.perf_counter() - started,
        details=CurvedDetails(
            order=order,
            elements=len(quarter_mesh(cell).quads),
            functions=last.coefficients,
            solutions=len(solved),
            transmitted_power_x=float(transmitted_x),
            transmitted_power_y=float(transmitted_y),
            reflected_power_x=float(reflected_x),
            reflected_power_y=float(reflected_y),
        ),
    )


def bound(order: int, changes: list[float], cell: PillarCell) -> float:
    """Bound on the error of a polynomial order of ``cell`` from the changes up to it, one or more."""
    floor, share = _CLAIMS_OF.get(cell.shape, _CLAIMS)[order]
    implied = share * changes[-1]
    layers = [n for each in (*cell.under, *cell.over) for n in (each.n_inside, each.n_around)]
    densest = max(abs(n) for n in (cell.n_pillar, cell.n_ambient, *cell.n_substrate, *layers))
    phase_rad = 0.5 * cell.k0_per_nm * max(cell.period_nm) * max(map(abs, layers), default=0.0)
    least = phase_rad + phase_rad ** (1.0 / 3.0)
    is_low = densest <= _LOW_INDEX
    if cell.shape == "ellipse" and len(changes) > 1:
        implied = max(implied, (_BEFORE_LOW if is_low else _BEFORE) * changes[-2])
    elif cell.shape == "rectangle" and is_low and order in _SHRINKING and len(changes) > 1 and changes[-2] > 0.0:
        implied = min(implied, _SHRINKING[order] * changes[-1] ** 2 / changes[-2])
    is_resolved = [2.0 * coarser + 1.0 > least for coarser in (order - 1, _COARSE)]
    growth = 1.0 if all(is_resolved) else _UNRESOLVED_GROWTH
    ratio = max(cell.width_nm, cell.length_nm) / min(cell.width_nm, cell.length_nm)
    growth *= min(max(1.0, ratio / _LONG), _LONG_GROWTH)
    return max(growth * floor, growth * implied, 1.0 if changes[-1] > _NOT_CONVERGING or not is_resolved[0] else 0.0)


def diffraction(cell: PillarCell, numerics: CellNumerics) -> Diffraction:
    """Efficiencies of every order that leaves a cell, at the polynomial order that its amplitudes need.

    The cell is one that :func:`metafab.cell.curved.mesh.is_treated` accepts. The change of an efficiency bounds its
    error as that of an amplitude does. Errors as in :func:`metafab.cell.curved.solve.solve`.
    """
    answer = solve(cell, numerics)
    assert isinstance(answer.details, CurvedDetails)
    order = answer.details.order
    sides = [propagating_orders(cell, index) for index in (cell.n_out, cell.n_in)]
    before, found = (order_efficiencies(cell, each, sides) for each in (order - 1, order))
    change = float(np.abs(found - before).max())
    error = max(2.0 * answer.error, _SHARE * change, bound(order, [change], cell))
    count = len(sides[0])
    transmitted = diffracted(cell, sides[0], cell.n_out[0], found[:count])
    reflected = diffracted(cell, sides[1], cell.n_in[0], found[count:])
    return Diffraction(transmitted, reflected, error, error <= numerics.target_error, order)
