"""Operations on lanes, against NumPy."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.lanes import ELEMENT, LANES, lane_array, subtract_products, sum_terms


@compiled
def _products(c: FloatArray, f: FloatArray, x: FloatArray, at: tuple[int, ...], step: tuple[int, ...], n: int) -> None:
    subtract_products(c, at[0], step[0], f, at[1], step[1], x, at[2], step[2], n)


@compiled
def _sums(values: FloatArray, first: int, coefficients: FloatArray, row: int, terms: FloatArray, term: int) -> None:
    sum_terms(values, first, coefficients, row, terms, term, len(coefficients) - row)


def _lanes(values: ComplexArray) -> FloatArray:
    """Lane array of values, shape (n, LANES)."""
    array = lane_array(len(values))
    array.reshape(-1, 2, LANES)[:] = np.stack([values.real, values.imag], axis=1)
    return array


def _values(array: FloatArray) -> ComplexArray:
    parts = array.reshape(-1, 2, LANES)
    return np.asarray(parts[:, 0] + 1j * parts[:, 1])


def test_products_are_subtracted_step_by_step() -> None:
    rng = np.random.default_rng(1)
    c, f, x = (rng.normal(size=(12, LANES)) + 1j * rng.normal(size=(12, LANES)) for _ in range(3))
    # Rows of a matrix, a scalar product, products of elements, backwards, and none at all.
    for steps, n in (((1, 0, 1), 5), ((0, 1, 1), 4), ((1, 1, 1), 6), ((2, -1, 1), 3), ((1, 1, 1), 0)):
        at, found, expected = (1, 5, 3), _lanes(c), c.copy()
        _products(found, _lanes(f), _lanes(x), at, steps, n)
        for k in range(n):
            into, left, right = (first + k * step for first, step in zip(at, steps, strict=True))
            expected[into] -= f[left] * x[right]
        assert np.abs(_values(found) - expected).max() < 1e-14


def test_sums_of_terms_fill_the_rows_asked_for() -> None:
    rng = np.random.default_rng(2)
    coefficients, terms = rng.normal(size=(7, 5, 2)), rng.normal(size=(11, LANES))
    found = lane_array(10)
    _sums(found, 3, coefficients, 2, terms, 4)
    expected = (coefficients[2:, :, 0] + 1j * coefficients[2:, :, 1]) @ terms[4:9]
    assert np.abs(_values(found)[3:8] - expected).max() < 1e-14
    assert not np.delete(_values(found), np.s_[3:8], axis=0).any()


def test_lanes_begin_with_a_cache_line() -> None:
    for count in (1, 3, 100):
        array = lane_array(count)
        assert array.shape == (count * ELEMENT,)
        assert array.ctypes.data % 64 == 0
        assert not array.any()
