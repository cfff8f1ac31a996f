"""exp(i phase) by polynomials, against NumPy's."""

import numpy as np
import pytest

from metafab.core.numeric.phasor import phasor


@pytest.mark.parametrize("largest_rad", [1.0, 1e2, 1e6])
def test_phasors_are_those_of_numpy(largest_rad: float) -> None:
    phase_rad = np.random.default_rng(1).uniform(-largest_rad, largest_rad, (30, 40))
    # Three roundings of 1.1e-16: of the reduced phase, of the last sum, and of the product with the sine's argument.
    assert phasor(phase_rad) == pytest.approx(np.exp(1j * phase_rad), abs=4e-16)


def test_large_phases_lose_no_more_than_their_own_rounding() -> None:
    phase_rad = np.random.default_rng(1).uniform(1e8, 1e9, 1000)
    assert np.all(np.abs(phasor(phase_rad) - np.exp(1j * phase_rad)) <= 2.0 * np.spacing(phase_rad))


def test_phasors_keep_the_shape_and_any_order_in_memory() -> None:
    phase_rad = np.linspace(0.0, 7.0, 24).reshape(4, 6).T
    assert np.allclose(phasor(phase_rad), np.exp(1j * phase_rad), rtol=0.0, atol=4e-16)
    assert phasor(np.array(0.0)).shape == ()
    assert np.isnan(phasor(np.array([np.inf]))).all()
