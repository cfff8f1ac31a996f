"""Joint effect of the rows and the columns of a small block, by coarse spectral elements.

The field of a block is that of its pillars among equal ones, plus what each row alone and each column alone adds to it,
plus a joint effect. Chains know the first three. The joint effect is a difference of solutions with few functions a
site: of the block, less those of its rows and of its columns, plus those of its pillars among equal ones. All hold the
same functions on each site, so that most of their error is common to them and cancels. What does not cancel is a shift
of resonances: few functions guide light as pillars of a smaller index would. Their index is raised until single pillars
have the library's t. A block whose rows or whose columns are all equal has no joint effect.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from metafab.cell.elements.solve import orders_at
from metafab.cell.supercell import IntArray, Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray

#: Largest block, in sites, and smallest gap between its pillars as a share of the period.
MOST_SITES, _SMALLEST_GAP = 49, 0.02
#: Smallest polynomial order of an element, and orders per wavelength in its medium over the largest element.
_LEAST_ORDER, _PER_WAVELENGTH = 3, 2.5
#: Relative change of the pillars' index for its derivative, and the largest one that single pillars may ask for.
_INDEX_STEP, _MOST_RAISED = 1e-3, 5e-3


def has_joint_effect(supercell: Supercell) -> bool:
    """Whether :func:`joint_effect` treats a supercell: a small block of rectangles that do not touch."""
    gap = 1.0 - float(np.max(supercell.size_nm / supercell.cell.period_nm))
    is_small = min(supercell.shape) > 1 and math.prod(supercell.shape) <= MOST_SITES
    return is_small and gap >= _SMALLEST_GAP and not supercell.cell.is_shaped


def joint_effect(supercell: Supercell, local: ComplexArray) -> ComplexArray:
    """Joint effect of rows and columns on the transmitted orders of a block, shape (orders, 2, 2), [order, out, in].

    ``local`` are t_xx and t_yy of the pillars among equal ones, shape (2, n_y, n_x).
    """
    orders = element_orders(supercell)
    block = _tuned(supercell, local, orders)
    order = block.propagating_orders("x")
    lines = _rows(block, order, orders) + _rows(block.exchanged(), order[:, ::-1], orders)[:, ::-1, ::-1]
    for axis, t in enumerate(_alone(block, orders)):
        lines[:, axis, axis] -= block.local_period(order, t)
    return np.asarray(orders_at(block, POLARISATIONS, orders) - lines)


def element_orders(supercell: Supercell) -> tuple[int, int]:
    """Polynomial orders of all pillars and of all gaps of a block and of its lines."""
    cell, size_nm = supercell.cell, supercell.size_nm
    pillar_nm, gap_nm = float(size_nm.max()), float(np.max(np.array(cell.period_nm) - size_nm))
    pillar, gap = (
        math.ceil(_PER_WAVELENGTH * length_nm * complex(index).real / cell.wavelength_nm)
        for length_nm, index in ((pillar_nm, cell.n_pillar), (gap_nm, cell.n_ambient))
    )
    return max(_LEAST_ORDER, pillar), max(_LEAST_ORDER, gap)


def _rows(supercell: Supercell, order: IntArray, orders: tuple[int, int]) -> ComplexArray:
    """Orders of a block in which each row were among equal ones, shape (orders, 2, 2)."""
    n_y = supercell.shape[0]
    place = (np.arange(n_y) + 0.5) / n_y - 0.5
    distinct, number = np.unique(supercell.size_nm, axis=0, return_inverse=True)
    of_rows = np.stack([orders_at(Supercell(supercell.cell, row[None]), POLARISATIONS, orders) for row in distinct])
    # The orders of a row are -M to M.
    along = of_rows[number.ravel()][:, order[:, 0] + of_rows.shape[1] // 2]
    phase = np.exp(-2j * np.pi * np.outer(place, order[:, 1])) / n_y
    return np.asarray(np.einsum("jo,jopq->opq", phase, along))


def _alone(supercell: Supercell, orders: tuple[int, int]) -> ComplexArray:
    """Zero-order t_xx and t_yy of each pillar among equal ones, shape (2, n_y, n_x)."""
    distinct, number = np.unique(supercell.size_nm.reshape(-1, 2), axis=0, return_inverse=True)
    cells = [Supercell(supercell.cell, size[None, None]) for size in distinct]
    t = np.stack([np.diag(orders_at(cell, POLARISATIONS, orders)[0]) for cell in cells], axis=1)
    return t[:, number.ravel()].reshape(2, *supercell.shape)


def _tuned(supercell: Supercell, local: ComplexArray, orders: tuple[int, int]) -> Supercell:
    """The supercell with the index of its pillars that brings coarse elements nearest to ``local``: one Newton step."""
    raised = replace(supercell, cell=replace(supercell.cell, n_pillar=supercell.cell.n_pillar * (1.0 + _INDEX_STEP)))
    now, there = _alone(supercell, orders), _alone(raised, orders)
    slope = (there - now) / _INDEX_STEP
    share = float(np.vdot(slope, local - now).real / np.vdot(slope, slope).real)
    share = min(max(share, 0.0), _MOST_RAISED)
    return replace(supercell, cell=replace(supercell.cell, n_pillar=supercell.cell.n_pillar * (1.0 + share)))
