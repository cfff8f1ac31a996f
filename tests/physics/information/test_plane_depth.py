"""Depth of textured planes: likelihood and cepstrum against the truth, the bound against closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from metafab.camera.kernels import PairKernels
from metafab.comparison.study import photographed, plane_estimator
from metafab.core.conventions import FloatArray
from metafab.information.plane_depth import PlaneEstimator, frequency_weight, noise_bandwidth
from metafab.information.texture import Texture
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

DEPTH_M = 1.0 / np.linspace(400.0, 294.0, 13)
LIGHT = Scene(objects=(SceneObject(depth_m=1.0, texture_contrast=0.25),), photons_per_pixel=3000.0)
TEXTURE = Texture(electrons=3000.0, contrast=0.25, read_noise_e=2.0)


@pytest.fixture(scope="module")
def kernels() -> PairKernels:
    return PairKernels(helix_psf(DEPTH_M, window_px=32))


@pytest.fixture(scope="module")
def estimator(kernels: PairKernels) -> PlaneEstimator:
    return plane_estimator(kernels, 96, TEXTURE)


def pair_at(kernels: PairKernels, depth_m: float) -> FloatArray:
    return kernels.at_depth(depth_m)[:, 0, 0]


@pytest.mark.parametrize("depth_m", [0.0026, 0.00295, 0.0033])
def test_the_likeliest_depth_is_that_of_the_plane(
    kernels: PairKernels, estimator: PlaneEstimator, depth_m: float
) -> None:
    images = photographed(pair_at(kernels, depth_m), LIGHT, 0)
    assert images.shape == (2, 96, 96)
    # The bound is 0.1 % of a window without taper; a taper keeps a quarter of the area, and leaks add.
    assert estimator.likeliest(images) == pytest.approx(depth_m, rel=0.015)


def test_exchanged_images_have_another_depth(kernels: PairKernels, estimator: PlaneEstimator) -> None:
    """The depth is in the relation of the two: exchanged, they turn the other way."""
    images = photographed(pair_at(kernels, 0.0033), LIGHT, 0)
    assert abs(estimator.likeliest(images[::-1]) - 0.0033) > 0.0005


def test_the_bound_falls_with_light_and_is_large_for_a_psf_that_does_not_change(kernels: PairKernels) -> None:
    dim, bright = (
        plane_estimator(kernels, 96, Texture(electrons=e, read_noise_e=0.0)).bound_m(0.003, 0.25)
        for e in (300.0, 30000.0)
    )
    # Information grows with the light where the texture stands above the noise, with its square where it does not.
    assert 10.0 <= dim / bright <= 100.0
    still = helix_psf(np.full(5, 0.003))
    same = dataclasses.replace(still, depth_m=np.linspace(0.0025, 0.0034, 5))
    assert plane_estimator(PairKernels(same), 96, Texture(read_noise_e=0.0)).bound_m(0.003, 0.25) > 1.0


def test_the_likeliest_depth_reaches_the_bound(kernels: PairKernels, estimator: PlaneEstimator) -> None:
    """Periodic textures need no taper and receive no light from beyond the window: the case of Whittle's formula."""
    rng = np.random.default_rng(5)
    power = TEXTURE.half_power(96)
    index = 31
    true_m = float(estimator.depth_m[index])
    estimates = []
    for _ in range(80):
        white = np.fft.rfft2(rng.normal(size=(96, 96))) / 96.0
        noise = np.fft.rfft2(rng.normal(0.0, math.sqrt(TEXTURE.noise_variance_e2), (2, 96, 96))) / 96.0
        estimates.append(estimator.likeliest_of_spectra(estimator.transfer[index] * np.sqrt(power) * white + noise))
    untapered_m = estimator.bound_m(true_m, 0.25) / math.sqrt(noise_bandwidth(96))
    # The standard deviation of 80 is known to 8 %.
    assert np.std(estimates) / untapered_m == pytest.approx(1.0, abs=0.3)
    # Of windows cut from a larger picture, which are tapered, the bound stays below.
    cut = [estimator.likeliest(photographed(pair_at(kernels, true_m), LIGHT, n)) / true_m - 1.0 for n in range(30)]
    ratio = float(np.sqrt(np.mean(np.square(cut)))) / (estimator.bound_m(true_m, 0.25) / true_m)
    assert 1.0 < ratio < 3.0


