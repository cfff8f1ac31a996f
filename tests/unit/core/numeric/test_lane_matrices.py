"""Symmetric matrices on lanes, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.lane_matrices import add, invert_symmetric, multiply_symmetric
from metafab.core.numeric.lanes import LANES, lane_array


@compiled
def _solve(matrix: FloatArray, at: int, size: int, work: FloatArray, values: FloatArray, answer: FloatArray) -> None:
    """Write the sum of ``values`` and of -A^-1 ``values`` times -1, from element 1 on."""
    invert_symmetric(matrix, at, size, work)
    multiply_symmetric(matrix, at, values, 0, answer, 1, size)
    add(answer, 1, values, 0, size)


def _lanes(values: ComplexArray) -> FloatArray:
    """Lane array of values, shape (n, LANES)."""
    array = lane_array(len(values))
    array.reshape(-1, 2, LANES)[:] = np.stack([values.real, values.imag], axis=1)
    return array


@pytest.mark.parametrize("size", [1, 2, 5, 12])
def test_an_inverse_solves_its_equations(size: int) -> None:
    """Only the upper triangle counts, and elements before the matrix stay."""
    rng = np.random.default_rng(size)
    matrix = rng.normal(size=(LANES, size, size, 2)).view(np.complex128)[..., 0]
    matrix += matrix.transpose(0, 2, 1) + 4.0 * size * np.eye(size)
    values = rng.normal(size=(size, LANES, 2)).view(np.complex128)[..., 0]
    upper = np.triu(np.ones((size, size), dtype=bool))
    stored = np.where(upper, matrix, 0.0).transpose(1, 2, 0).reshape(-1, LANES)
    array = _lanes(np.concatenate([np.full((3, LANES), 7.0 + 1.0j), stored]))
    answer = lane_array(size + 1)
    _solve(array, 3, size, lane_array(4 * size), _lanes(values), answer)
    parts = answer.reshape(-1, 2, LANES)
    expected = np.linalg.solve(matrix, values.T[..., None])[..., 0].T + values
    np.testing.assert_allclose((parts[:, 0] + 1j * parts[:, 1])[1:], expected, rtol=1e-12, atol=1e-13)
    assert not parts[0].any()
    assert np.all(array.reshape(-1, 2, LANES)[:3] == [[7.0], [1.0]])
