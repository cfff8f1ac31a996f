"""The law of rotation: one integral a zone against lobes measured in PSFs, and the measurement itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import jv

from metafab.phase import Pupil, main_lobe
from metafab.phase.optimise.rotation import (
    full_turn_defocus_rad,
    full_turn_dioptre,
    refined_peak,
    ring_rotation,
    rotation_deg_per_dioptre,
)
from metafab.phase.pupil import FocalPlane, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field

COARSE = Pupil(64)


def test_a_tilted_pupil_moves_the_image_the_same_way() -> None:
    """Sign of the transform: a phase rising along +y deflects light towards +y."""
    field = np.exp(1j * (2.0 * COARSE.x + 4.0 * COARSE.y))
    lobe = main_lobe(COARSE, field, [0.0], 8.0)
    assert lobe.phi_deg[0] == pytest.approx(math.degrees(math.atan2(4.0, 2.0)), abs=0.2)
    assert lobe.radius[0] == pytest.approx(math.hypot(4.0, 2.0), rel=2e-3)
    assert lobe.peak[0] == pytest.approx(1.0, abs=2e-3)


PUPIL = Pupil(128)


@pytest.mark.parametrize("zones", [2, 3, 4, 5, 7])
def test_the_rings_give_rate_and_radius_of_the_plain_spirals_lobe(zones: int) -> None:
    radius, rate = ring_rotation(zones, 0.5)
    lobe = main_lobe(PUPIL, spiral_field(PUPIL, zones, 0.5), full_turn_defocus_rad(zones, 48), 2.0 * zones + 6.0)
    assert (np.diff(lobe.phi_deg) < 0.0).all()
    # The lobe swings about the line by about a degree in 360, and zone boundaries are drawn with squares of 1 / 64.
    assert np.polyfit(lobe.defocus_rad, np.radians(lobe.phi_deg), 1)[0] == pytest.approx(rate, rel=5e-3)
    in_focus = main_lobe(PUPIL, spiral_field(PUPIL, zones, 0.5), [0.0], 2.0 * zones + 6.0)
    assert in_focus.radius[0] == pytest.approx(radius, rel=1.0 / 128)


def test_two_zones_turn_slower_than_the_law_and_that_is_no_error() -> None:
    """The paper's range at L = 2: 3.4 % off -1 / L, and within half a per cent of the rate of its two rings."""
    defocus = rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, 49), 0.30, 1000.0, 0.8)
    lobe = main_lobe(PUPIL, spiral_field(PUPIL, 2, 0.5), defocus, 10.0)
    rate = np.polyfit(defocus, np.radians(lobe.phi_deg), 1)[0]
    assert -2.0 * rate < 0.97
    assert rate == pytest.approx(ring_rotation(2, 0.5)[1], rel=5e-3)


@pytest.mark.parametrize("exponent", [0.4, 0.5, 0.6])
def test_the_regression_over_two_rings_is_the_difference_of_their_weighted_means(exponent: float) -> None:
    v, rate = ring_rotation(2, exponent)
    u = np.linspace(0.0, 1.0, 200_001)
    inner = u <= 0.5**exponent
    means = []
    for charge, ring in ((1, inner), (2, ~inner)):
        light = jv(charge, v * u[ring]) * u[ring]
        means.append(float((light * u[ring] ** 2).sum() / light.sum()))
    # A Riemann sum of 2e5 steps: the edge of a ring is off by at most one.
    assert rate == pytest.approx(-(means[1] - means[0]), rel=1e-4)


def test_many_zones_turn_by_the_law() -> None:
    """Each ring gets narrow, so that no weight inside it matters; 24 zones are within a per cent."""
    rates = [-zones * ring_rotation(zones, 0.5)[1] for zones in (2, 4, 24)]
    assert abs(rates[0] - 1.0) > 0.03
    assert abs(rates[2] - 1.0) < 0.01


def test_the_law_in_degrees_per_dioptre() -> None:
    rate = rotation_deg_per_dioptre(4, 1000.0, 0.8)
    assert rate == pytest.approx(-225.0 / 4.0, rel=1e-12)
    assert full_turn_dioptre(4, 1000.0, 0.8) * -rate == pytest.approx(360.0, rel=1e-12)
    assert rotation_deg_per_dioptre(1, 1000.0, 0.8) == 0.0
    assert full_turn_dioptre(1, 1000.0, 0.8) == math.inf


def test_an_oblique_ridge_has_its_top_where_it_is() -> None:
    """A quadratic with a mixed term is met exactly; parabolas along x and y alone would miss it by 0.2 samples."""
    plane = FocalPlane(Pupil(8), 1.5, 0.3)
    x, y = np.meshgrid(plane.axis - 0.36, plane.axis + 0.27)
    value, v_x, v_y = refined_peak(2.0 - x**2 - y**2 - 1.6 * x * y, plane)
    assert (value, v_x, v_y) == pytest.approx((2.0, 0.36, -0.27), abs=1e-12)


def test_a_plateau_and_a_saddle_keep_the_largest_sample() -> None:
    plane = FocalPlane(Pupil(8), 0.9, 0.3)
    flat = np.ones((plane.axis.size, plane.axis.size))
    assert refined_peak(flat, plane)[0] == 1.0
