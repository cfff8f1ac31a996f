"""Layers of different outlines over one coordinate map: sloped walls, a cap that is narrower than its pillar."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.cell import CellNumerics, PillarCell, Slice, solve
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.basis.axis import AxisBasis, outline_bases
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.jones import distance
from metafab.cell.rcwa.slicing import slicing, smooth
from metafab.core.conventions import Side
from metafab.core.errors import InputError

#: Titanium dioxide: a contrast at which plain harmonics converge well enough to be a reference.
TITANIA = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=150.0,
    length_nm=210.0,
    height_nm=600.0,
    n_pillar=2.4,
    n_substrate=(1.46, 1.46),
    n_ambient=1.0,
    wavelength_nm=800.0,
)
SILICON = replace(TITANIA, n_pillar=3.6941 + 0.0065j, n_substrate=(1.7601, 1.7601))
FORMULATIONS: tuple[Formulation, ...] = ("adaptive", "fourier")
ROUNDING = 1e-10

fills = st.floats(0.05, 0.95)


def _spectrum(overlap: np.ndarray) -> np.ndarray:
    return np.linalg.eigvalsh(overlap)


@given(st.lists(fills, min_size=2, max_size=4), st.integers(2, 9))
@settings(max_examples=25, deadline=None)
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_overlaps_are_those_of_nested_projections(formulation: Formulation, shares: list[float], orders: int) -> None:
    # An indicator function between orthonormal functions: eigenvalues within [0, 1]; a wider outline holds a narrower.
    sizes = tuple(350.0 * share for share in shares)
    bases = outline_bases(350.0, sizes, orders, formulation)
    for basis, size in zip(bases, sizes, strict=True):
        assert basis.even[0, 0] == pytest.approx(size / 350.0, abs=1e-12)
        for overlap in (basis.even, basis.odd):
            assert _spectrum(overlap)[0] > -1e-12
            assert _spectrum(overlap)[-1] < 1.0 + 1e-12
    by_size = sorted(zip(sizes, bases, strict=True), key=lambda pair: pair[0])
    for (_, narrow), (_, wide) in pairwise(by_size):
        assert _spectrum(wide.even - narrow.even)[0] > -1e-12
        assert _spectrum(wide.odd - narrow.odd)[0] > -1e-12


def test_plain_harmonics_hold_the_textbook_integrals() -> None:
    # int 2 cos(2 pi m x / U) cos(2 pi n x / U) over |x| < a / 2, over U: sinc((m - n) a / U) + sinc((m + n) a / U).
    fills_ = (0.3, 0.55, 0.8)
    bases = outline_bases(1.0, fills_, 4, "fourier")
    m = np.arange(1, 5)
    for basis, fill in zip(bases, fills_, strict=True):
        near, far = (fill * np.sinc(fill * (m[:, None] + sign * m)) for sign in (-1.0, 1.0))
        np.testing.assert_allclose(np.abs(basis.even[1:, 1:]), np.abs(near + far), rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(np.abs(basis.odd), np.abs(near - far), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_one_outline_is_the_ordinary_basis(formulation: Formulation) -> None:
    several = outline_bases(350.0, (150.0, 150.0), 5, formulation)
    alone: AxisBasis = outline_bases(350.0, (150.0,), 5, formulation)[0]
    assert all(basis is alone for basis in several)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("angle", [(0.0, 0.0), (20.0, 90.0), (20.0, 40.0)])
def test_sloped_pillars_conserve_power_and_are_reciprocal(formulation: Formulation, angle: tuple[float, float]) -> None:
    cell = replace(TITANIA, sidewall_angle_deg=86.0, over=(Slice(40.0, 1.41, 1.0, 90.0, 120.0),))
    cell = replace(cell, angle_deg=angle[0], azimuth_deg=angle[1])
    up = zero_order(cell, 3, formulation, steps=3)
    np.testing.assert_allclose(up.transmitted_power + up.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)
    if angle[0] == 0.0:
        down = zero_order(replace(cell, side="ambient"), 3, formulation, steps=3)
        np.testing.assert_allclose(np.diag(up.t), 1.46 * np.diag(down.t), rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("angle_deg", [86.0, 94.0])
def test_adapted_and_plain_staircases_meet(angle_deg: float) -> None:
    # The same two steps, by one map for both walls and by plain harmonics, which converge algebraically.
    cell = replace(TITANIA, sidewall_angle_deg=angle_deg)
    adapted = zero_order(cell, 8, steps=2)
    fine, coarse = (zero_order(cell, orders, "fourier", steps=2) for orders in (12, 7))
    assert distance(fine, coarse) < 2e-2
    assert distance(adapted, fine) < 0.7 * distance(adapted, coarse) < 2e-2


def test_stated_sizes_may_be_meant_at_any_height() -> None:
    middle = replace(SILICON, sidewall_angle_deg=88.0)
    for place, share in (("bottom", 0.0), ("top", 1.0)):
        width, length = middle.sizes_nm(share)
        same = replace(middle, width_nm=width, length_nm=length, sizes_at=place)  # type: ignore[arg-type]
        assert same.sizes_nm(0.3) == pytest.approx(middle.sizes_nm(0.3), abs=1e-12)
    # Walls that lean inwards by 2 degrees over 600 nm: 2 * 600 * tan(2 deg) less at the top than at the bottom.
    bottom, top = middle.sizes_nm(0.0)[0], middle.sizes_nm(1.0)[0]
    assert bottom - top == pytest.approx(2.0 * 600.0 * np.tan(np.radians(2.0)))


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_grating_and_its_shift_by_half_a_period_are_one(formulation: Formulation) -> None:
    # A ridge in the middle of the cell, or the groove there: the same grating, moved by half a period. The zero order
    # does not see where it stands. Two layers of unlike ridges share the map; cosines of odd number change their sign.
    high, low = 2.4, 1.0
    ridges = (Slice(200.0, high, low, 150.0, 20.0), Slice(150.0, high, low, 90.0, 20.0))
    grooves = tuple(Slice(s.height_nm, low, high, 350.0 - s.width_nm, 20.0) for s in ridges if s.width_nm)
    empty = replace(TITANIA, width_nm=0.0, length_nm=0.0, height_nm=0.0, period_nm=(350.0, 20.0))
    one, other = (zero_order(replace(empty, under=layers), 14, formulation) for layers in (ridges, grooves))
    # In plain harmonics a shift is a change of phases and nothing else; adapted maps are different truncations.
    assert distance(one, other) < (1e-10 if formulation == "fourier" else 2e-4)


@pytest.mark.parametrize("side", ["substrate", "ambient"])
def test_the_pillar_stands_on_the_substrate_whatever_the_side_of_the_light(side: Side) -> None:
    # Two steps, written out: the wide one below.
    cell = replace(SILICON, sidewall_angle_deg=85.0, side=side)
    low, high = (Slice(300.0, cell.n_pillar, 1.0, *cell.sizes_nm(share)) for share in (0.25, 0.75))
    assert low.width_nm is not None
    assert high.width_nm is not None
    assert low.width_nm > high.width_nm
    by_hand = replace(cell, sidewall_angle_deg=90.0, height_nm=0.0, under=(low,), over=(high,))
    assert distance(zero_order(cell, 4, "fourier", steps=2), zero_order(by_hand, 4, "fourier")) < ROUNDING


@pytest.mark.parametrize(
    ("size_nm", "angle_deg"), [((150.0, 210.0), 89.5), ((120.0, 180.0), 88.0), ((230.0, 190.0), 91.0)]
)
def test_steps_are_as_fine_as_they_claim(size_nm: tuple[float, float], angle_deg: float) -> None:
    cell = replace(TITANIA, width_nm=size_nm[0], length_nm=size_nm[1], sidewall_angle_deg=angle_deg)
    cut = slicing(cell, CellNumerics(target_error=8e-3))
    limit = smooth(cell, 4, "adaptive", 64)
    assert cut.error <= 4e-3
    assert distance(smooth(cell, 4, "adaptive", cut.steps), limit) <= cut.error
    few = slicing(cell, CellNumerics(target_error=8e-3, steps=2))
    assert few.steps == 2
    assert distance(smooth(cell, 4, "adaptive", 2), limit) <= few.error


def test_extrapolation_takes_the_second_order_away_and_keeps_the_power() -> None:
    cell = replace(TITANIA, sidewall_angle_deg=86.0)
    limit = smooth(cell, 4, "adaptive", 64)
    cut, extrapolated = zero_order(cell, 4, steps=16), smooth(cell, 4, "adaptive", 16)
    assert distance(extrapolated, limit) < 0.2 * distance(cut, limit)
    np.testing.assert_allclose(
        extrapolated.transmitted_power + extrapolated.reflected_power, 1.0, rtol=0.0, atol=ROUNDING
    )
    assert distance(smooth(TITANIA, 4, "adaptive", 8), zero_order(TITANIA, 4)) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("size_nm", [(150.0, 210.0), (120.0, 180.0)])
def test_steps_counted_at_a_low_truncation_serve_a_higher_one(size_nm: tuple[float, float]) -> None:
    # Resonant silicon, where the evanescent field that more cosines resolve makes each step count for more.
    cell = replace(SILICON, width_nm=size_nm[0], length_nm=size_nm[1], sidewall_angle_deg=88.0)
    cut = slicing(cell, CellNumerics(target_error=4e-2))
    assert 0.0 < cut.error <= 2e-2
    assert distance(smooth(cell, 7, "adaptive", cut.steps), smooth(cell, 7, "adaptive", 64)) <= cut.error


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("angle_deg", [86.0, 94.0])
def test_a_pillar_upside_down_is_one_that_leans_the_other_way(angle_deg: float, formulation: Formulation) -> None:
    # Written out from its top on and lit from the other end, between exchanged half spaces: the same t and r. Below 90
    # degrees a pillar narrows upwards, above 90 downwards: 600 nm / tan(angle) less on either side from end to end.
    cell = replace(SILICON, sidewall_angle_deg=angle_deg, width_nm=160.0)
    lean = 2.0 * 600.0 / np.tan(np.radians(angle_deg))
    # The ends, of no height, set the same coordinates.
    steps = [(0.0, -0.5), (150.0, -0.375), (150.0, -0.125), (150.0, 0.125), (150.0, 0.375), (0.0, 0.5)]
    from_the_top = [
        Slice(height, cell.n_pillar, 1.0, 160.0 + lean * share, 210.0 + lean * share) for height, share in steps
    ]
    turned = replace(
        SILICON,
        height_nm=0.0,
        width_nm=160.0,
        n_substrate=(1.0, 1.0),
        n_ambient=1.7601,
        under=tuple(from_the_top),
        side="ambient",
    )
    assert distance(zero_order(cell, 4, formulation, steps=4), zero_order(turned, 4, formulation)) < ROUNDING


@pytest.mark.parametrize("angle_deg", [86.0, 94.0])
def test_light_through_leaning_walls_is_reciprocal(angle_deg: float) -> None:
    # In a medium that is the same on both sides, upside down is lit from the other end: t of the one is t of the other.
    lying = replace(TITANIA, n_substrate=(1.0, 1.0), sidewall_angle_deg=angle_deg)
    leaning_back = replace(lying, sidewall_angle_deg=180.0 - angle_deg)
    one, other = (smooth(cell, 5, "adaptive", 8) for cell in (lying, leaning_back))
    np.testing.assert_allclose(one.t, other.t, rtol=0.0, atol=ROUNDING)
    # Reflection tells the two apart.
    assert np.abs(one.r - other.r).max() > 1e-3


def test_bound_of_a_sloped_pillar_holds_its_steps_and_its_truncation() -> None:
    cell = replace(TITANIA, sidewall_angle_deg=89.5)
    response = solve(cell, CellNumerics(target_error=2e-2))
    assert response.converged
    assert response.error > response.details.slicing_error > 0.0
    finer = smooth(cell, 8, "adaptive", 2 * int(response.details.steps))
    assert np.abs(response.t - finer.t).max() <= response.error
    assert np.abs(response.r - finer.r).max() <= response.error
    assert not hasattr(solve(TITANIA, CellNumerics(target_error=1e-2)).details, "steps")


def test_impossible_slopes_are_refused() -> None:
    with pytest.raises(InputError, match="sizes of 0 to the period") as caught:
        solve(replace(SILICON, width_nm=30.0, sidewall_angle_deg=85.0))
    assert [fault.field for fault in caught.value.faults] == ["width_nm"]
    with pytest.raises(InputError, match="sidewall_angle_deg"):
        solve(replace(SILICON, sidewall_angle_deg=45.0))
    for steps in (0, 1, 3):
        with pytest.raises(InputError, match="steps"):
            solve(replace(SILICON, sidewall_angle_deg=88.0), CellNumerics(steps=steps))
    with pytest.raises(InputError, match=r"over\[0\].width_nm"):
        solve(replace(SILICON, over=(Slice(40.0, 1.41, 1.0, 351.0, 100.0),)))
