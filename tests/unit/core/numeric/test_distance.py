"""Distances from sets of pixels: beside SciPy's, and by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from metafab.core.numeric.distance import box_about, distance, nearest


@settings(max_examples=60, deadline=None)
@given(
    n_y=st.integers(1, 24),
    n_x=st.integers(1, 24),
    share=st.sampled_from([0.005, 0.05, 0.3, 0.9, 1.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_nearest_is_what_trying_all_pixels_finds(n_y: int, n_x: int, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((n_y, n_x)) < share
    mask[rng.integers(n_y), rng.integers(n_x)] = True
    away, row, column = nearest(mask)
    i, j = np.indices(mask.shape)
    each = [np.hypot(i - y, j - x) for y, x in np.argwhere(mask)]
    assert np.allclose(away, np.min(each, axis=0))
    assert mask[row, column].all()
    assert np.allclose(np.hypot(row - i, column - j), away)


@pytest.mark.parametrize("shape", [(160, 320), (1, 500), (500, 1), (3, 3000)])
def test_distances_are_those_of_scipy(shape: tuple[int, int]) -> None:
    mask = np.random.default_rng(1).random(shape) < 0.003
    mask[0, 0] = True
    assert np.allclose(nearest(mask)[0], distance_transform_edt(~mask))
    assert distance(mask).dtype == np.float32


def test_no_pixel_is_near_an_empty_set() -> None:
    mask = np.zeros((4, 5), dtype=bool)
    away, row, column = nearest(mask)
    assert np.isinf(away).all()
    assert (row == np.arange(4)[:, None]).all()
    assert (column == np.arange(5)).all()


def test_the_box_about_a_mask_holds_what_is_near_and_nothing_more() -> None:
    mask = np.zeros((9, 12), dtype=bool)
    assert box_about(mask, 2) == (slice(0, 0), slice(0, 0))
    mask[4, 7] = mask[5, 2] = True
    near = distance(mask)[box_about(mask, 2)] <= 2.0
    assert near.sum() == (distance(mask) <= 2.0).sum()
    assert near[0].any()
    assert near[:, -1].any()
