"""Peaks of the correlation over depth, and their standard errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.matching.cost_volume import correlation
from metafab.decode.matching.depth import (
    best_candidates,
    parabolic_peak,
    quartic_peak,
    spline_peaks,
    standard_error,
)
from metafab.decode.matching.pooling import window_means


@settings(max_examples=25, deadline=None)
@given(
    n_y=st.integers(1, 20),
    n_x=st.integers(1, 20),
    count=st.integers(3, 6),
    reach=st.integers(0, 4),
    seed=st.integers(0, 99),
)
def test_best_candidates_are_those_of_plain_means(n_y: int, n_x: int, count: int, reach: int, seed: int) -> None:
    parts = np.random.default_rng(seed).random((3, count, n_y, n_x)).astype(np.float32)
    parts[0] -= 0.5
    window = 2 * reach + 1
    best, around, largest_product = best_candidates(parts, window)
    # Candidates may be as good as each other to single precision.
    means = window_means(parts, window)
    agreement = correlation(means)
    inner = np.clip(agreement.argmax(axis=0), 1, count - 2)
    want_around = np.stack([np.take_along_axis(agreement, (inner + d)[None], axis=0)[0] for d in (-1, 0, 1)])
    chosen = np.take_along_axis(agreement, best[None], axis=0)[0]
    np.testing.assert_allclose(chosen, agreement.max(axis=0), atol=1e-5)
    np.testing.assert_allclose(largest_product, means[0].max(axis=0), atol=1e-5)
    same = best == agreement.argmax(axis=0)
    np.testing.assert_allclose(around[::2, same], want_around[:, same], atol=1e-4)


def test_a_spline_finds_what_a_parabola_misses() -> None:
    """A Gaussian of 2.5 steps: the parabola through three of its values is up to 0.01 steps off, the spline 5e-4."""
    true = np.linspace(3.0, 9.0, 41)
    values = np.exp(-0.5 * ((np.arange(13) - true[:, None]) / 2.5) ** 2)
    peak = spline_peaks(values)
    assert peak.inside.all()
    assert np.abs(peak.place - true).max() < 6e-4
    np.testing.assert_allclose(peak.height, 1.0, atol=1e-4)
    np.testing.assert_allclose(peak.curvature, 1.0 / 2.5**2, rtol=0.02)
    best = values.argmax(axis=1)
    below, at, above = (values[np.arange(41), best + d] for d in (-1, 0, 1))
    assert np.abs(best + parabolic_peak(below, at, above).place - true).max() > 3e-3


@pytest.mark.parametrize("width", [1.5, 2.5])
def test_a_narrow_peak_between_candidates_does_not_lean(width: float) -> None:
    """A Gaussian of 1.5 steps, as at the sides of a wide calibration: a parabola leans by 0.02 steps of 8 % of 1/z."""
    true = np.linspace(3.0, 9.0, 41)
    values = np.exp(-0.5 * ((np.arange(13) - true[:, None]) / width) ** 2)
    # One pixel is one window; the correlation is the product's, as both squares are 1.
    products = np.stack([values.T, np.ones_like(values.T), np.ones_like(values.T)])[:, :, :, None].astype(np.float32)
    best, around, _ = best_candidates(products, 1)
    peak = quartic_peak(around)
    assert np.abs(best + peak.place - true[:, None]).max() < 5e-3
    np.testing.assert_allclose(peak.height, 1.0, atol=2e-3)
    np.testing.assert_allclose(peak.curvature, 1.0 / width**2, rtol=0.05)
    best, (below, at, above) = best[:, 0], around[::2, :, 0]
    assert np.abs(best + parabolic_peak(below, at, above).place - true).max() > 3e-3


@pytest.mark.parametrize("count", [3, 4, 5, 13])
def test_a_peak_at_an_end_is_said(count: int) -> None:
    rising = np.arange(count, dtype=np.float64)[None]
    for values in (rising, -rising):
        assert not spline_peaks(values).inside.any()


def test_a_parabola_is_found() -> None:
    def value(at: float) -> float:
        return 0.9 - 0.2 * (at - 0.3) ** 2

    peak = parabolic_peak(*(np.array(value(d)) for d in (-1.0, 0.0, 1.0)))
    assert (peak.place, peak.height, peak.curvature) == pytest.approx((0.3, 0.9, 0.4))
    assert peak.inside


def test_errors_shrink_with_the_root_of_the_samples() -> None:
    one, four = (float(standard_error(np.array(0.8), np.array(2.0), n)) for n in (100.0, 400.0))
    assert one == pytest.approx(2.0 * four)
