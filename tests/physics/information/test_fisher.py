"""Information of twin images: nuisance parameters, and the scatter of the best estimate."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.information.fisher import (
    depth_crlb_m,
    depth_slope,
    point_information,
    twin_depth_information,
    twin_information,
)
from metafab.information.texture import PointSource, Texture

DEPTH_M = 1.0 / np.linspace(4.0, 2.0, 9)
X_UM = (np.arange(48) - 24.0) * 2.0


def test_an_unknown_contrast_takes_what_only_changes_brightness() -> None:
    transfer = np.ones((2, 8, 8), dtype=complex)
    slope = np.stack([np.zeros((8, 8)), np.full((8, 8), 0.3)]).astype(complex)
    snr = np.full((8, 8), 4.0)
    assert twin_information(transfer, slope, snr, contrast_known=True) > 1.0
    assert twin_information(transfer, slope, snr) == pytest.approx(0.0, abs=1e-12)


def test_the_scatter_of_the_best_estimate_is_the_bound() -> None:
    """Maximum likelihood over many noisy twin images: its standard deviation against 1/sqrt(information)."""
    random = np.random.default_rng(11)
    side, trials, snr = 16, 4000, 30.0
    k = 2 * np.pi * np.fft.fftfreq(side)
    transfer_angle = np.broadcast_to(k[None, :], (side, side)) * 1.0  # alpha = k_x * shift
    half = np.zeros((side, side), dtype=bool)
    half[1 : side // 2] = True  # one of each frequency and its negative, self-conjugate ones left out
    kx, draws = transfer_angle[half], (trials, int(half.sum()))

    def noise() -> np.ndarray:
        return (random.normal(size=draws) + 1j * random.normal(size=draws)) / np.sqrt(2.0)

    texture = np.sqrt(snr) * noise()
    image_x, image_y = texture + noise(), texture + noise()  # shift 0
    # The likelihood of a shift s is that of Re sum Y_x Y_y* exp(-2i k s): one Newton step from the truth.
    product = image_x * image_y.conj()
    estimate = (2 * kx * product.imag).sum(axis=1) / (4 * kx**2 * product.real).sum(axis=1)
    power = np.zeros((side, side))
    power[half] = snr
    transfer = np.ones((2, side, side), dtype=complex)
    slope = np.stack([1j * transfer_angle, -1j * transfer_angle])
    information = 2.0 * twin_information(transfer, slope, power)  # only one half carries power
    # 4000 draws give a standard deviation to 1.1 %.
    assert estimate.std() == pytest.approx(float(depth_crlb_m(information)), rel=0.035)


def _spot(x_um: FloatArray, y_um: FloatArray, sigma_um: float) -> FloatArray:
    """Gaussian spots, shape (n_depth, n_y, n_x), 1/um^2."""
    r2 = (X_UM[None, None, :] - x_um[:, None, None]) ** 2 + (X_UM[None, :, None] - y_um[:, None, None]) ** 2
    return np.exp(-r2 / (2 * sigma_um**2)) / (2 * np.pi * sigma_um**2)


def _moving_pair(um_per_dioptre: float = 3.0) -> FloatArray:
    """A conjugate pair that moves with vergence along x, in opposite senses."""
    shift = um_per_dioptre * (1.0 / DEPTH_M - 3.0)
    return np.stack([_spot(shift, 0 * shift, 5.0), _spot(-shift, 0 * shift, 5.0)])


def test_slopes_are_derivatives_with_respect_to_depth() -> None:
    stack = (1.0 / DEPTH_M)[:, None, None] ** 2 * np.ones((9, 2, 3))
    # Not-a-knot splines hold cubics in vergence exactly.
    np.testing.assert_allclose(depth_slope(stack, DEPTH_M)[:, 1, 2], -2.0 / DEPTH_M**3, rtol=1e-10)
    with pytest.raises(ValueError, match="depth_m"):
        depth_slope(stack[:3], DEPTH_M[:3])
    with pytest.raises(ValueError, match="ascending"):
        depth_slope(stack, DEPTH_M[::-1])


def test_a_moving_spot_in_a_strong_background_has_the_information_of_its_gradient() -> None:
    source = PointSource(electrons=1000.0, background_e=1e6, read_noise_e=100.0)
    information = point_information(_moving_pair(), DEPTH_M, 2.0, source)
    # sum (dI)^2 of a Gaussian spot moved by v: N^2 v^2 / (8 pi sigma^4) per um^2 of pixel, both polarisations.
    speed_um_per_m = 3.0 / DEPTH_M**2
    expected = 2 * 1000.0**2 * speed_um_per_m**2 * 2.0**2 / (8 * np.pi * 5.0**4) / (1e6 + 1e4)
    np.testing.assert_allclose(information, expected, rtol=2e-3)  # spline of 9 depths, and the spot's own noise


def test_an_unknown_position_removes_the_information_of_one_shifted_spot_but_not_of_a_pair() -> None:
    pair = _moving_pair()
    alone = pair.copy()
    alone[1] = 0.0
    source = PointSource()
    known = point_information(alone, DEPTH_M, 2.0, source)
    unknown = point_information(alone, DEPTH_M, 2.0, source, known=False)
    # np.gradient's second-order differences leave (pixel / sigma)^2 / 6 of the slope, squared.
    assert (unknown < 3e-3 * known).all()
    both = point_information(pair, DEPTH_M, 2.0, source)
    np.testing.assert_allclose(point_information(pair, DEPTH_M, 2.0, source, known=False), both, rtol=1e-6)


def test_a_pair_that_shifts_has_the_information_of_registration() -> None:
    """Two noisy pictures of one texture: the variance of their relative shift (Cramer-Rao), then depth by its speed."""
    texture = Texture(electrons=1000.0, contrast=0.3, exponent=1.0, read_noise_e=3.0)
    information = twin_depth_information(_moving_pair(), DEPTH_M, 2.0, texture)
    snr = texture.signal_to_noise((48, 48))
    k = 2 * np.pi * np.fft.fftfreq(48, 2.0)
    power = np.exp(-((k[:, None] ** 2 + k[None, :] ** 2) * 25.0)) * snr  # |O|^2 of the spot
    half = 0.5 * (8.0 * power**2 / (1.0 + 2.0 * power) * k[None, :] ** 2).sum()
    expected = half * (3.0 / DEPTH_M**2) ** 2
    np.testing.assert_allclose(information, expected, rtol=5e-3)  # spline of 9 depths


def test_symmetric_masks_and_single_images_tell_nothing_of_an_unknown_texture() -> None:
    widths = 4.0 + np.abs(1.0 / DEPTH_M - 3.0)
    lens = np.stack([np.concatenate([_spot(np.zeros(1), np.zeros(1), w) for w in widths])] * 2)
    helix = twin_depth_information(_moving_pair(), DEPTH_M, 2.0, Texture())
    assert (twin_depth_information(lens, DEPTH_M, 2.0, Texture()) < 1e-12 * helix).all()
    alone = _moving_pair()
    alone[1] = 0.0
    assert (twin_depth_information(alone, DEPTH_M, 2.0, Texture()) < 1e-12 * helix).all()
    # A point source, in contrast, shows the blur.
    assert point_information(lens, DEPTH_M, 2.0, PointSource())[0] > 0.0


def test_the_contrast_of_a_conjugate_pair_need_not_be_known() -> None:
    for known in (True, False):
        information = twin_depth_information(_moving_pair(), DEPTH_M, 2.0, Texture(), contrast_known=known)
        np.testing.assert_allclose(
            information, twin_depth_information(_moving_pair(), DEPTH_M, 2.0, Texture()), rtol=1e-9
        )


def test_no_information_means_no_bound() -> None:
    np.testing.assert_array_equal(depth_crlb_m([0.0, 4.0]), [np.inf, 0.5])
