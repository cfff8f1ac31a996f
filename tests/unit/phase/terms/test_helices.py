"""Sums of waves, interpolated between panels, against the sums themselves."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.core.conventions import wrap_phase
from metafab.phase import (
    DoubleHelixPhase,
    WaveSumPhase,
)
from metafab.phase.terms.angles import INTERPOLATION_ERROR

RADIUS_UM = 1000.0
SITES_UM = 0.35 * (np.arange(90) - 44.5)

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
SMALL_UM = 100.0
ANGLE_RAD = 1e-11  # stated error of the compiled arctangent
WAVES = WaveSumPhase(
    SMALL_UM,
    np.array([1.0 + 0.5j, -0.3j, 0.7]),
    np.array([-2.0, 1.0, 4.0]),
    np.array([[1.0, 2.0], [-3.0, 0.5], [0.2, -1.5]]),
)


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


def test_the_phase_of_a_site_does_not_depend_on_its_tile() -> None:
    term = _waves(7, 24, 12.0, 3.7)
    y_um = 0.35 * np.arange(-1500, 1500, 7)
    whole = term(SITES_UM, y_um, "x")
    for first, last in ((0, 50), (31, 200), (199, 429)):
        # The matrix product rounds as its shape asks, no more.
        np.testing.assert_allclose(wrap_phase(term(SITES_UM, y_um[first:last], "x") - whole[first:last]), 0, atol=1e-11)
    shuffled = np.random.default_rng(0).permutation(y_um.size)
    np.testing.assert_allclose(wrap_phase(term(SITES_UM, y_um[shuffled], "x") - whole[shuffled]), 0, atol=1e-11)


def test_beyond_the_aperture_the_sum_itself_is_taken() -> None:
    term = _waves(3, 5, 12.0, 3.7)
    inside_um, beyond_um = np.array([-400.0, 300.0]), np.array([-400.0, 300.0, 1500.0])
    field = term.field(beyond_um / RADIUS_UM, beyond_um / RADIUS_UM)
    np.testing.assert_allclose(term(beyond_um, beyond_um, "x"), np.angle(field), atol=2e-11)
    np.testing.assert_allclose(term(inside_um, inside_um, "x"), np.angle(field)[:2, :2], atol=1e-6)


def test_a_sum_of_waves_has_the_phase_of_the_written_sum() -> None:
    x, y = X_UM[None, :] / SMALL_UM, Y_UM[:, None] / SMALL_UM
    total = sum(
        c * np.exp(1j * (-w * (x**2 + y**2) + v[0] * x + v[1] * y))
        for c, w, v in zip(WAVES.amplitude, WAVES.defocus_rad, WAVES.tilt_rad, strict=True)
    )
    np.testing.assert_allclose(wrap_phase(WAVES(X_UM, Y_UM, "x") - np.angle(total)), 0.0, atol=ANGLE_RAD)


def test_a_double_helix_is_its_gauss_laguerre_modes_and_the_same_for_both_polarisations_up_to_pi() -> None:
    from scipy.special import eval_genlaguerre

    term = DoubleHelixPhase(radius_um=SMALL_UM, waist=0.35, modes=4)
    x, y = X_UM[None, :] / 35.0, Y_UM[:, None] / 35.0
    rho2, phi = x**2 + y**2, np.arctan2(y, x)
    total = np.zeros(rho2.shape, dtype=complex)
    for j in range(4):
        m = 2 * j + 1
        norm = math.sqrt(math.factorial(j) / math.factorial(j + m))
        radial = norm * (2 * rho2) ** (m / 2) * eval_genlaguerre(j, m, 2 * rho2)
        total += radial * np.exp(1j * m * phi)
    # The series loses digits where its terms cancel: relative to the largest term, not to the sum.
    error = np.abs(np.exp(1j * (term(X_UM, Y_UM, "x") - np.angle(total))) - 1.0) * np.abs(total)
    assert error.max() < 1e-9 * np.abs(total).max()
    half_turn = wrap_phase(term(X_UM, Y_UM, "x") - term(X_UM, Y_UM, "y"))
    np.testing.assert_allclose(np.abs(half_turn), math.pi, atol=1e-9)
