"""Kernels of the pair stretched by a spline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from metafab.decode.registration.calibration import quintic_weights, stretched


@settings(max_examples=40, deadline=None)
@given(fraction=st.floats(0.0, 1.0), powers=st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_quintic_weights_are_the_splines(fraction: float, powers: list[float]) -> None:
    """They are positive, sum to 1, and give what SciPy's spline of the same coefficients gives at that place."""
    weights = quintic_weights(np.array(fraction))
    assert weights.min() >= -1e-15
    assert weights.sum() == pytest.approx(1.0)
    spline = BSpline(np.arange(12.0), np.array(powers), 5)
    assert weights @ np.array(powers) == pytest.approx(float(spline(5.0 + fraction)), abs=1e-9)


def test_a_stretched_kernel_keeps_its_light_and_its_shape() -> None:
    """A Gaussian of 4 pixels, stretched by 3 % and sheared: the closed form to 1e-4 of its peak."""
    y, x = np.mgrid[:48, :48] - 24.0
    kernel = np.exp(-0.5 * (x * x + y * y) / 16.0).astype(np.float32)
    stretch = np.array([[1.03, 0.02], [-0.01, 0.98]])
    got = stretched(kernel[None], stretch)[0]
    u, v = stretch[0, 0] * x + stretch[0, 1] * y, stretch[1, 0] * x + stretch[1, 1] * y
    want = np.exp(-0.5 * (u * u + v * v) / 16.0) * np.linalg.det(stretch)
    np.testing.assert_allclose(got, want, atol=1e-4)
    assert got.sum() == pytest.approx(kernel.sum(), rel=1e-3)
