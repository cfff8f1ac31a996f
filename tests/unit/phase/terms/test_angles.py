"""The compiled arctangent against the exact one, on the whole plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.phase.terms.angles import angle

PARTS = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e150, max_value=1e150)


@given(PARTS, PARTS)
def test_angles_are_those_of_the_exact_arctangent(real: float, imag: float) -> None:
    largest = max(abs(real), abs(imag))
    if 0.0 < largest < 1e-290:  # there the guard against 0 / 0 is no longer lost in the rounding
        return
    fast = angle(np.array([complex(real, imag)]))[0]
    exact = np.arctan2(imag, real) if imag else (np.pi if real < 0.0 else 0.0)
    assert fast == pytest.approx(exact, abs=1e-11)


def test_shapes_and_strides_are_kept() -> None:
    grid = np.exp(1j * np.linspace(-3.0, 3.0, 24)).reshape(2, 3, 4)
    for values in (grid, grid[:, ::2], grid.T, grid[:0]):
        np.testing.assert_allclose(angle(values), np.angle(values), atol=1e-11)
