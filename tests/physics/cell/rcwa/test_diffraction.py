"""Efficiencies of single orders: sum rule, symmetry, reciprocity, and the weak grating in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.cell import CellNumerics, PillarCell, solve
from metafab.cell.rcwa import diffraction, efficiencies, propagating_orders, zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation

WIDE = PillarCell(
    period_nm=(900.0, 700.0),
    width_nm=300.0,
    length_nm=210.0,
    height_nm=600.0,
    n_pillar=2.4,
    n_substrate=(1.46, 1.46),
    n_ambient=1.0,
    wavelength_nm=800.0,
)
#: A grating along x: ridges that fill the cell along y, whose period is short.
GRATING = PillarCell(
    period_nm=(1300.0, 20.0),
    width_nm=500.0,
    length_nm=20.0,
    height_nm=200.0,
    n_pillar=2.4,
    n_substrate=(1.46, 1.46),
    n_ambient=1.0,
    wavelength_nm=800.0,
)
FORMULATIONS: tuple[Formulation, ...] = ("adaptive", "fourier")


@given(
    period_nm=st.tuples(st.floats(300.0, 1200.0), st.floats(300.0, 1200.0)),
    fill=st.tuples(st.floats(0.1, 0.9), st.floats(0.1, 0.9)),
    angle=st.sampled_from([(0.0, 0.0), (20.0, 0.0), (35.0, 90.0), (20.0, 33.0)]),
    n_pillar=st.sampled_from([1.8, 2.4, 2.4 + 0.05j]),
    formulation=st.sampled_from(FORMULATIONS),
)
@settings(max_examples=25, deadline=None)
def test_orders_add_up_to_all_power(
    period_nm: tuple[float, float],
    fill: tuple[float, float],
    angle: tuple[float, float],
    n_pillar: complex,
    formulation: Formulation,
) -> None:
    cell = replace(WIDE, period_nm=period_nm, width_nm=fill[0] * period_nm[0], length_nm=fill[1] * period_nm[1])
    cell = replace(cell, angle_deg=angle[0], azimuth_deg=angle[1], n_pillar=n_pillar)
    transmitted, reflected = efficiencies(cell, 3, formulation)
    whole = zero_order(cell, 3, formulation)
    np.testing.assert_allclose(sum(transmitted.values()), whole.transmitted_power, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(sum(reflected.values()), whole.reflected_power, rtol=0.0, atol=1e-10)
    assert min(power.min() for side in (transmitted, reflected) for power in side.values()) > -1e-12
    if complex(n_pillar).imag == 0.0:
        np.testing.assert_allclose(whole.transmitted_power + whole.reflected_power, 1.0, rtol=0.0, atol=1e-10)


def test_the_zero_order_is_that_of_the_jones_matrices() -> None:
    cell = replace(WIDE, angle_deg=20.0, azimuth_deg=33.0)
    numerics = CellNumerics(target_error=1e-9, max_orders=4)
    found, response = diffraction(cell, numerics), solve(cell, numerics)
    zero = next(each for each in found.transmitted if each.order == (0, 0))
    assert (zero.efficiency_x, zero.efficiency_y) == pytest.approx(response.transmittance, abs=1e-10)
    assert zero.polar_deg == pytest.approx(math.degrees(math.asin(1.46 * math.sin(math.radians(20.0)))))
    assert zero.azimuth_deg == pytest.approx(33.0)
    back = next(each for each in found.reflected if each.order == (0, 0))
    assert back.polar_deg == pytest.approx(20.0)


def test_a_subwavelength_cell_has_zero_orders_alone() -> None:
    cell = replace(WIDE, period_nm=(350.0, 350.0))
    found, response = diffraction(cell, CellNumerics(target_error=3e-2)), solve(cell, CellNumerics(target_error=1e-2))
    assert [each.order for each in found.transmitted] == [(0, 0)]
    assert [each.order for each in found.reflected] == [(0, 0)]
    assert found.converged
    assert found.transmitted[0].efficiency_x == pytest.approx(response.transmittance[0], abs=found.error + 2e-2)


def test_orders_stand_where_the_grating_equation_has_them() -> None:
    # n sin(theta_m) = n_in sin(theta) + m lambda / period.
    cell = replace(GRATING, angle_deg=10.0)
    found = diffraction(cell, CellNumerics(target_error=1e-1, max_orders=6))
    for side, index in ((found.transmitted, 1.0), (found.reflected, 1.46)):
        numbers = [m for m in range(-5, 6) if abs(1.46 * math.sin(math.radians(10.0)) + m * 800.0 / 1300.0) < index]
        assert [each.order for each in side] == [(m, 0) for m in numbers]
        for each in side:
            across = 1.46 * math.sin(math.radians(10.0)) + each.order[0] * 800.0 / 1300.0
            assert math.sin(math.radians(each.polar_deg)) == pytest.approx(abs(across) / index)
            assert each.azimuth_deg == pytest.approx(0.0 if across > 0.0 else 180.0)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("fill", [0.3, 0.5])
def test_a_weak_grating_scatters_as_born_has_it(formulation: Formulation, fill: float) -> None:
    # First order in the contrast: with c_m = sin(pi m f) / (pi m) and k_m the wave number along z over k0, the
    # amplitude of an order is i k0 c_m deps / (2 k_m) int exp(i k0 (1 -+ k_m) z) dz; E across the plane of
    # incidence for light along the ridges (y), and its projection k_m on the order's own p direction for x.
    contrast = 1e-5
    period, height = 1300.0, 300.0
    cell = PillarCell(
        period_nm=(period, 20.0),
        width_nm=fill * period,
        length_nm=20.0,
        height_nm=height,
        n_pillar=math.sqrt(1.0 + contrast),
        n_substrate=(1.0, 1.0),
        n_ambient=1.0,
        wavelength_nm=800.0,
    )
    transmitted, reflected = efficiencies(cell, 12, formulation)
    k0 = 2.0 * math.pi / 800.0
    for m in (-1, 1):
        along = math.sqrt(1.0 - (m * 800.0 / period) ** 2)
        strength = k0 * contrast * math.sin(math.pi * m * fill) / (math.pi * m) / (2.0 * along)
        for found, phase in ((transmitted, 1.0 - along), (reflected, 1.0 + along)):
            pass_ = height * np.sinc(0.5 * k0 * phase * height / math.pi)
            expected = (strength * pass_) ** 2 * along
            # The stretched basis has its harmonics to within the truncation: 1e-3 at twelve orders.
            assert found[m, 0][1] == pytest.approx(expected, rel=2e-3)
            assert found[m, 0][0] == pytest.approx(expected * along**2, rel=2e-3)


@pytest.mark.parametrize("angle", [(0.0, 0.0), (20.0, 0.0), (25.0, 33.0)])
def test_mirrored_light_has_mirrored_orders(angle: tuple[float, float]) -> None:
    one, other = (
        efficiencies(replace(WIDE, angle_deg=angle[0], azimuth_deg=azimuth), 3)
        for azimuth in (angle[1], (180.0 - angle[1]) % 360.0)
    )
    for side in (0, 1):
        for (m, n), power in one[side].items():
            np.testing.assert_allclose(power, other[side][-m, n], rtol=0.0, atol=1e-10)


def test_reflected_orders_are_reciprocal() -> None:
    # Light sent back along an order returns where it came from, with the same efficiency (E along the ridges). The two
    # truncations are windows about different wave vectors; 2e-4 is what 14 cosines leave of that.
    n, turn = 1.46, 800.0 / 1300.0
    there = replace(GRATING, angle_deg=12.0)
    across = n * math.sin(math.radians(12.0)) - turn
    back = replace(GRATING, angle_deg=math.degrees(math.asin(abs(across) / n)))
    one = efficiencies(there, 14)[1][-1, 0][1]
    other = efficiencies(back, 14)[1][-1, 0][1]
    assert across < 0.0
    assert one > 1e-3
    assert one == pytest.approx(other, abs=2e-4)


def test_orders_beyond_the_truncation_are_not_passed_over() -> None:
    wide = replace(WIDE, period_nm=(4000.0, 700.0))
    assert max(m for m, _ in propagating_orders(wide, wide.n_in)) == 7
    found = diffraction(wide, CellNumerics(target_error=1.0 - 1e-9, max_orders=5))
    assert not found.converged
    assert found.error == math.inf
