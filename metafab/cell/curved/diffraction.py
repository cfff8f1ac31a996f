"""Efficiencies of single orders of a cell that is solved by spectral elements."""

from __future__ import annotations

import numpy as np

from metafab.cell.curved.layers import order_efficiencies
from metafab.cell.curved.solve import CurvedDetails, bound, solve
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.diffraction import Diffraction, diffracted, propagating_orders
from metafab.cell.response import CellNumerics

#: Least bound on the error of an efficiency over its change from the order before.
_SHARE = 2.0


def diffraction(cell: PillarCell, numerics: CellNumerics) -> Diffraction:
    """Efficiencies of every order that leaves a cell, at the polynomial order that its amplitudes need.

    The cell is one that :func:`metafab.cell.curved.mesh.is_treated` accepts. The change of an efficiency bounds its
    error as that of an amplitude does. Errors as of :func:`metafab.cell.curved.solve.solve`.
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
