"""Weights of interpolating splines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.core.numeric.splines import spline_weights


@given(st.integers(1, 9), st.floats(-2.0, 2.0))
def test_spline_weights_sum_to_one_and_interpolate(count: int, at: float) -> None:
    nodes = np.sort(np.cos(np.arange(count) * 1.3)) if count > 1 else np.zeros(1)
    assert spline_weights(nodes, at).sum() == pytest.approx(1.0, abs=1e-9)
    assert spline_weights(nodes, nodes) == pytest.approx(np.eye(count), abs=1e-9)
