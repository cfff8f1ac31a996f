"""Transfer functions of kernels, and the statistics of filtered noise."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft
from scipy.signal import fftconvolve

from metafab.core.numeric.spectra import convolved, independent_samples, transfer_functions


@pytest.mark.parametrize("shape", [(5, 8), (4, 7), (6, 6)])
def test_a_kernel_with_a_point_in_the_middle_changes_nothing(shape: tuple[int, int]) -> None:
    kernel = np.zeros((2, *shape), dtype=np.float32)
    kernel[:, shape[0] // 2, shape[1] // 2] = 1.0
    transfer = transfer_functions(kernel, (12, 10))
    assert transfer.shape == (2, 12, 6)
    assert transfer.dtype == np.complex64
    assert transfer == pytest.approx(np.ones_like(transfer))


def test_filtering_is_the_circular_convolution() -> None:
    rng = np.random.default_rng(0)
    kernel, picture = rng.standard_normal((5, 4)), rng.standard_normal((9, 10))
    filtered = scipy.fft.irfft2(transfer_functions(kernel, picture.shape) * scipy.fft.rfft2(picture), picture.shape)
    expected = sum(kernel[i, j] * np.roll(picture, (i - 2, j - 2), axis=(0, 1)) for i in range(5) for j in range(4))
    assert filtered == pytest.approx(expected)


def test_filtered_white_noise_has_the_stated_variance_and_samples() -> None:
    """Without a filter each pixel is a sample; a filter that keeps a quarter of the frequencies leaves a quarter."""
    size = (64, 64)
    assert independent_samples(np.ones((64, 33)), size) == pytest.approx((1.0, 1.0))
    weight = np.zeros((64, 33))
    weight[np.abs(scipy.fft.fftfreq(64)) < 0.25, :16] = 1.0
    samples, gain = independent_samples(weight, size)
    noise = np.random.default_rng(1).standard_normal((200, *size))
    filtered = scipy.fft.irfft2(scipy.fft.rfft2(noise) * weight, size)
    assert gain == pytest.approx(filtered.var(), rel=0.02)
    # The variance of a picture's mean square is 2 variance^2 over the number of independent samples.
    squares = (filtered**2).mean(axis=(1, 2))
    assert squares.var() == pytest.approx(2.0 * gain**2 / (samples * 64 * 64), rel=0.4)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_convolutions_are_scipys(dtype: type) -> None:
    rng = np.random.default_rng(3)
    picture, kernels = rng.random((17, 30)).astype(dtype), rng.random((2, 5, 9)).astype(dtype)
    whole = convolved(picture, kernels)
    assert whole.dtype == dtype
    np.testing.assert_array_equal(whole, fftconvolve(picture[None], kernels, axes=(-2, -1)))
