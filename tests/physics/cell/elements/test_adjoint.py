"""Derivatives of orders by all sizes: against differences of solutions, along a direction, and under exchange."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell.elements import order_gradients, orders_at
from metafab.cell.pillar import PillarCell
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from tests.paper_cell import EMPTY

SIZES = np.array([[(120.0, 180.0), (152.0, 150.0), (181.0, 133.0)]])
RESOLUTION = 2.5
RNG = np.random.default_rng(7)
#: Central differences over 0.1 nm leave their third derivative: 1e-5 to 1e-4 of the first on these pillars.
STEP_NM, RTOL = 0.05, 3e-4


def _along(size_nm: FloatArray, direction: FloatArray, light: Polarisation, cell: PillarCell = EMPTY) -> ComplexArray:
    """Derivative of all orders along a direction of the sizes, by differences; shape (n_orders, 2)."""
    ahead, back = (
        orders_at(Supercell(cell, size_nm + sign * STEP_NM * direction), (light,), RESOLUTION) for sign in (1, -1)
    )
    return np.asarray((ahead - back)[:, :, 0] / (2.0 * STEP_NM))


@pytest.mark.parametrize(("light", "n_pillar"), [("x", EMPTY.n_pillar), ("y", EMPTY.n_pillar.real)])
def test_the_dot_product_identity_along_any_direction(light: Polarisation, n_pillar: complex) -> None:
    """weights . (J direction) = (J^T weights) . direction, with J by differences and J^T by the adjoint.

    Matrices of pillars without loss are real, weights are not.
    """
    cell = replace(EMPTY, n_pillar=n_pillar)
    order = Supercell(cell, SIZES).propagating_orders(light)
    weights = RNG.normal(size=(2, len(order), 2)) + 1j * RNG.normal(size=(2, len(order), 2))
    found = order_gradients(Supercell(cell, SIZES), light, RESOLUTION, weights)
    direction = RNG.normal(size=SIZES.shape)
    forward = np.einsum("koc,oc->k", weights, _along(SIZES, direction, light, cell))
    backward = np.einsum("kyxs,yxs->k", found.gradient, direction)
    np.testing.assert_allclose(backward, forward, rtol=RTOL)
    np.testing.assert_allclose(found.t, orders_at(Supercell(cell, SIZES), (light,), RESOLUTION)[:, :, 0], atol=1e-12)


def test_each_size_of_a_row_along_y_against_differences() -> None:
    column = Supercell(EMPTY, SIZES[:, :2]).exchanged()
    order = column.propagating_orders("x")
    weights = np.zeros((1, len(order), 2), dtype=complex)
    weights[0, np.all(order == 0, axis=1), 0] = 1.0
    found = order_gradients(column, "x", RESOLUTION, weights).gradient[0]
    for place in np.ndindex(*column.size_nm.shape):
        direction = np.zeros(column.size_nm.shape)
        direction[place] = 1.0
        slope = np.sum(weights[0] * _along(column.size_nm, direction, "x"))
        assert abs(found[place] - slope) < RTOL * np.abs(found).max()


@pytest.mark.parametrize("light", POLARISATIONS)
def test_orders_across_a_row_along_y_keep_their_places(light: Polarisation) -> None:
    """Light into a birefringent substrate: several orders along both axes, not equally many of x and of y light."""
    cell = replace(EMPTY, period_nm=(500.0, 250.0), side="ambient", n_substrate=(2.1, 1.7))
    column = Supercell(cell, SIZES[:, :2].transpose(1, 0, 2))
    order = column.propagating_orders(light)
    assert min(np.ptp(order, axis=0)) > 0
    t = orders_at(column, (light,), 2.0)[:, :, 0]
    turned = column.exchanged()
    other = POLARISATIONS[1 - POLARISATIONS.index(light)]
    of_row = dict(zip(map(tuple, turned.propagating_orders(other)), orders_at(turned, (other,), 2.0), strict=True))
    np.testing.assert_array_equal(t, [of_row[n, m][::-1, 0] for m, n in order])
    weights = RNG.normal(size=(1, len(order), 2)) + 1j * RNG.normal(size=(1, len(order), 2))
    found = order_gradients(column, light, 2.0, weights)
    np.testing.assert_allclose(found.t, t, atol=1e-12)
    direction = RNG.normal(size=column.size_nm.shape)
    ahead, back = (
        orders_at(Supercell(cell, column.size_nm + sign * STEP_NM * direction), (light,), 2.0)[:, :, 0]
        for sign in (1, -1)
    )
    slope = np.sum(weights[0] * (ahead - back)) / (2.0 * STEP_NM)
    assert np.sum(found.gradient[0] * direction) == pytest.approx(slope, rel=RTOL)


def test_a_block_with_a_bare_site() -> None:
    """By the code without a mirror; the bare site has no derivative."""
    size_nm = np.array([[(120.0, 180.0), (152.0, 150.0)], [(181.0, 133.0), (0.0, 0.0)]])
    weights = np.array([[[1.0, 0.5j]]])
    found = order_gradients(Supercell(EMPTY, size_nm), "y", 2.0, weights).gradient[0]
    direction = np.where(size_nm > 0.0, 1.0, 0.0) * np.array([1.0, -0.5])
    ahead, back = (
        orders_at(Supercell(EMPTY, size_nm + sign * STEP_NM * direction), ("y",), 2.0)[:, :, 0] for sign in (1, -1)
    )
    slope = np.sum(weights[0] * (ahead - back)) / (2.0 * STEP_NM)
    assert np.sum(found * direction) == pytest.approx(slope, rel=RTOL)
    assert np.all(found[1, 1] == 0.0)
