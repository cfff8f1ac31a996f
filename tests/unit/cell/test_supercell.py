"""Supercells without a solver: which orders there are, what they carry, what lone pillars predict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import Slice
from metafab.cell.fresnel import interface
from metafab.cell.supercell import Supercell, SupercellResponse
from metafab.core.errors import InputError
from tests.paper_cell import EMPTY

#: Unlike along x and y.
CELL = replace(EMPTY, period_nm=(350.0, 300.0), n_substrate=(1.7601, 1.75))
RNG = np.random.default_rng(7)
BLOCK = Supercell(CELL, RNG.uniform(100.0, 250.0, (6, 9, 2)))


def test_propagating_orders_are_those_inside_the_circle_of_k() -> None:
    orders = BLOCK.propagating_orders("x")
    reach = 1.0 / 0.8
    inside = {
        (m, n)
        for m in range(-20, 21)
        for n in range(-20, 21)
        if (m / (9 * 0.35)) ** 2 + (n / (6 * 0.3)) ** 2 < reach**2
    }
    assert {(int(m), int(n)) for m, n in orders} == inside
    assert len(orders) == len(inside)
    # Towards the substrate there are more of them.
    assert len(Supercell(replace(CELL, side="ambient"), BLOCK.size_nm).propagating_orders("x")) > len(orders)


def test_an_order_exactly_along_the_surface_carries_nothing_and_is_left_out() -> None:
    grazing = Supercell(replace(CELL, period_nm=(400.0, 300.0)), np.full((1, 2, 2), 100.0))
    np.testing.assert_array_equal(grazing.propagating_orders("x"), [[0, 0]])


@pytest.mark.parametrize(("polarisation", "n_in"), [("x", 1.7601), ("y", 1.75)])
def test_the_zero_order_carries_the_power_of_the_conventions(polarisation: str, n_in: float) -> None:
    t = 0.3 - 0.6j
    amplitude = np.array([[t, 0.0]]) if polarisation == "x" else np.array([[0.0, t]])
    flux = BLOCK.relative_power(np.zeros((1, 2), dtype=np.intp), amplitude, polarisation)  # type: ignore[arg-type]
    assert flux[0] == pytest.approx(abs(t) ** 2 / n_in)


def test_oblique_orders_carry_what_their_full_field_says() -> None:
    """Poynting's z component of E = (E_x, E_y, -k.E/k_z), against n_in for unit incident field."""
    orders = BLOCK.propagating_orders("y")
    amplitude = RNG.normal(size=(len(orders), 2)) + 1j * RNG.normal(size=(len(orders), 2))
    k0 = 2.0 * np.pi / 0.8
    k = np.column_stack([BLOCK.wavevectors_per_um(orders), np.zeros(len(orders))])
    k[:, 2] = np.sqrt(k0**2 - np.sum(k**2, axis=1))
    field = np.column_stack([amplitude, -np.sum(k[:, :2] * amplitude, axis=1) / k[:, 2]])
    magnetic = np.cross(k, field) / k0
    poynting = np.real(np.cross(field, magnetic.conj()))[:, 2]
    np.testing.assert_allclose(BLOCK.relative_power(orders, amplitude, "y"), poynting / 1.75, rtol=1e-12)


def test_lone_pillars_predict_the_fourier_series_of_their_responses() -> None:
    responses = RNG.normal(size=BLOCK.shape) + 1j * RNG.normal(size=BLOCK.shape)
    m, n = np.meshgrid(np.arange(-4, 5), np.arange(-3, 3))
    all_orders = np.stack([m.ravel(), n.ravel()], axis=-1)
    amplitude = BLOCK.local_period(all_orders, responses)
    # As many orders as sites: nothing is lost, and the sum of orders at the sites gives the responses back.
    np.testing.assert_allclose(BLOCK.at_sites(all_orders, amplitude), responses, atol=1e-12)
    assert np.sum(np.abs(amplitude) ** 2) == pytest.approx(np.mean(np.abs(responses) ** 2))


