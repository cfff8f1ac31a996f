"""Resampling by a windowed sinc, against waves and against a plain implementation."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.registration.resample import Resampler


def interpolated_rows(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Each row at its places, by a sinc of 8 taps under a Kaiser window, to the nearest of 512 fractions."""
    whole = np.floor(place).astype(np.intp)
    offset = np.arange(8) - 3 - np.floor((place - whole) * 512 + 0.5)[..., None] / 512
    taps = np.sinc(offset) * np.i0(4.5 * np.sqrt(np.maximum(1.0 - (offset / 4.0) ** 2, 0.0)))
    taps /= taps.sum(axis=-1, keepdims=True)
    columns = np.clip(whole[..., None] - 3 + np.arange(8), 0, image.shape[1] - 1)
    return np.einsum("ijk,ijk->ij", taps, image[np.arange(image.shape[0])[:, None, None], columns])


def wave(row: np.ndarray, column: np.ndarray, ky: float, kx: float) -> np.ndarray:
    return np.cos(2.0 * np.pi * (ky * row + kx * column))


@pytest.mark.parametrize(("ky", "kx"), [(0.0, 0.0), (0.05, 0.1), (0.2, -0.25), (0.3, 0.3)])
def test_a_wave_is_resampled_where_the_map_says(ky: float, kx: float) -> None:
    """Shift, stretch and shear as the paper's lens has them; the filter errs by 0.5 % up to 0.3 cycles a pixel."""
    i, j = np.mgrid[:40, :60].astype(float)
    row, column = 5.3 + 1.01 * i + 0.02 * j, 7.7 + 0.98 * j - 0.03 * i
    image = wave(*np.mgrid[:70, :90].astype(float), ky, kx).astype(np.float32)
    got = Resampler.of(row, column, image.shape)(image)
    # Two passes of 0.5 %, each to the nearest of 512 fractions (1e-3 pixels times a slope of 2).
    np.testing.assert_allclose(got, wave(row, column, ky, kx), atol=0.014)


def test_resampling_is_that_of_a_plain_implementation() -> None:
    rng = np.random.default_rng(1)
    image = rng.normal(size=(50, 60)).astype(np.float32)
    i, j = np.mgrid[:50, :60].astype(float)
    made = Resampler.of(i * 1.05 - 2.0 + 0.01 * j, j * 0.97 + 3.0 - 0.02 * i, image.shape)
    rows = image[made.first_row : made.first_row + made.column.shape[0]]
    along = interpolated_rows(rows, made.column).T
    np.testing.assert_allclose(made(image), interpolated_rows(along, made.row).T, atol=1e-5)
