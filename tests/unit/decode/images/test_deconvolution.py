"""The Wiener filter of a tile."""

from __future__ import annotations

import numpy as np

from metafab.decode.images.deconvolution import wiener_filter


def test_the_wiener_filter_and_its_gain_are_those_of_plain_numpy() -> None:
    rng = np.random.default_rng(2)
    transfer, spectra = (rng.normal(size=(2, 2, 4, 3)) + 1j * rng.normal(size=(2, 2, 4, 3))).astype(np.complex64)
    ratio = rng.random((4, 3)).astype(np.float32)
    wiener = np.conj(transfer) / (np.abs(transfer) ** 2 + ratio)
    got, gain = wiener_filter(transfer, spectra, ratio)
    np.testing.assert_allclose(got, wiener * spectra, rtol=1e-4, atol=1e-6)
    # Parseval: the first and last column stand for themselves, the one between for two.
    squares = np.abs(wiener) ** 2
    np.testing.assert_allclose(gain, (squares @ np.array([1.0, 2.0, 1.0])).sum(axis=-1) / 16.0, rtol=1e-4)
