"""Highlights and broken pixels of a tile: no tails, all of their light, and nothing else changed."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from metafab.core.conventions import FloatArray
from metafab.core.numeric.spectra import transfer_functions
from metafab.decode.images.highlights import SeparatedTile, one_depth_each, separated
from metafab.decode.matching.levels import Levels

SIDE, LEVEL_E, LIMIT_E = 96, 3000.0, 12000.0
LEVELS = Levels(LEVEL_E, LEVEL_E, 0.2 * LEVEL_E, 2.0)
SPOTS = ((30, 40), (60, 28), (52, 70))


def transfer() -> NDArray[np.complex64]:
    """A pair of unlike lobes, 5 pixels to either side."""
    kernel = np.zeros((33, 33))
    kernel[16 - 4, 16 + 3], kernel[16 + 4, 16 - 3] = 0.7, 0.3
    return np.asarray(transfer_functions(gaussian_filter(kernel, 1.2), (SIDE, SIDE)), dtype=np.complex64)


def ratio() -> NDArray[np.float32]:
    ky, kx = scipy.fft.fftfreq(SIDE)[:, None], scipy.fft.rfftfreq(SIDE)[None, :]
    share = LEVELS.noise_variance / LEVELS.texture_spectrum(ky * ky + kx * kx)
    share[0, 0] = 0.0
    return share.astype(np.float32)


def scene(brightness: float) -> FloatArray:
    texture = gaussian_filter(np.random.default_rng(3).normal(size=(SIDE, SIDE)), 1.5, mode="wrap")
    light = LEVEL_E * (1.0 + 0.2 * texture / texture.std())
    for row, column in SPOTS:
        light[row - 1 : row + 2, column - 1 : column + 2] += brightness * LEVEL_E
    return np.asarray(light)


def exposed(light: FloatArray) -> FloatArray:
    blurred = scipy.fft.irfft2(scipy.fft.rfft2(light) * transfer(), light.shape)
    return np.random.default_rng(4).poisson(np.maximum(blurred, 0.0)).astype(np.float64)


def wiener(spectrum: NDArray[np.complexfloating]) -> FloatArray:
    h = transfer()
    return np.asarray(scipy.fft.irfft2(np.conj(h) / (np.abs(h) ** 2 + ratio()) * spectrum, (SIDE, SIDE)))


def parted(frame: FloatArray, broken: NDArray[np.bool_]) -> SeparatedTile | None:
    spectrum = scipy.fft.rfft2(frame).astype(np.complex64)
    return separated(spectrum, transfer(), ratio(), broken, LEVELS.noise_variance, LEVEL_E)


def test_clipped_highlights_leave_no_tails() -> None:
    light = scene(30.0)
    frame = exposed(light)
    broken = frame >= LIMIT_E
    clipped = np.minimum(frame, LIMIT_E)
    found = parted(clipped, broken)
    assert found is not None
    away = distance_transform_edt(light < 5.0 * LEVEL_E)
    near, elsewhere = (away > 3.0) & (away < 16.0), away > 24.0
    tails = [
        np.abs(sharp - light)[near].mean() / np.abs(sharp - light)[elsewhere].mean()
        for sharp in (wiener(scipy.fft.rfft2(clipped)), wiener(found.spectrum) + found.light)
    ]
    # Beside a highlight, photon noise is larger: 1.1 with the true highlights taken off.
    assert tails[0] > 5.0
    assert tails[1] < 1.6
    assert found.light.sum() == pytest.approx(30.0 * LEVEL_E * 9 * len(SPOTS), rel=0.1)


def test_a_dead_pixel_is_filled_in_within_noise() -> None:
    frame = exposed(scene(0.0))
    broken = np.zeros(frame.shape, dtype=bool)
    broken[::16, ::16] = True
    dead = np.where(broken, 0.0, frame)
    found = parted(dead, broken)
    assert found is not None
    assert not found.light.any()
    filled = scipy.fft.irfft2(found.spectrum, frame.shape)
    np.testing.assert_allclose(filled[~broken], frame[~broken], atol=1e-2)
    # Its own noise, and that of the neighbours from which it is filled in.
    assert np.std((filled - frame)[broken]) < 2.0 * np.sqrt(LEVEL_E)


def test_pixels_that_touch_are_solved_at_the_depth_of_most_of_them() -> None:
    broken = np.array([[1, 1, 0, 0, 1], [0, 0, 1, 0, 1], [0, 0, 0, 0, 0], [1, 1, 0, 1, 1]], dtype=bool)
    label = np.array([[1, 2, 1, 1, 2], [1, 1, 2, 1, 1], [1, 1, 1, 1, 1], [0, 2, 1, 3, 3]], dtype=np.int32)
    # Two of three at depth 2, across a corner; a tie goes to the first; none has no vote, nor has 3, whose pixels are
    # beyond the core.
    want = [[2, 2, 0, 0, 1], [0, 0, 2, 0, 1], [0, 0, 0, 0, 0], [2, 2, 0, 0, 0]]
    np.testing.assert_array_equal(one_depth_each(broken, label, np.array([1, 2])), want)


def test_an_overexposed_surface_stays_as_it_is() -> None:
    assert parted(np.full((SIDE, SIDE), LIMIT_E), np.ones((SIDE, SIDE), dtype=bool)) is None


def test_a_large_hole_is_filled_with_finite_light() -> None:
    frame = exposed(scene(0.0))
    broken = np.zeros(frame.shape, dtype=bool)
    broken[30:54, 40:64] = True
    found = parted(np.where(broken, 0.0, frame), broken)
    assert found is not None
    filled = scipy.fft.irfft2(found.spectrum, frame.shape)[broken]
    # In its middle nothing is known but the texture's spectrum, whose longest waves go on.
    assert filled.mean() == pytest.approx(LEVEL_E, rel=0.2)
