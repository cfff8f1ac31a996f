"""Layers under and over the pillar: what must hold whatever the truncation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from metafab.cell import CellNumerics, Slice, solve
from metafab.cell.fresnel import film_jones
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.derivatives import derivatives
from metafab.cell.rcwa.scattering import doubling, stack
from metafab.core.conventions import Side
from metafab.core.errors import InputError
from tests.paper_cell import SILICON

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


STACKS = {
    "film and cap": replace(SILICON, under=(FILM,), over=(CAP,)),
    "lossless": replace(SILICON, n_pillar=3.6941, under=(FILM,), over=(CAP,)),
    "from the ambient": replace(SILICON, under=(FILM,), over=(CAP,), side="ambient"),
    "oblique": replace(SILICON, under=(FILM,), over=(CAP,), angle_deg=20.0),
    "out of plane": replace(SILICON, under=(FILM,), over=(CAP,), angle_deg=20.0, azimuth_deg=33.0),
    "birefringent": replace(
        SILICON, over=(CAP,), n_substrate=(1.7601, 1.7522), n_substrate_z=1.7601, angle_deg=20.0, azimuth_deg=33.0
    ),
    "Rayleigh anomaly": replace(SILICON, under=(FILM,), over=(CAP,), period_nm=(800.0, 800.0)),
    "Rayleigh anomaly before": replace(SILICON, under=(FILM,), over=(CAP,), period_nm=(800.0, 800.0), side="ambient"),
    "sloped": replace(SILICON, sidewall_angle_deg=88.0),
    "metal on top": replace(SILICON, over=(Slice(30.0, 0.15 + 3.5j, 1.0),)),
    "0.1 nm of oxide": replace(SILICON, over=(Slice(0.1, 1.45, 1.0),)),
    "tall": replace(SILICON, over=(Slice(50_000.0, 1.41, 1.0),)),
    "half-wave film": replace(SILICON, under=(Slice(200.0, 2.0, 2.0),)),
    "no height": replace(SILICON, under=(FILM,), height_nm=0.0),
    "nothing but an interface": replace(SILICON, under=(Slice(0.0, 2.0, 2.0),), height_nm=0.0),
}


@pytest.mark.parametrize("name", STACKS)
def test_slabs_and_modes_agree(name: str) -> None:
    # Two ways through the same matrices; of a result by modes the condition is known.
    orders, steps = (2 if "plane" in name or "bire" in name else 4), 4
    by_slabs = zero_order(STACKS[name], orders, steps=steps)
    by_modes = zero_order(STACKS[name], orders, steps=steps, by_modes=True)
    # A film of half a wave has no admittance between its faces.
    assert (by_slabs.conditioning.condition == 0.0) == (name != "half-wave film")
    assert by_slabs.inconsistency < 1e-10
    # What eigenvectors of up to 41 unknowns leave to rounding.
    np.testing.assert_allclose(by_slabs.t, by_modes.t, rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(by_slabs.r, by_modes.r, rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(by_slabs.transmitted_power, by_modes.transmitted_power, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("off_nm", [1e-9, 1e-6, 1e-3, 0.1])
def test_films_of_nearly_half_a_wave(off_nm: float) -> None:
    # Near the pole of the slab's admittance digits are lost without any loss of reciprocity.
    film = replace(SILICON, width_nm=0.0, length_nm=0.0, height_nm=0.0, under=(Slice(200.0 + off_nm, 2.0, 2.0),))
    exact_t, exact_r = film_jones(replace(film, under=(), height_nm=200.0 + off_nm), 2.0)
    solved = zero_order(film, 3)
    np.testing.assert_allclose(solved.t, exact_t, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(solved.r, exact_r, rtol=0.0, atol=1e-11)


def test_slabs_that_lose_reciprocity_are_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    # A planted fault: slabs that are not symmetric. The modes take over.
    cell = STACKS["film and cap"]
    true = zero_order(cell, 4)

    def spoilt(*arguments: Any) -> tuple[Any, Any] | None:
        found = doubling.slab(*arguments)
        return None if found is None else (found[0], np.triu(found[1]))

    monkeypatch.setattr(stack, "slab", spoilt)
    other = zero_order(cell, 4)
    assert other.conditioning.condition > 1.0
    np.testing.assert_allclose(other.t, true.t, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("thickness_nm", [5_000.0, 50_000.0])
def test_thick_layers_stay_stable(thickness_nm: float) -> None:
    cell = replace(SILICON, n_pillar=3.6941, over=(Slice(thickness_nm, 1.41, 1.0),))
    solved = zero_order(cell, 5)
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)


@pytest.mark.slow
def test_bound_holds_for_coated_pillars() -> None:
    for size_nm in ((150.0, 210.0), (120.0, 130.0)):
        cell = replace(SILICON, width_nm=size_nm[0], length_nm=size_nm[1], under=(FILM,), over=(CAP,))
        response, reference = solve(cell, CellNumerics(target_error=1e-2)), zero_order(cell, 10)
        assert response.converged
        assert np.abs(response.t - reference.t).max() <= response.error
        assert np.abs(response.r - reference.r).max() <= response.error


def test_layers_are_refused_where_they_would_be_dropped() -> None:
    coated = replace(SILICON, over=(CAP,))
    with pytest.raises(InputError, match="under, over"):
        derivatives(coated, 4)
    with pytest.raises(InputError, match="height_nm") as caught:
        solve(replace(SILICON, under=(Slice(-1.0, 1.5 - 0.1j, 1.0),)))
    assert [fault.field for fault in caught.value.faults] == ["under[0].height_nm", "under[0].n"]
