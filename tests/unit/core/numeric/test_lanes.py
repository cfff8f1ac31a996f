"""Operations on lanes, against NumPy."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.lanes import (
    ELEMENT,
    LANES,
    copy,
    lane_array,
    subtract_dot,
    subtract_multiple,
    subtract_products,
    sum_terms,
)


@compiled
def _products(c: FloatArray, f: FloatArray, x: FloatArray, n: int) -> None:
    subtract_products(c, 1, f, 5, x, 3, n)


@compiled
def _multiple(c: FloatArray, f: FloatArray, x: FloatArray, n: int) -> None:
    subtract_multiple(c, 1, f, 5, x, 3, n)


@compiled
def _dot(c: FloatArray, f: FloatArray, x: FloatArray, n: int) -> None:
    subtract_dot(c, 1, f, 5, x, 3, n)


@compiled
def _copy(into: FloatArray, values: FloatArray, n: int) -> None:
    copy(into, 1, 3, values, 2, n)


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


def test_products_are_subtracted() -> None:
    rng = np.random.default_rng(1)
    c, f, x = (rng.normal(size=(12, LANES)) + 1j * rng.normal(size=(12, LANES)) for _ in range(3))
    for n in (5, 1, 0):
        products, multiple, dot = c.copy(), c.copy(), c.copy()
        products[1 : 1 + n] -= f[5 : 5 + n] * x[3 : 3 + n]
        multiple[1 : 1 + n] -= f[5] * x[3 : 3 + n]
        dot[1] -= np.sum(f[5 : 5 + n] * x[3 : 3 + n], axis=0)
        for subtract, expected in ((_products, products), (_multiple, multiple), (_dot, dot)):
            found = _lanes(c)
            subtract(found, _lanes(f), _lanes(x), n)
            assert np.abs(_values(found) - expected).max() < 1e-14


def test_elements_are_copied_in_steps() -> None:
    values = np.arange(12 * LANES).reshape(12, LANES) + 1j
    found = lane_array(12)
    _copy(found, _lanes(values), 4)
    assert np.array_equal(_values(found)[1::3], values[2:6])
    assert not np.delete(_values(found), np.s_[1::3], axis=0).any()


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
