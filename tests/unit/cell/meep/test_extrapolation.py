"""Richardson extrapolation on sequences whose limit is known."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.cell.meep.extrapolation import richardson, smoothed_limit


def test_richardson_finds_the_limit_of_its_own_model() -> None:
    h = np.array([4.0, 2.0, 4.0 / 3.0])
    value = np.array([0.4 - 0.2j, 1.0 + 0j])
    exact = [value + (0.1 + 0.05j) * x**2 - 0.002j * x**4 for x in h]
    found = richardson(h, exact)
    np.testing.assert_allclose(found.value, value, atol=1e-12)
    assert found.error > 0.0
    # Weights 0.0417, -1.0667 and 2.025 for grids in the ratio 1 : 2 : 3.
    assert found.gain == pytest.approx(1 / 24 + 16 / 15 + 81 / 40)


def test_richardson_states_an_error_that_covers_other_orders() -> None:
    """Corners of the pillar leave a rest that falls with a lower power than the model's."""
    h = np.array([4.0, 2.0, 4.0 / 3.0, 1.0])
    for power in (4.0 / 3.0, 1.5, 2.5, 3.0):
        samples = [np.array([1.0 + 0.1 * x**2 + 0.01j * x**power]) for x in h]
        for count in (2, 3, 4):
            found = richardson(h[:count], samples[:count])
            assert abs(found.value[0] - 1.0) < found.error


def test_richardson_refuses_what_it_cannot_extrapolate() -> None:
    with pytest.raises(ValueError, match="two or more"):
        richardson([1.0], [np.zeros(1, complex)])
    with pytest.raises(ValueError, match="descending"):
        richardson([1.0, 2.0], [np.zeros(1, complex)] * 2)


def test_plain_grids_have_a_limit_of_second_order_with_an_error_that_covers_their_irregularity() -> None:
    """Deviations of up to a fifth of c h^2, as of walls that cross pixels anywhere; exact without them."""
    h = 1.0 / np.array([12.0, 24.0, 36.0, 48.0])
    value, slope = np.array([0.4 - 0.2j, 1.0 + 0j]), np.array([3.0 + 1.0j, -2.0j])
    exact = smoothed_limit(h, [value + slope * x**2 for x in h])
    np.testing.assert_allclose(exact.value, value, atol=1e-12)
    assert exact.error == pytest.approx(np.abs(slope).max() * h[-1] ** 2)
    rng = np.random.default_rng(0)
    for _ in range(200):
        samples = [value + slope * x**2 * (1.0 + 0.2 * rng.uniform(-1.0, 1.0, 2)) for x in h]
        for count in (2, 3, 4):
            found = smoothed_limit(h[:count], samples[:count])
            assert np.abs(found.value - value).max() < found.error
    with pytest.raises(ValueError, match="two or more"):
        smoothed_limit([1.0], [np.zeros(1, complex)])
