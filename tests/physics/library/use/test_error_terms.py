"""The index' uncertainty against the closed form of a film, and its common phase that does not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.library.library import Library
from metafab.library.use.error_terms import index_phase_error_rad, phase_rms_rad


def _with_error(library: Library, n_error: float) -> Library:
    materials = replace(
        library.unit_cell.materials, pillar=replace(library.unit_cell.materials.pillar, n_error=n_error)
    )
    sweep = replace(library.unit_cell.sweep, target_error=2e-2)
    return replace(library, unit_cell=replace(library.unit_cell, materials=materials, sweep=sweep))


def test_an_index_without_a_stated_uncertainty_has_no_error(smooth_library: Library) -> None:
    """Unknown is not zero."""
    assert index_phase_error_rad(_with_error(smooth_library, 0.0)) is None


def test_the_error_grows_with_the_uncertainty_and_stays_below_a_solid_film(smooth_library: Library) -> None:
    small, large = (index_phase_error_rad(_with_error(smooth_library, e), samples=6) for e in (0.005, 0.01))
    assert small is not None and large is not None
    # To first order in n the phase is linear; resonances near a sample bend it.
    assert large == pytest.approx(2.0 * small, rel=0.3)
    # One pass through 600 nm of solid silicon turns the phase by 2 pi / 800 * 600 * 0.01 = 0.047 rad.
    assert 0.0 < large < 0.047 * 3.0


def test_a_phase_that_all_sizes_share_is_no_error() -> None:
    t = np.exp(1j * np.linspace(0.0, 5.0, 20)).reshape(10, 2)
    assert phase_rms_rad(t, t * np.exp(0.7j)) == pytest.approx(0.0, abs=1e-12)
    assert phase_rms_rad(t, t * np.exp(1j * np.array([[0.7, -0.2]]))) == pytest.approx(0.0, abs=1e-12)
    wobble = np.tile([[0.1], [-0.1]], (5, 2))
    assert phase_rms_rad(t, t * np.exp(1j * wobble)) == pytest.approx(0.1, rel=1e-12)
