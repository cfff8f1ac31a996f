"""The power spectrum of a texture, and the error of its restoration against a Wiener filter on noisy pictures."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.fft

from metafab.core.conventions import FloatArray
from metafab.information.texture import Texture, restored_error

SIDE = 64


def test_a_texture_has_the_variance_of_its_contrast() -> None:
    white = np.abs(scipy.fft.rfft2(np.random.default_rng(1).standard_normal((64, 64)))) ** 2
    coloured = scipy.fft.irfft2(np.sqrt(Texture(electrons=100.0, contrast=0.3).half_power(64) * white), (64, 64))
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


def gaussian(width_px: float, share: float = 1.0) -> FloatArray:
    y, x = np.mgrid[-16:16, -16:16]
    kernel = np.exp(-0.5 * (x**2 + y**2) / width_px**2)
    return np.asarray(share * kernel / kernel.sum())


def test_the_error_is_that_of_a_wiener_filter_on_noisy_pictures() -> None:
    """Two images of one texture through unlike kernels, filtered by the Wiener filter: mean of 40 pictures."""
    electrons, contrast, kernels = 1000.0, 0.2, np.stack([gaussian(1.0), gaussian(2.5, 0.7)])
    power = Texture(electrons=electrons, contrast=contrast).half_power(SIDE)
    rng = np.random.default_rng(3)
    transfers = scipy.fft.rfft2(kernels, (SIDE, SIDE))
    noises = electrons * kernels.sum(axis=(1, 2))
    gain = (np.abs(transfers) ** 2 / noises[:, None, None]).sum(axis=0)
    lost = total = 0.0
    for _ in range(40):
        white = scipy.fft.rfft2(rng.standard_normal((SIDE, SIDE)))
        texture = white * np.sqrt(power)
        noisy = [
            texture * h + scipy.fft.rfft2(math.sqrt(noise) * rng.standard_normal((SIDE, SIDE)))
            for h, noise in zip(transfers, noises, strict=True)
        ]
        filtered = sum(h.conj() * image / noise for h, image, noise in zip(transfers, noisy, noises, strict=True))
        restored = scipy.fft.irfft2(filtered * power / (1.0 + power * gain), (SIDE, SIDE))
        true = scipy.fft.irfft2(texture, (SIDE, SIDE))
        lost, total = lost + float(((restored - true) ** 2).sum()), total + float((true**2).sum())
    expected = restored_error(kernels, Texture(electrons=electrons, contrast=contrast, read_noise_e=0.0), side_px=SIDE)
    assert math.sqrt(lost / total) == pytest.approx(expected, rel=0.03)


def test_a_second_image_helps_and_wider_blur_hurts() -> None:
    narrow, wide = gaussian(1.0)[None], gaussian(3.0)[None]
    errors = [
        restored_error(k, Texture(electrons=3000.0, contrast=0.25, read_noise_e=0.0))
        for k in (np.concatenate([narrow, wide]), narrow, wide)
    ]
    assert errors[0] < errors[1] < errors[2] < 1.0


def test_darkness_restores_nothing() -> None:
    assert restored_error(
        gaussian(1.0)[None] * 1e-12, Texture(electrons=1e-6, contrast=0.25, read_noise_e=2.0)
    ) == pytest.approx(1.0, abs=1e-6)
