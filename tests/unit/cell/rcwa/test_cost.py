"""The cost model: an order of things, not a stopwatch."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from metafab.cell import CellNumerics, Slice
from metafab.cell.rcwa import cost
from metafab.cell.rcwa.slicing import slicing
from tests.paper_cell import SILICON

#: A millisecond for five cosines.
seconds_of_truncation = partial(cost.seconds_of_truncation, five_cosines_s=1e-3)
seconds_estimate = partial(cost.seconds_estimate, five_cosines_s=1e-3)


def test_more_orders_cost_more() -> None:
    seconds = [seconds_of_truncation(orders) for orders in range(3, 25)]
    assert (np.diff(seconds) > 0.0).all()
    assert seconds_of_truncation(5) == pytest.approx(1e-3)
    # Twice the orders beyond the curve: four times the unknowns, 64 times the work.
    assert seconds_of_truncation(40) == pytest.approx(64.0 * seconds_of_truncation(20))


def test_tighter_targets_cost_more() -> None:
    loose, middle, tight = (seconds_estimate(target) for target in (1e-2, 1e-3, 1e-4))
    assert loose == pytest.approx(seconds_of_truncation(3) + seconds_of_truncation(5))
    assert middle == pytest.approx(seconds_of_truncation(4) + seconds_of_truncation(6))
    assert tight == pytest.approx(seconds_of_truncation(6) + seconds_of_truncation(8))


def test_what_the_light_and_the_layers_cost() -> None:
    seconds = seconds_of_truncation(5)
    film = Slice(100.0, 1.45, 1.45)
    assert seconds_of_truncation(5, replace(SILICON, length_nm=150.0)) == pytest.approx(0.5 * seconds)
    assert seconds_of_truncation(5, replace(SILICON, under=(film,), over=(film,))) == pytest.approx(3.0 * seconds)
    # A layer of no height is none; 16 steps are solved along with 8.
    assert seconds_of_truncation(5, replace(SILICON, under=(replace(film, height_nm=0.0),))) == seconds
    sloped = replace(SILICON, sidewall_angle_deg=88.0)
    assert seconds_of_truncation(5, sloped, 16) == pytest.approx(24.0 * seconds)
    # Light in a mirror plane leaves two classes of twice 61 unknowns, as 7.3 cosines have; other light one of 244.
    in_plane, out_of_plane = (replace(SILICON, angle_deg=20.0, azimuth_deg=azimuth) for azimuth in (0.0, 40.0))
    assert seconds_of_truncation(7) < seconds_of_truncation(5, in_plane) < seconds_of_truncation(8)
    twice = 2.0 * seconds_of_truncation(5, out_of_plane)
    assert seconds_of_truncation(10) < twice < seconds_of_truncation(12)
    # A short period gets as many cosines as a long one.
    oblong = replace(SILICON, period_nm=(350.0, 250.0))
    assert seconds_of_truncation(8, oblong) == seconds_of_truncation(8)


def test_slopes_and_stacks_are_foreseen() -> None:
    capped = replace(SILICON, over=(Slice(40.0, 1.41, 1.0),))
    assert seconds_estimate(1e-2, capped) > 3.0 * seconds_estimate(1e-2, SILICON)
    sloped = replace(SILICON, n_pillar=2.4, sidewall_angle_deg=89.0)
    steps = slicing(sloped, CellNumerics(1e-2)).steps
    assert seconds_estimate(1e-2, sloped) > steps * seconds_estimate(1e-2, SILICON)


def test_the_machine_is_measured() -> None:
    assert 0.0 < cost.seconds_estimate(1e-2) < 10.0