def test_the_noise_bandwidth_of_a_hann_window() -> None:
    assert noise_bandwidth(96) == pytest.approx((35.0 / 18.0) ** 2, rel=1e-6)
    # Periodograms of white noise: the variance of their mean, over that of as many independent ones.
    rng = np.random.default_rng(2)
    taper = np.outer(*[np.sin(np.pi * (np.arange(32) + 0.5) / 32) ** 2] * 2)
    power = [np.abs(np.fft.fft2(rng.normal(size=(32, 32)) * taper)) ** 2 for _ in range(4000)]
    means = np.mean(power, axis=(1, 2))
    # Power at f and at -f is the same: half as many are independent.
    assert np.var(means) / np.mean(means) ** 2 * 32**2 / 2.0 == pytest.approx(noise_bandwidth(32), rel=0.1)


def test_two_equal_images_of_a_gaussian_texture_have_whittles_information() -> None:
    """A kernel that is only scaled by g: each frequency has (P g^2)' / (P g^2 + N / 2), closed form."""
    gains = np.linspace(1.0, 2.0, 9)
    psf = np.zeros((2, 9, 8, 8))
    psf[:, :, 4, 4] = gains / 2.4**2
    base = helix_psf(np.linspace(0.0025, 0.0034, 9), window_px=8)
    # Deltas narrower than a pixel are spread over it by the pixel's aperture: the sinc of its width.
    kernels = PairKernels(dataclasses.replace(base, psf=psf))
    estimator = plane_estimator(kernels, 32, Texture(electrons=1e6, read_noise_e=0.0))
    index = 30
    transfer = estimator.transfer[index, 0]
    slope = (estimator.transfer[index + 1, 0] - estimator.transfer[index - 1, 0]) / (
        estimator.depth_m[index + 1] - estimator.depth_m[index - 1]
    )
    power = estimator.texture.half_power(32)
    share = 2.0 * power * 2.0 * (transfer.conj() * slope).real / (2.0 * power * np.abs(transfer) ** 2 + 1e6)
    weight = frequency_weight(32)
    expected = (0.5 * float((weight * share**2).sum()) / noise_bandwidth(32)) ** -0.5
    assert estimator.bound_m(float(estimator.depth_m[index]), 0.25) == pytest.approx(expected, rel=1e-6)


def test_the_cepstrum_finds_the_turn_of_two_lobes() -> None:
    """Two points whose line turns by 90 degrees over the range, at 9 pixels from each other."""
    base = helix_psf(DEPTH_M, window_px=32)
    psf = np.zeros_like(base.psf)
    y, x = np.mgrid[-16:16, -16:16]
    for index, angle in enumerate(np.radians(np.linspace(20.0, 110.0, DEPTH_M.size))):
        for sign in (-4.5, 4.5):
            lobe = np.exp(-0.5 * ((x - sign * math.cos(angle)) ** 2 + (y - sign * math.sin(angle)) ** 2) / 1.2**2)
            psf[:, index] += lobe / lobe.sum() / 2.0 / base.pixel_um**2
    kernels = PairKernels(dataclasses.replace(base, psf=psf))
    estimator = plane_estimator(kernels, 96, TEXTURE)
    estimates = [estimator.by_cepstrum(photographed(pair_at(kernels, z), LIGHT, 1)) for z in (0.0027, 0.0032)]
    # A degree of turn is 0.3 % of depth; a ripple of 10 periods over the window turns by a few.
    assert estimates == pytest.approx([0.0027, 0.0032], rel=0.02)
