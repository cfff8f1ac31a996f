"""Six states of polarisation: Stokes vectors, handedness, and the power behind any Jones matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.core.polarisation import JONES, ORTHOGONAL, STATES, stokes_of, stokes_response


def complex_numbers() -> st.SearchStrategy[complex]:
    return st.complex_numbers(max_magnitude=3.0, allow_nan=False, allow_infinity=False)


def test_stokes_vectors_of_the_six_states_are_the_axes_of_the_sphere() -> None:
    expected = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    assert stokes_of(JONES)[:, 1:] == pytest.approx(np.array(expected, dtype=float), abs=1e-12)


def test_orthogonal_states_share_no_power() -> None:
    assert np.sum(JONES.conj() * JONES[list(ORTHOGONAL)], axis=1) == pytest.approx(np.zeros(6), abs=1e-12)


def test_right_handed_light_turns_clockwise_for_who_looks_into_it() -> None:
    """With exp(-i omega t), a quarter of a period later the field has turned from +x to -y (y up, light towards us)."""
    later = (JONES[STATES.index("R")] * np.exp(-0.5j * np.pi)).real
    assert later == pytest.approx([0.0, -np.sqrt(0.5)], abs=1e-12)


@given(st.lists(complex_numbers(), min_size=6, max_size=6))
def test_the_response_is_the_power_of_any_light_behind_any_jones_matrix(numbers: list[complex]) -> None:
    jones, light = np.array(numbers[:4]).reshape(2, 2), np.array(numbers[4:])
    response = stokes_response(jones[0, 0], jones[0, 1], jones[1, 0], jones[1, 1])
    power = float(np.sum(np.abs(jones @ light) ** 2))
    assert response @ stokes_of(light) == pytest.approx(power, rel=1e-9, abs=1e-9)
