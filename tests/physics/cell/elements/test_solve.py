"""Supercells by spectral elements: what is known of them without another solver of supercells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, rcwa
from metafab.cell.elements import ElementNumerics, orders_at, scattered_by_row, supercell_orders
from metafab.cell.elements.basis import basis_of
from metafab.cell.supercell import Supercell, relative_rms
from metafab.core.conventions import POLARISATIONS, Polarisation
from metafab.core.errors import InputError
from tests.paper_cell import EMPTY, LOSSLESS

RAMP = [(120.0, 180.0), (150.0, 150.0), (180.0, 130.0)]
BLOCK = np.array([[(120.0, 180.0), (150.0, 110.0)], [(180.0, 130.0), (220.0, 160.0)]])
COARSE = 2.5


def _row(*sizes: tuple[float, float], cell: PillarCell = EMPTY) -> Supercell:
    return Supercell(cell, np.array([sizes]))


@pytest.mark.parametrize("size", [(120.0, 180.0), (200.0, 104.0), (250.0, 250.0)])
def test_one_pillar_is_its_certified_cell(size: tuple[float, float]) -> None:
    """The last stands on a resonance. The Fourier solver shares neither basis nor half spaces with this one."""
    found = supercell_orders(_row(size), ElementNumerics(4e-3))
    own = rcwa.solve(replace(EMPTY, width_nm=size[0], length_nm=size[1]), CellNumerics(target_error=1e-4)).t
    assert relative_rms(found.t[0] - own, own) < found.error
    assert found.error * np.linalg.norm(own) < 8e-3


@pytest.mark.parametrize("light", POLARISATIONS)
def test_equal_pillars_are_their_own_local_period(light: Polarisation) -> None:
    single, three = (orders_at(_row(*[(120.0, 180.0)] * count), (light,), 3.0) for count in (1, 3))
    order = _row(*[(120.0, 180.0)] * 3).propagating_orders(light)
    np.testing.assert_allclose(three[order[:, 0] == 0], single, atol=1e-3)
    assert np.abs(three[order[:, 0] != 0]).max() < 1e-9


def test_a_pillar_and_a_gap_are_a_cell_of_twice_the_period() -> None:
    wide = replace(EMPTY, period_nm=(700.0, 350.0), width_nm=130.0, length_nm=170.0)
    supercell = _row((130.0, 170.0), (0.0, 0.0))
    found = supercell_orders(supercell, ElementNumerics(4e-3))
    own = rcwa.solve(wide, CellNumerics(target_error=1e-3))
    zero = int(np.flatnonzero(found.order[:, 0] == 0)[0])
    assert np.abs(found.t[zero] - own.t).max() < own.error + found.error * np.linalg.norm(found.t)


def test_a_block_of_two_equal_rows_is_one_row() -> None:
    """By the code without a mirror: other numbering, other plane waves, both polarisations at once."""
    row = _row(*RAMP[:2])
    twice = Supercell(EMPTY, np.concatenate([row.size_nm] * 2))
    np.testing.assert_allclose(
        orders_at(twice, POLARISATIONS, COARSE), orders_at(row, POLARISATIONS, COARSE), atol=1e-9
    )


@pytest.mark.parametrize("light", POLARISATIONS)
@pytest.mark.parametrize("sizes", [[RAMP[0], RAMP[1], RAMP[0]], [RAMP[0], RAMP[2], RAMP[2], RAMP[0]]])
def test_a_row_that_is_its_own_mirror_image_needs_half_of_the_functions(
    sizes: list[tuple[float, float]], light: Polarisation
) -> None:
    """Moved by a site it is not its image about the middle, and all functions are kept."""
    row, moved = _row(*sizes), _row(*sizes[-1:], *sizes[:-1])
    order = row.propagating_orders(light)[:, 0]
    turned = orders_at(row, (light,), COARSE) * np.exp(-2j * np.pi * order / len(sizes))[:, None, None]
    np.testing.assert_allclose(orders_at(moved, (light,), COARSE), turned, atol=1e-9)
    half, whole = (basis_of(row, light, COARSE, folded=folded).sizes for folded in (True, False))
    assert half[0] <= 0.52 * whole[0] and half[1] <= 0.55 * whole[1]


@pytest.mark.parametrize("light", POLARISATIONS)
def test_a_row_divides_the_light_between_both_sides(light: Polarisation) -> None:
    """Transmitted orders as ever; a lossless pillar, whose only order is the zero order, loses no power."""
    row, axis = _row(*RAMP, cell=replace(LOSSLESS, width_nm=0.0, length_nm=0.0)), POLARISATIONS.index(light)
    transmitted = scattered_by_row(row, light, COARSE)[1]
    np.testing.assert_allclose(transmitted, orders_at(row, (light,), COARSE)[:, axis, 0], atol=1e-12)
    near, far = scattered_by_row(replace(row, size_nm=row.size_nm[:, :1]), light, COARSE)[:, 0]
    n_in, n_out = (complex(n[axis]).real for n in (row.cell.n_in, row.cell.n_out))
    assert abs(near) ** 2 + n_out / n_in * abs(far) ** 2 == pytest.approx(1.0, abs=1e-9)
    assert abs(near) > 0.1


def test_a_lossless_row_sends_out_no_more_than_came_in() -> None:
    row = _row(*RAMP, cell=replace(LOSSLESS, width_nm=0.0, length_nm=0.0))
    t = orders_at(row, POLARISATIONS, COARSE)
    for axis, light in enumerate(POLARISATIONS):
        assert 0.3 < row.relative_power(row.propagating_orders(light), t[:, :, axis], light).sum() < 1.0


def test_lossless_light_is_transmitted_equally_from_both_sides() -> None:
    """Reciprocity: the power of the zero order of a row does not depend on the side that the light comes from."""
    cell = replace(LOSSLESS, width_nm=0.0, length_nm=0.0)
    row, back = (_row(*RAMP, cell=replace(cell, side=side)) for side in ("substrate", "ambient"))
    for axis, light in enumerate(POLARISATIONS):
        powers = []
        for each in (row, back):
            zero = np.all(each.propagating_orders(light) == 0, axis=1)
            t = orders_at(each, (light,), COARSE)[zero][0, axis, 0]
            powers.append(abs(t) ** 2 * each.cell.n_out[axis].real / each.cell.n_in[axis].real)
        assert powers[0] == pytest.approx(powers[1], rel=1e-9)


def test_the_stated_error_holds_and_refinement_settles() -> None:
    row = _row((104.0, 246.0), (238.0, 112.0))
    finest = orders_at(row, POLARISATIONS, 5.0)
    for pair in ((2.5, 3.0), (3.0, 4.0)):
        found = supercell_orders(row, ElementNumerics(1e-9, pair))
        assert relative_rms(found.t - finest, finest) < found.error
    assert found.error < 2e-2


def test_a_block_exchanges_its_axes() -> None:
    """The exchanged block under exchanged light."""
    block = Supercell(EMPTY, BLOCK)
    t = orders_at(block, POLARISATIONS, 2.0)
    turned = orders_at(block.exchanged(), POLARISATIONS, 2.0)
    np.testing.assert_allclose(turned[:, ::-1, ::-1], t, atol=1e-9)
    assert np.abs(t[:, 0, 1]).max() < 1e-9, "two by two pillars always have both mirrors"


def test_equal_rows_of_a_block_are_the_row_where_all_sites_have_the_same_functions() -> None:
    """Other light is sent into no order across the rows; a row alone is solved by the functions of its mirror."""
    row = np.array([RAMP])
    whole, alone = (orders_at(Supercell(EMPTY, np.repeat(row, n, axis=0)), POLARISATIONS, (3, 2)) for n in (2, 1))
    order = Supercell(EMPTY, np.repeat(row, 2, axis=0)).propagating_orders("x")
    np.testing.assert_allclose(whole[order[:, 1] == 0], alone, atol=1e-9)
    assert np.abs(whole[order[:, 1] != 0]).max(initial=0.0) < 1e-9
    three, coarse = (orders_at(Supercell(EMPTY, row), POLARISATIONS, orders) for orders in (3.0, (3, 3)))
    assert 1e-3 < relative_rms(coarse - three, three) < 0.2


def test_a_block_that_is_its_image_under_a_half_turn_needs_half_of_the_functions() -> None:
    """Moved by a site it is not its image about the middle, and all functions are kept."""
    a, b, c, d, e = [*RAMP, (220.0, 160.0), (140.0, 210.0)]
    block, moved = (
        Supercell(EMPTY, np.array(rows))
        for rows in ([[a, b, c], [d, e, d], [c, b, a]], [[c, a, b], [d, d, e], [a, c, b]])
    )
    order = block.propagating_orders("x")
    turned = orders_at(block, POLARISATIONS, 2.0) * np.exp(-2j * np.pi * order[:, 0] / 3)[:, None, None]
    np.testing.assert_allclose(orders_at(moved, POLARISATIONS, 2.0), turned, atol=1e-9)
    assert np.abs(turned[:, 0, 1]).max() > 0.01, "light is cross-polarised"
    half, whole = (basis_of(block, "x", 2.0, folded=folded).sizes for folded in (True, False))
    assert half[0] <= 0.51 * whole[0] and half[1] <= 0.51 * whole[1]


@pytest.mark.parametrize(
    ("supercell", "field"),
    [
        (_row((348.0, 120.0)), "size_nm"),
        (Supercell(EMPTY, np.linspace(100.0, 140.0, 128).reshape(8, 8, 2)), "size_nm"),
        (Supercell(replace(EMPTY, n_substrate=(1.76, 1.75)), BLOCK), "n_substrate"),
    ],
)
def test_what_is_not_solved_is_refused(supercell: Supercell, field: str) -> None:
    with pytest.raises(InputError, match=field):
        supercell_orders(supercell)
