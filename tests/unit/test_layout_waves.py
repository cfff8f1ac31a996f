"""Sums of waves by panels, as the mapping evaluates them, against the sums themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import metafab.phase.terms.helices as module
from metafab.core.conventions import wrap_phase
from metafab.phase import WaveSumPhase
from metafab.phase.terms.angles import INTERPOLATION_ERROR

RADIUS_UM = 1000.0
SITES_UM = 0.35 * (np.arange(90) - 44.5)


def _waves(seed: int, count: int, defocus_rad: float, tilt_rad: float) -> WaveSumPhase:
    rng = np.random.default_rng(seed)
    amplitude = rng.normal(size=count) + 1j * rng.normal(size=count)
    return WaveSumPhase(
        RADIUS_UM,
        amplitude,
        rng.uniform(-defocus_rad, defocus_rad, count),
        rng.uniform(-tilt_rad, tilt_rad, (count, 2)),
    )


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 10**6), st.integers(1, 30), st.floats(0.0, 300.0), st.floats(0.0, 100.0),
    st.floats(-0.95, 0.95), st.floats(-0.95, 0.95),
)  # fmt: skip
def test_a_tile_keeps_the_stated_error_wherever_it_stands(
    seed: int, count: int, defocus_rad: float, tilt_rad: float, x: float, y: float
) -> None:
    term = _waves(seed, count, defocus_rad, tilt_rad)
    x_um, y_um = x * RADIUS_UM + SITES_UM, y * RADIUS_UM + SITES_UM
    for polarisation, sign in (("x", 1.0), ("y", -1.0)):
        field = term.field(sign * x_um / RADIUS_UM, sign * y_um / RADIUS_UM)
        error = wrap_phase(term(x_um, y_um, polarisation) - np.angle(field))  # type: ignore[arg-type]
        # An error of the sum turns its phase by at most its arc sine; rounding of phases of up to 400 rad comes on top.
        bound = np.minimum(1.0, (INTERPOLATION_ERROR + 1e-12) * np.abs(term.amplitude).sum() / np.abs(field))
        assert np.all(np.abs(error) <= np.arcsin(bound) * (1.0 + 1e-6) + 2e-11 + (bound == 1.0) * np.pi)


def test_phases_of_the_papers_lens_are_right_to_a_ten_thousandth_of_a_radian() -> None:
    term = _waves(5, 24, 12.0, 3.7)
    x_um = np.linspace(-999.0, 999.0, 301)
    field = term.field(x_um / RADIUS_UM, x_um / RADIUS_UM)
    error = np.abs(wrap_phase(term(x_um, x_um, "x") - np.angle(field)))
    assert np.abs(field).min() < 0.01 * np.abs(field).max()  # vortices are among them
    assert error.max() < 1e-4


def test_a_site_has_the_same_phase_in_whatever_tile_it_is_asked_for() -> None:
    term = _waves(7, 24, 12.0, 3.7)
    y_um = 0.35 * np.arange(-1500, 1500, 7)
    whole = term(SITES_UM, y_um, "x")
    for first, last in ((0, 50), (31, 200), (199, 429)):
        # The matrix product rounds as its shape asks, no more.
        np.testing.assert_allclose(wrap_phase(term(SITES_UM, y_um[first:last], "x") - whole[first:last]), 0, atol=1e-11)
    shuffled = np.random.default_rng(0).permutation(y_um.size)
    np.testing.assert_allclose(wrap_phase(term(SITES_UM, y_um[shuffled], "x") - whole[shuffled]), 0, atol=1e-11)


def test_beyond_the_aperture_and_without_numba_the_sum_itself_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    term = _waves(3, 5, 12.0, 3.7)
    inside_um, beyond_um = np.array([-400.0, 300.0]), np.array([-400.0, 300.0, 1500.0])
    field = term.field(beyond_um / RADIUS_UM, beyond_um / RADIUS_UM)
    np.testing.assert_allclose(term(beyond_um, beyond_um, "x"), np.angle(field), atol=2e-11)
    fast = term(inside_um, inside_um, "x")
    monkeypatch.setattr(module, "HAS_NUMBA", False)
    np.testing.assert_allclose(term(inside_um, inside_um, "x"), fast, atol=1e-6)
