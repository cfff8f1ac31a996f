"""Means over windows and sums over labels, against plain NumPy and SciPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_opening, maximum_filter, uniform_filter

from metafab.decode.matching.pooling import halved, label_sums, opened_by_square, smoothed, window_maxima, window_means


def halved_plain(pictures: np.ndarray) -> np.ndarray:
    """Every second pixel, smoothed by (1, 2, 1) / 4 along both axes."""
    for axis in (-2, -1):
        values = np.moveaxis(pictures, axis, 0)
        after = np.concatenate([values[1:], values[-1:]])
        before = np.concatenate([values[:1], values[:-1]])
        pictures = np.moveaxis(0.5 * values[::2] + 0.25 * (after[::2] + before[::2]), 0, axis)
    return pictures


@settings(max_examples=40, deadline=None)
@given(n_y=st.integers(1, 30), n_x=st.integers(1, 30), reach=st.integers(0, 9), seed=st.integers(0, 99))
def test_means_and_maxima_are_those_of_plain_filters(n_y: int, n_x: int, reach: int, seed: int) -> None:
    pictures = np.random.default_rng(seed).normal(size=(2, 3, n_y, n_x)).astype(np.float32)
    window = 2 * reach + 1
    want = uniform_filter(pictures, (0, 0, window, window), mode="reflect")
    np.testing.assert_allclose(window_means(pictures, window), want, atol=1e-5)
    np.testing.assert_allclose(halved(pictures), halved_plain(pictures), atol=1e-5)
    np.testing.assert_allclose(smoothed(pictures)[..., ::2, ::2], halved_plain(pictures), atol=1e-5)
    for picture in (pictures[0, 0], pictures[0, 0] > 1.0):
        np.testing.assert_array_equal(window_maxima(picture, window), maximum_filter(picture, window, mode="nearest"))


@settings(max_examples=40, deadline=None)
@given(n_y=st.integers(1, 30), n_x=st.integers(1, 30), reach=st.integers(0, 4), seed=st.integers(0, 99))
def test_openings_by_squares_are_scipys(n_y: int, n_x: int, reach: int, seed: int) -> None:
    mask, window = np.random.default_rng(seed).random((n_y, n_x)) < 0.95, 2 * reach + 1
    np.testing.assert_array_equal(
        opened_by_square(mask, window), binary_opening(mask, np.ones((window, window), dtype=bool))
    )


@settings(max_examples=25, deadline=None)
@given(n_y=st.integers(1, 9), n_x=st.integers(1, 9), count=st.integers(0, 4), seed=st.integers(0, 99))
def test_sums_by_label_are_sums_over_masks(n_y: int, n_x: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pictures = rng.normal(size=(3, n_y, n_x)).astype(np.float32)
    label = rng.integers(0, count + 1, (n_y, n_x)).astype(np.int32)
    want = [[picture[label == k].sum(dtype=np.float64) for k in range(1, count + 1)] for picture in pictures]
    got = label_sums(pictures, label, count)
    assert got.shape == (3, count)
    np.testing.assert_allclose(got, np.reshape(want, (3, count)), atol=1e-12)
