"""Bilinear interpolation on a centred grid against SciPy's, and outside the grid."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from metafab.core.numeric.bilinear import bilinear_on_grid

RNG = np.random.default_rng(1)
SAMPLES = RNG.normal(size=(5, 8)) + 1j * RNG.normal(size=(5, 8))
ROWS, COLUMNS = np.arange(5) - 2.0, np.arange(8) - 3.5


def test_it_agrees_with_scipy_inside_the_grid() -> None:
    x, y = RNG.uniform(-3.5, 3.5, 11), RNG.uniform(-2.0, 2.0, 7)
    expected = RegularGridInterpolator((ROWS, COLUMNS), SAMPLES)(np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1))
    np.testing.assert_allclose(bilinear_on_grid(SAMPLES, x, y), expected, atol=1e-13)


def test_samples_are_met_and_the_border_is_held() -> None:
    np.testing.assert_allclose(bilinear_on_grid(SAMPLES, COLUMNS, ROWS), SAMPLES, atol=1e-15)
    beyond = bilinear_on_grid(SAMPLES.real, np.array([-9.0, 3.5, 40.0]), np.array([2.0, 7.0]))
    np.testing.assert_allclose(beyond, np.tile(SAMPLES.real[-1, [0, -1, -1]], (2, 1)), atol=1e-15)
