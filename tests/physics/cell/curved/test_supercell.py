"""Supercells of circles and ellipses: what is known of them from single cells, symmetry and energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, solve
from metafab.cell.elements import ElementNumerics, order_gradients, orders_at, supercell_orders
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS
from metafab.core.errors import InputError

#: Lossless titanium dioxide on glass.
CELL = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=0.0,
    length_nm=0.0,
    height_nm=600.0,
    n_pillar=2.4 + 0j,
    n_substrate=(1.46 + 0j,) * 2,
    n_ambient=1.0 + 0j,
    wavelength_nm=532.0,
    shape="ellipse",
)
RAMP = [(130.0, 130.0), (190.0, 190.0), (240.0, 240.0)]
COARSE = 2.0


def _row(*sizes: tuple[float, float], cell: PillarCell = CELL) -> Supercell:
    return Supercell(cell, np.array([sizes]))


def test_one_ellipse_is_its_certified_cell() -> None:
    """Whose mesh is another one, of a quarter of the cell. The bound is that of two orders of the supercell's mesh."""
    found = supercell_orders(_row((200.0, 160.0)), ElementNumerics(1e-9, (3.0, 4.0)))
    own = solve(replace(CELL, width_nm=200.0, length_nm=160.0), CellNumerics(target_error=2e-3))
    assert np.linalg.norm(found.t[0] - own.t) < own.error + found.error * np.linalg.norm(found.t)
    assert found.error < 6e-2


def test_a_circle_and_a_gap_are_a_cell_of_twice_the_period() -> None:
    row = _row((180.0, 180.0), (0.0, 0.0))
    t = orders_at(row, ("x",), 3.0)
    own = solve(
        replace(CELL, period_nm=(700.0, 350.0), width_nm=180.0, length_nm=180.0), CellNumerics(target_error=1e-2)
    )
    assert abs(t[1, 0, 0] - own.t[0, 0]) < 2e-2


def test_a_block_of_two_equal_rows_is_one_row() -> None:
    """By whole pillars in place of half ones, without a mirror, both polarisations at once."""
    row = _row(*RAMP[:2])
    block = Supercell(CELL, np.concatenate([row.size_nm] * 2))
    one, two = (orders_at(each, POLARISATIONS, COARSE) for each in (row, block))
    of_row = block.propagating_orders("x")[:, 1] == 0
    assert np.linalg.norm(one - two[of_row]) < 2e-2 * np.linalg.norm(one)
    assert np.abs(two[~of_row]).max() < 1e-9
    assert np.abs(two[:, [0, 1], [1, 0]]).max() < 1e-9, "a mirror keeps y light out of x light"
    for axis, light in enumerate(POLARISATIONS):
        alone = orders_at(block, (light,), COARSE)
        np.testing.assert_allclose(alone[..., 0], two[..., axis], atol=1e-9)


def test_orders_of_one_circle_have_phases_from_its_middle() -> None:
    """Two equal circles stand half a period beside the middle: their order 2 m turns by (-1)^m."""
    wide = replace(CELL, period_nm=(700.0, 350.0))
    one, two = (_row(*[(180.0, 180.0)] * count, cell=wide) for count in (1, 2))
    t_one, t_two = (orders_at(each, ("x",), COARSE)[:, 0, 0] for each in (one, two))
    m, even = one.propagating_orders("x")[:, 0], two.propagating_orders("x")[:, 0] % 2 == 0
    np.testing.assert_allclose(t_one, t_two[even] * (-1.0) ** m, atol=1e-9)
    np.testing.assert_array_equal(m, [-1, 0, 1])
    assert np.abs(t_one).min() > 0.05


def test_a_period_of_many_digits_is_closed() -> None:
    """Twice 350.0000004 nm rounds to another length than twice its rounded value; no seam may come of it."""
    odd = replace(CELL, period_nm=(350.0000004, 350.0))
    here, there = (orders_at(_row(*RAMP[:2], cell=cell), POLARISATIONS, COARSE) for cell in (CELL, odd))
    np.testing.assert_allclose(there, here, atol=1e-6)


def test_a_lossless_row_transmits_equal_power_from_both_sides() -> None:
    """Reciprocity of the zero order; and no more light leaves than came in."""
    row, back = (_row(*RAMP, cell=replace(CELL, side=side)) for side in ("substrate", "ambient"))
    for axis, light in enumerate(POLARISATIONS):
        powers = []
        for each in (row, back):
            order = each.propagating_orders(light)
            power = each.relative_power(order, orders_at(each, (light,), COARSE)[..., 0], light)
            assert 0.3 < power.sum() < 1.0, axis
            powers.append(float(power[np.all(order == 0, axis=1)][0]))
        assert powers[0] == pytest.approx(powers[1], rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"shape": "cross"}, "crosses"),
        ({"shape": "rectangle", "corner_radius_nm": 20.0}, "rounded corners"),
        ({"shape": "ring", "hole_nm": 40.0}, "rings"),
        ({"is_staggered": True}, "hexagonal"),
        ({"n_pillar": 0.1 + 3.0j}, "metal"),
    ],
)
def test_what_has_no_elements_is_refused_by_name(changes: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        orders_at(_row(*RAMP, cell=replace(CELL, **changes)), ("x",), COARSE)  # type: ignore[arg-type]


def test_derivatives_by_the_sizes_of_circles_are_refused_by_name() -> None:
    order = _row(*RAMP).propagating_orders("x")
    with pytest.raises(InputError, match="circles or ellipses"):
        order_gradients(_row(*RAMP), "x", COARSE, np.zeros((1, len(order), 2), dtype=complex))


def test_resolutions_of_one_order_are_one() -> None:
    """Orders are whole numbers: 2.2 and 2.6 are both order 3, and agree whatever their error."""
    row = _row(*RAMP[:2])
    fine, whole = (supercell_orders(row, ElementNumerics(1e-9, each)) for each in ((1.4, 2.2, 2.6), (1.0, 2.0)))
    assert fine.error == whole.error > 1e-2


def test_too_many_circles_are_refused_with_what_is_possible() -> None:
    with pytest.raises(InputError, match="4 x 4 pillars, or a row of 22"):
        supercell_orders(_row(*[(150.0, 150.0)] * 23))


def test_touching_circles_are_sent_to_meep() -> None:
    with pytest.raises(InputError, match="use meep"):
        orders_at(_row((349.0, 349.0), (200.0, 200.0)), ("x",), COARSE)