def test_equal_pillars_predict_the_zero_order_alone() -> None:
    orders = BLOCK.propagating_orders("x")
    amplitude = BLOCK.local_period(orders, np.full(BLOCK.shape, 0.4j))
    np.testing.assert_allclose(amplitude, np.where(np.all(orders == 0, axis=1), 0.4j, 0.0), atol=1e-15)


def test_exchange_is_its_own_inverse() -> None:
    turned = BLOCK.exchanged()
    assert turned.shape == BLOCK.shape[::-1]
    assert turned.cell.n_substrate == CELL.n_substrate[::-1]
    np.testing.assert_array_equal(turned.size_nm[2, 5], BLOCK.size_nm[5, 2, ::-1])
    np.testing.assert_array_equal(turned.exchanged().size_nm, BLOCK.size_nm)
    assert turned.exchanged().cell == CELL
    swapped = {(int(m), int(n)) for n, m in turned.propagating_orders("y")}
    assert swapped == {(int(m), int(n)) for m, n in BLOCK.propagating_orders("x")}


def test_each_distinct_pillar_is_named_once() -> None:
    sizes = np.array([[[100.0, 120.0], [120.0, 100.0]], [[100.0, 120.0], [0.0, 0.0]]])
    alone = Supercell(CELL, sizes).periodic_cells()
    assert set(alone) == {(100.0, 120.0), (120.0, 100.0), (0.0, 0.0)}
    assert alone[120.0, 100.0].width_nm == 120.0


def test_a_response_compares_itself_with_its_own_pillars() -> None:
    orders = BLOCK.propagating_orders("y")
    responses = RNG.normal(size=BLOCK.shape) + 0j
    predicted = BLOCK.local_period(orders, responses)
    amplitude = np.zeros((len(orders), 2), dtype=complex)
    amplitude[:, 1] = predicted
    same = SupercellResponse(BLOCK, "y", orders, amplitude, responses, 0.0, 0.0)
    assert same.coupling_error == 0.0
    np.testing.assert_array_equal(same.efficiency, same.local_period_efficiency)
    amplitude = amplitude.copy()
    amplitude[0, 1] += 0.3
    amplitude[1, 1] += 0.4j
    assert replace(same, amplitude=amplitude).coupling_error == pytest.approx(0.5)


def test_an_empty_row_is_fresnels_interface() -> None:
    """In the planes of the conventions, 600 nm of air behind it."""
    from metafab.cell.elements import ElementNumerics, solve_supercell

    empty = Supercell(replace(CELL, n_substrate=(1.7601 + 0j,) * 2), np.zeros((1, 3, 2)))
    found = solve_supercell(empty, "x", ElementNumerics(1e-3, (2.0, 3.0)))
    t = interface(1.7601, 1.0)[0] * np.exp(2j * np.pi * 600.0 / 800.0)
    np.testing.assert_allclose(found.co_polarised, np.where(found.order[:, 0] == 0, t, 0.0), atol=1e-6)


@pytest.mark.parametrize(
    "sizes", [np.zeros((0, 3, 2)), np.zeros((3, 2)), np.full((1, 2, 2), -1.0), np.full((1, 2, 2), 340.0)]
)
def test_blocks_that_are_none_are_refused(sizes: np.ndarray) -> None:
    with pytest.raises(InputError, match="size_nm"):
        Supercell(CELL, sizes)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"angle_deg": 3.0}, "angle_deg"),
        ({"over": (Slice(50.0, 1.4, 1.0),)}, "over"),
        ({"sidewall_angle_deg": 88.0}, "sidewall_angle_deg"),
        ({"n_substrate_z": 1.75 + 0j}, "n_substrate_z"),
    ],
)
def test_cells_that_no_supercell_solver_treats_are_refused(changes: dict[str, object], field: str) -> None:
    with pytest.raises(InputError, match=field):
        Supercell(replace(CELL, **changes), np.full((1, 2, 2), 120.0))  # type: ignore[arg-type]
