"""Centres of the pictures of a lobe that turns: on short arcs too, with the error that they have."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.measures.centring import find_centre

CENTRE_PX, RADIUS_PX = (0.7, -1.2), 6.0


def lobes(arc_deg: float, peak: float, seed: int, depths: int = 8) -> FloatArray:
    """A Gaussian lobe on an arc about ``CENTRE_PX``, with photon noise where ``peak`` is not infinite."""
    y, x = np.mgrid[:64, :64] - 32.0
    angle = np.radians(np.linspace(0.0, arc_deg, depths))[:, None, None]
    dx = x - CENTRE_PX[0] - RADIUS_PX * np.cos(angle)
    dy = y - CENTRE_PX[1] - RADIUS_PX * np.sin(angle)
    shape = np.exp(-(dx**2 + dy**2) / (2.0 * 1.6**2))
    return shape if np.isinf(peak) else np.random.default_rng(seed).poisson(peak * shape) / peak


@pytest.mark.parametrize("arc_deg", [40.0, 50.0, 105.0, 300.0])
def test_a_lobe_without_noise_turns_about_its_centre(arc_deg: float) -> None:
    centre = find_centre(lobes(arc_deg, np.inf, 0), "auto")
    assert (centre.rule, centre.warning) == ("turn", None)
    np.testing.assert_allclose(centre.place_px, CENTRE_PX, atol=0.02)


def test_the_stated_error_of_a_short_arc_is_its_scatter() -> None:
    """Of 40 draws all are taken for a circle, none for a centre of mass more than 5 px away."""
    found = [find_centre(lobes(49.0, 20000.0, seed), "auto") for seed in range(40)]
    assert {one.rule for one in found} == {"turn"}
    away = np.array([np.hypot(*np.subtract(one.place_px, CENTRE_PX)) for one in found])
    stated = np.array([one.error_px for one in found])
    assert 0.6 < np.sqrt(np.mean(away**2) / np.mean(stated**2)) < 1.7


def test_a_centre_that_noise_moves_is_told() -> None:
    weak = find_centre(lobes(45.0, 1500.0, 3, depths=6), "auto")
    assert weak.error_px > 0.25
    assert weak.warning is not None and "depth moves with it" in weak.warning


def test_a_lobe_that_moves_off_any_circle_is_told() -> None:
    straight = np.array([np.roll(lobes(0.0, np.inf, 0, 1)[0], shift, axis=1) for shift in range(-9, 10, 3)])
    centre = find_centre(straight, "auto")
    assert centre.rule == "mass"
    assert centre.warning is not None and "moves by 18 px" in centre.warning
    assert find_centre(straight, "mass").warning is None  # as asked for
    with pytest.raises(InputError, match="on a circle"):
        find_centre(straight, "turn")


def test_two_lobes_that_turn_about_their_mass_are_told_nothing() -> None:
    """The brightest of both changes, the centre of mass stays."""
    one = lobes(90.0, np.inf, 0)
    y, x = np.mgrid[:64, :64] - 32
    both = one + np.array([picture[::-1, ::-1] for picture in one])
    both = np.roll(both, 1, axis=(1, 2))
    assert find_centre(both * (x**2 + y**2 < 900), "auto").warning is None
