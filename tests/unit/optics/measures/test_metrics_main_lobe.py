"""The main lobe's place, below a pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.optics.measures.metrics import main_lobe_px, orientation_deg


def _airy_like(x: float, y: float, count: int = 48) -> np.ndarray:
    """A band-limited lobe (a product of squared sincs), 1.3 times oversampled like the paper's sensor."""
    axis = np.arange(count) - count // 2
    along_x, along_y = np.sinc((axis - x) / 2.6) ** 2, np.sinc((axis - y) / 2.6) ** 2
    return np.outer(along_y, along_x)


@settings(max_examples=40, deadline=None)
@given(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))
def test_a_lobe_is_found_to_a_hundredth_of_a_pixel(x: float, y: float) -> None:
    got_x, got_y, height = main_lobe_px(_airy_like(x, y))
    assert (got_x, got_y) == pytest.approx((x, y), abs=0.01)
    # A quintic spline follows the highest frequencies, 0.77 of Nyquist, to some per cent; they carry little.
    assert height == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize("degrees", [-150.0, -60.0, 10.0, 90.0, 179.0])
def test_orientation_runs_counter_clockwise_from_x(degrees: float) -> None:
    angle = math.radians(degrees)
    stack = _airy_like(9.0 * math.cos(angle), 9.0 * math.sin(angle))[None]
    assert orientation_deg(stack) == pytest.approx([degrees], abs=0.1)


def test_a_lobe_at_the_edge_is_still_placed() -> None:
    """With one half of it missing, to the half pixel that no interpolation is needed for."""
    x, y, _ = main_lobe_px(_airy_like(-24.0, 3.0))
    assert x == pytest.approx(-24.0, abs=0.5) and y == pytest.approx(3.0, abs=0.05)


def test_a_window_too_small_for_a_spline_gives_the_brightest_pixel() -> None:
    assert main_lobe_px(np.array([[0.0, 1.0], [0.0, 0.0]])) == (0.0, -1.0, 1.0)
