"""The power spectrum of a texture."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from metafab.information.texture import Texture


def test_a_texture_has_the_variance_of_its_contrast() -> None:
    white = np.abs(scipy.fft.rfft2(np.random.default_rng(1).standard_normal((64, 64)))) ** 2
    coloured = scipy.fft.irfft2(np.sqrt(Texture(100.0, 0.3).half_power(64) * white), (64, 64))
    assert coloured.std() == pytest.approx(30.0, rel=0.35)  # a few low frequencies hold most of it


def test_the_half_spectrum_is_that_of_a_real_transform() -> None:
    frequency2 = scipy.fft.fftfreq(9)[:, None] ** 2 + scipy.fft.rfftfreq(9) ** 2
    half, whole = Texture().half_power(9), Texture().power((9, 9))
    falling = half * frequency2
    np.testing.assert_allclose(falling, np.where(frequency2 > 0.0, falling[0, 1], 0.0), rtol=1e-12)
    assert whole.mean() == pytest.approx((3000.0 * 0.25) ** 2, rel=1e-12)
    assert half.shape == (9, 5)
    np.testing.assert_array_equal(half, whole[:, :5])


def test_a_larger_extent_leaves_less_contrast_to_a_small_window() -> None:
    small, of_large = Texture().power((16, 16)), Texture().power((16, 16), (64, 64))
    assert of_large.mean() < small.mean()
    np.testing.assert_allclose(of_large / small.mean(), small / small.mean() * (of_large.mean() / small.mean()))
