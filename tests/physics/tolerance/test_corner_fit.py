"""Corners of a closed form whose resonance moves by most of its width."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library import Library
from metafab.library.surface import SizeResponse
from metafab.tolerance.corner_fit import fitted_amplitudes
from metafab.tolerance.corners import MaskSizes, changed_amplitudes


def _one(along: FloatArray, across: FloatArray, half_width_nm: float) -> ComplexArray:
    """Amplitude of light polarised along a side: a growing phase and a ridge that crosses the plane of sizes."""
    distance_nm = along + 0.4 * across - 250.0
    phase = 0.02 * along + 0.005 * across
    return np.exp(1j * phase) * (1.0 - 0.9j * half_width_nm / (distance_nm + 1j * half_width_nm))


def _both(width: FloatArray, length: FloatArray, half_width_nm: float = 8.0) -> ComplexArray:
    return np.stack([_one(width, length, half_width_nm), _one(length, width, half_width_nm)], axis=1)


def _surface(width_nm: FloatArray, length_nm: FloatArray) -> SizeResponse:
    t = _both(width_nm, length_nm)
    return SizeResponse(t[:, 0], t[:, 1], np.zeros(len(t)))


def _library(model: Callable[[FloatArray, FloatArray], ComplexArray] | None = None) -> Library:
    side = np.linspace(100.0, 250.0, 31)
    return cast(Library, SimpleNamespace(width_nm=side, length_nm=side, surface=_surface, model=model))


def test_a_ridge_that_moves_and_widens() -> None:
    """What remains is the widening, to first order; the stated error bounds that of sizes that were not solved.

    Of sixteen samples, leave-one-out errors are 0.89 (this one) to 1.16 of the true ones, the stated ones 1.01 to 1.30.
    """
    sizes = np.random.default_rng(0).uniform(112.0, 238.0, (600, 2))
    shrunk = sizes - 6.0 - 0.02 * (sizes - 175.0)
    true = _both(*shrunk.T, half_width_nm=8.4) * np.exp(0.3j - 0.05 * sizes.mean(axis=1, keepdims=True) / 175.0)
    sample = np.random.default_rng(4).choice(600, 56, replace=False)
    others = np.setdiff1d(np.arange(600), sample)
    fitted, stated = fitted_amplitudes(_library(), sizes, sample, true[sample], [(0, 1)])
    missed = float(np.linalg.norm((fitted - true)[others]) / np.linalg.norm(true[others]))
    changed = float(np.linalg.norm((_both(*sizes.T) - true)[others]) / np.linalg.norm(true[others]))
    assert missed < 0.05 * changed, (missed, stated, changed)
    assert missed < stated < 2.0 * missed, (missed, stated, changed)


def test_sizes_beyond_the_sweep_follow_the_model_of_the_library() -> None:
    """With the surface at the end of the sweep in place of the model, 0.011 is missed and 0.115 stated."""
    sizes = np.random.default_rng(0).uniform(92.0, 238.0, (600, 2))
    true = _both(*(sizes - 4.0).T, half_width_nm=8.4)
    sample = np.random.default_rng(4).choice(600, 56, replace=False)
    fitted, stated = fitted_amplitudes(_library(_both), sizes, sample, true[sample], [(0, 1)])
    others = np.setdiff1d(np.arange(600), sample)
    missed = float(np.linalg.norm((fitted - true)[others]) / np.linalg.norm(true[others]))
    assert missed < stated < 2.0e-4, (missed, stated)


def test_what_the_solver_misses_with_and_without_the_change_is_no_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metafab.tolerance.corners.swaps_polarisations", lambda library: True)
    drawn = np.random.default_rng(0).uniform(112.0, 238.0, (100, 2))
    t, true, sample = _both(*drawn.T), _both(*(drawn - 4.0).T), np.arange(56)
    sizes = MaskSizes(np.arange(100), drawn, np.ones(100), t, sample, np.full(100, 100))
    missed = 0.9 * np.exp(0.2j)
    fitted, _ = sizes._fitted(_library(), missed * t[sample], missed * true[sample])
    assert np.linalg.norm(fitted - true) < 0.02 * np.linalg.norm(true)


def test_an_amplitude_near_zero_before_the_change_does_not_raise_the_error_of_the_solver() -> None:
    """A pillar of silicon nitride in its resonance: 0.0116 by the library, 2e-5 by the solver, 1.16 at the corner."""
    t = np.array([[0.0116, 1.2], [1.1, 1.2]], dtype=np.complex128)
    before = np.array([[2e-5, 1.2], [1.1, 1.2]], dtype=np.complex128)
    after = np.array([[1.16, 1.0], [1.0, 0.7]], dtype=np.complex128)
    factor = np.array([2.0j, 0.5])
    changed, missed = changed_amplitudes(factor * t, before, after)
    np.testing.assert_allclose(changed / factor, after, atol=0.0117)
    np.testing.assert_allclose(missed / np.abs(factor), [[0.0116, 0.0], [0.0, 0.0]], atol=2e-4)


def test_the_stated_error_of_solved_sizes_holds_their_resonances() -> None:
    sizes = MaskSizes(
        np.arange(2),
        np.array([[150.0, 150.0], [200.0, 200.0]]),
        np.array([3.0, 1.0]),
        np.array([[0.02, 1.0], [1.0, 1.0]], dtype=np.complex128),
        np.arange(2),
        np.array([0, 1]),
    )
    before = np.array([[1e-6, 1.0], [1.0, 1.0]], dtype=np.complex128)
    fitted, error = sizes._fitted(_library(), before, np.ones((2, 2), dtype=np.complex128))
    assert np.abs(fitted).max() < 1.03
    assert error == pytest.approx(0.02 * np.sqrt(3.0 / 5.0), rel=0.01)
