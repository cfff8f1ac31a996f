"""Every few pixels of an image, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.registration.downsampling import Downsampling, enlarged, repeated


def enlarged_plain(values: np.ndarray, step: int, shape: tuple[int, int]) -> np.ndarray:
    """Linear interpolation along one axis after the other."""
    for axis, count in enumerate(shape):
        before = np.moveaxis(values, axis, 0)
        after = np.concatenate([before[1:], before[-1:]])
        fine = np.empty((step * before.shape[0], *before.shape[1:]), dtype=values.dtype)
        for k in range(step):
            fine[k::step] = before if k == 0 else (1.0 - k / step) * before + (k / step) * after
        values = np.moveaxis(fine[:count], 0, axis)
    return values


def wave(row: np.ndarray, column: np.ndarray, ky: float, kx: float) -> np.ndarray:
    return np.cos(2.0 * np.pi * (ky * row + kx * column))


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_downsampling_keeps_slow_waves_and_nothing_faster(step: int) -> None:
    """Away from the fading margin a slow wave keeps its amplitude; one that would look like another is gone."""
    downsampling = Downsampling(step, (90, 118), 12)
    i, j = np.mgrid[-12:102, -12:130].astype(float)
    for k, share in ((0.02, 1.0), (0.3 / step, 1.0), (0.75 / step, 0.0)):
        if k >= 0.5:
            continue
        images = np.stack([wave(i, j, k, 0.0), 5.0 + wave(i, j, 0.0, k)]).astype(np.float32)
        small = downsampling.images(downsampling.spectra(images))[:, *downsampling.inner]
        assert small.shape[1:] == downsampling.shape == (-(-90 // step), -(-118 // step))
        inner = slice(12 // step, small.shape[1] - 12 // step)
        want = np.stack([share * wave(i, j, k, 0.0), 5.0 + share * wave(i, j, 0.0, k)])[:, 12:102:step, 12:130:step]
        # The margin's fall from 1 to 0 and the step behind it ring: a few per cent, a margin away.
        np.testing.assert_allclose(small[:, inner, inner], want[:, inner, inner], atol=0.05)


def test_a_downsampled_pixel_has_the_noise_it_says() -> None:
    downsampling = Downsampling(3, (240, 240), 12)
    images = np.random.default_rng(5).normal(size=(2, 264, 264)).astype(np.float32)
    small = downsampling.images(downsampling.spectra(images))[:, *downsampling.inner]
    # 12800 pixels: 1.2 % for the variance; the row and column of the highest frequency are left out, 2 / 88.
    assert small.var() == pytest.approx(downsampling.variance_gain, rel=0.06)


@settings(max_examples=40, deadline=None)
@given(n_y=st.integers(1, 30), n_x=st.integers(1, 30), step=st.sampled_from([1, 2, 3, 4]))
def test_enlarging_meets_the_small_pixels(n_y: int, n_x: int, step: int) -> None:
    small = np.random.default_rng(n_y * 31 + n_x).normal(size=(-(-n_y // step), -(-n_x // step)))
    for large in (enlarged(small, step, (n_y, n_x)), repeated(small, step, (n_y, n_x))):
        assert large.shape == (n_y, n_x)
        np.testing.assert_allclose(large[::step, ::step], small)


def test_enlarging_is_linear_in_between() -> None:
    small = np.array([[0.0, 2.0], [4.0, 6.0]])
    np.testing.assert_allclose(enlarged(small, 2, (3, 3)), [[0.0, 1.0, 2.0], [2.0, 3.0, 4.0], [4.0, 5.0, 6.0]])
    np.testing.assert_allclose(enlarged(small, 4, (1, 5)), [[0.0, 0.5, 1.0, 1.5, 2.0]])


@pytest.mark.parametrize("step", [1, 2, 3, 4])
@pytest.mark.parametrize("shape", [(23, 40), (5, 3), (1, 9)])
def test_compiled_enlarging_is_the_plain_one(step: int, shape: tuple[int, int]) -> None:
    small = np.random.default_rng(6).random(tuple(-(-n // step) for n in shape))
    np.testing.assert_allclose(enlarged(small, step, shape), enlarged_plain(small, step, shape)[: shape[0], : shape[1]])
    again = repeated(small, step, shape)
    assert again.shape == shape
    assert (again[::step, ::step] == small).all()
    assert not np.shares_memory(again, small)
