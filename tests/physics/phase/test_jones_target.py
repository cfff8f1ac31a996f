"""Target Jones matrices: the nearest ones that lossless turned pillars can have."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.library.use.amplitudes import turned_jones
from metafab.phase.jones_target import nearest_unitary


@given(st.lists(st.complex_numbers(max_magnitude=3.0, allow_nan=False, allow_infinity=False), min_size=3, max_size=3))
def test_the_nearest_unitary_is_symmetric_unitary_and_no_turned_pillar_is_nearer(numbers: list[complex]) -> None:
    target = np.array(numbers)
    xx, xy, yy = nearest_unitary(target)
    unitary = np.array([[xx, xy], [xy, yy]])
    assert unitary @ unitary.conj().T == pytest.approx(np.eye(2), abs=1e-9)
    wanted = np.array([[target[0], target[1]], [target[1], target[2]]])
    phases, angle_deg = np.meshgrid(np.linspace(0, 2 * np.pi, 13), np.linspace(0, 180.0, 13))
    for shift in (0.3, 1.7, 4.0):
        lossless = np.stack([np.exp(1j * phases), np.exp(1j * (phases + shift))], axis=-1)
        other = turned_jones(lossless, angle_deg)
        distance = np.sum(np.abs(other - target) ** 2 * [1.0, 2.0, 1.0], axis=-1)
        assert np.linalg.norm(unitary - wanted) ** 2 <= distance.min() + 1e-9
