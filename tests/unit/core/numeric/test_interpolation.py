"""Weights of interpolating splines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from metafab.core.numeric.interpolation import bilinear_on_grid, spline_weights

RNG = np.random.default_rng(1)
SAMPLES = RNG.normal(size=(5, 8)) + 1j * RNG.normal(size=(5, 8))
ROWS, COLUMNS = np.arange(5) - 2.0, np.arange(8) - 3.5


@given(st.integers(1, 9), st.floats(-2.0, 2.0))
def test_spline_weights_sum_to_one_and_interpolate(count: int, at: float) -> None:
    nodes = np.sort(np.cos(np.arange(count) * 1.3)) if count > 1 else np.zeros(1)
    assert spline_weights(nodes, at).sum() == pytest.approx(1.0, abs=1e-9)
    assert spline_weights(nodes, nodes) == pytest.approx(np.eye(count), abs=1e-9)


def test_it_agrees_with_scipy_inside_the_grid() -> None:
    x, y = RNG.uniform(-3.5, 3.5, 11), RNG.uniform(-2.0, 2.0, 7)
    expected = RegularGridInterpolator((ROWS, COLUMNS), SAMPLES)(np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1))
    np.testing.assert_allclose(bilinear_on_grid(SAMPLES, x, y), expected, atol=1e-13)


def test_samples_are_met_and_the_border_is_held() -> None:
    np.testing.assert_allclose(bilinear_on_grid(SAMPLES, COLUMNS, ROWS), SAMPLES, atol=1e-15)
    beyond = bilinear_on_grid(SAMPLES.real, np.array([-9.0, 3.5, 40.0]), np.array([2.0, 7.0]))
    np.testing.assert_allclose(beyond, np.tile(SAMPLES.real[-1, [0, -1, -1]], (2, 1)), atol=1e-15)
