"""Joint effect of the rows and the columns of a small block, by coarse spectral elements.

The field of a block is that of its pillars among equal ones, plus what each row alone and each column alone adds to it,
plus a joint effect. Chains give the first three. The joint effect is a difference of solutions with few functions a
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

#: Smallest gap between pillars as a share of the period.
_SMALLEST_GAP = 0.02
#: Smallest polynomial order of an element, and orders per wavelength in its medium over the largest element.
_LEAST_ORDER, _PER_WAVELENGTH = 3, 2.5
#: Most functions of a block with pillars of one order more, and without: 5 x 5 and 7 x 7 pillars of the paper's lens.
#: On both lights of ten and of nine blocks against fine elements (rms) the first leaves 0.006 of the field, the second
#: 0.014. They take 48 s, and 150 s and 4 GB.
_MOST_FINE, _MOST_FUNCTIONS = 2600, 3800
#: Relative change of the pillars' index for its derivative, and the largest one that single pillars may ask for.
_INDEX_STEP, _MOST_RAISED = 1e-3, 5e-3


def has_joint_effect(supercell: Supercell) -> bool:
    """Whether :func:`joint_effect` treats a supercell.

    That is a small block of rectangles that do not touch, with periods that send light into no order but the zeroth.
    Equal rows or equal columns have no joint effect.
    """
    cell = supercell.cell
    is_dense = max(cell.period_nm) * max(index.real for index in cell.n_out) < cell.wavelength_nm
    are_equal = any(not np.ptp(supercell.size_nm, axis=axis).any() for axis in (0, 1))
    if are_equal or cell.is_shaped or not is_dense:
        return False
    gap = 1.0 - float(np.max(supercell.size_nm / cell.period_nm))
    return gap >= _SMALLEST_GAP and element_orders(supercell) is not None


def joint_effect(supercell: Supercell, local: ComplexArray) -> ComplexArray:
    """Joint effect of rows and columns on the transmitted orders of a block, shape (orders, 2, 2), [order, out, in].

    ``local`` are t_xx and t_yy of the pillars among equal ones, shape (2, n_y, n_x). ValueError for a block that is too
    large.
    """
    orders = element_orders(supercell)
    if orders is None:
        raise ValueError(
            f"`supercell`: expected a small block, got {supercell.shape[1]} x {supercell.shape[0]} pillars"
        )
    block = _tuned(supercell, local, orders)
    order = block.propagating_orders("x")
    lines = _rows(block, order, orders) + _rows(block.exchanged(), order[:, ::-1], orders)[:, ::-1, ::-1]
    for axis, t in enumerate(_alone(block, orders)):
        lines[:, axis, axis] -= block.local_period(order, t)
    return np.asarray(orders_at(block, POLARISATIONS, orders) - lines)


def element_orders(supercell: Supercell) -> tuple[int, int] | None:
    """Polynomial orders of all pillars and of all gaps of a block and of its lines; None for a block too large."""
    cell, size_nm = supercell.cell, supercell.size_nm
    pillar_nm, gap_nm = float(size_nm.max()), float(np.max(np.array(cell.period_nm) - size_nm))
    pillar, gap = (
        math.ceil(_PER_WAVELENGTH * length_nm * complex(index).real / cell.wavelength_nm)
        for length_nm, index in ((pillar_nm, cell.n_pillar), (gap_nm, cell.n_ambient))
    )
    pillar, gap = max(_LEAST_ORDER, pillar), max(_LEAST_ORDER, gap)
    # A block that is its own image under a half turn needs half of the functions.
    sites = math.prod(supercell.shape) / (2.0 if np.array_equal(size_nm, size_nm[::-1, ::-1]) else 1.0)
    for order, most in ((pillar + 1, _MOST_FINE), (pillar, _MOST_FUNCTIONS)):
        # Along each axis of a site order + gap functions; two components of the field, and four corners.
        if sites * (2 * (order + gap) ** 2 + 4) <= most:
            return order, gap
    return None


def _rows(supercell: Supercell, order: IntArray, orders: tuple[int, int]) -> ComplexArray:
    """Orders of a block as if each row stood among equal rows, shape (orders, 2, 2)."""
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
