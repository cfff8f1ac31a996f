"""Information of twin images: nuisance parameters, and the scatter of the best estimate."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.information.psf_stacks import depth_crlb_m
from metafab.information.twin_images import twin_information


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
