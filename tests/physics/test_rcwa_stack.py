"""Layers under and over the pillar: what must hold whatever the truncation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, Slice, solve
from metafab.cell.rcwa import derivatives, zero_order
from metafab.core.conventions import Side
from metafab.core.errors import InputError

SILICON = PillarCell((350.0, 350.0), 150.0, 210.0, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)
#: An antireflection film under the pillar and a cap of resist on it.
FILM, CAP = Slice(120.0, 1.45, 1.45), Slice(40.0, 1.41, 1.0)
#: Rounding of eigenvalue problems of some 50 unknowns.
ROUNDING = 1e-10


@pytest.mark.parametrize("side", ["substrate", "ambient"])
@pytest.mark.parametrize("angle", [(0.0, 0.0), (20.0, 0.0), (20.0, 40.0)])
@pytest.mark.parametrize("orders", [3, 5])
def test_a_pillar_cut_in_three_is_the_pillar(side: Side, angle: tuple[float, float], orders: int) -> None:
    if angle[1] and orders > 3:
        orders = 2
    whole = replace(SILICON, side=side, angle_deg=angle[0], azimuth_deg=angle[1])
    cut = replace(
        whole,
        height_nm=90.0,
        under=(Slice(10.0, SILICON.n_pillar, 1.0), Slice(0.0, 2.0, 1.3)),
        over=(Slice(500.0, SILICON.n_pillar, 1.0),),
    )
    one, other = zero_order(whole, orders), zero_order(cut, orders)
    np.testing.assert_allclose(other.t, one.t, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(other.r, one.r, rtol=0.0, atol=1e-9)


def test_a_film_of_substrate_turns_the_phase_alone() -> None:
    thickness_nm = 300.0
    bare = zero_order(SILICON, 5)
    raised = zero_order(replace(SILICON, under=(Slice(thickness_nm, 1.7601, 1.7601),)), 5)
    turn = np.exp(2j * np.pi * 1.7601 * thickness_nm / 800.0)
    np.testing.assert_allclose(raised.t, bare.t * turn, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(raised.r, bare.r * turn**2, rtol=0.0, atol=ROUNDING)


def test_a_quarter_wave_film_cancels_the_reflection() -> None:
    # Born and Wolf, section 1.6: n^2 = n_in n_out, a quarter of a wave thick.
    index = np.sqrt(1.7601)
    film = Slice(800.0 / (4.0 * index), index, index)
    coated = zero_order(replace(SILICON, width_nm=0.0, length_nm=0.0, height_nm=0.0, under=(film,)), 3)
    assert np.abs(coated.r).max() < 1e-12


@pytest.mark.parametrize("orders", [3, 5])
def test_coated_pillars_conserve_power_and_are_reciprocal(orders: int) -> None:
    cell = replace(SILICON, n_pillar=3.6941, under=(FILM,), over=(CAP, Slice(20.0, 2.1, 1.0)))
    up, down = (zero_order(replace(cell, side=side), orders) for side in ("substrate", "ambient"))
    np.testing.assert_allclose(up.transmitted_power + up.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(np.diag(up.t), 1.7601 * np.diag(down.t), rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("thickness_nm", [5_000.0, 50_000.0])
def test_thick_layers_stay_stable(thickness_nm: float) -> None:
    cell = replace(SILICON, n_pillar=3.6941, over=(Slice(thickness_nm, 1.41, 1.0),))
    solved = zero_order(cell, 5)
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)


@pytest.mark.slow
def test_bound_holds_for_coated_pillars() -> None:
    for size_nm in ((150.0, 210.0), (120.0, 130.0)):
        cell = replace(SILICON, width_nm=size_nm[0], length_nm=size_nm[1], under=(FILM,), over=(CAP,))
        response, reference = solve(cell, CellNumerics(1e-2)), zero_order(cell, 10)
        assert response.converged
        assert np.abs(response.t - reference.t).max() <= response.error
        assert np.abs(response.r - reference.r).max() <= response.error


def test_layers_are_refused_where_they_would_be_dropped() -> None:
    coated = replace(SILICON, over=(CAP,))
    with pytest.raises(InputError, match="under, over"):
        derivatives(coated, 4)
    with pytest.raises(InputError, match="under, over"):
        solve(coated, CellNumerics(solver="meep"))
    with pytest.raises(InputError, match="height_nm") as caught:
        solve(replace(SILICON, under=(Slice(-1.0, 1.5 - 0.1j, 1.0),)))
    assert [fault.field for fault in caught.value.faults] == ["under[0].height_nm", "under[0].n"]
