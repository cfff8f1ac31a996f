"""Side lobes below a share of the main lobe: the limit is met, its cost grows, and the gradient is exact."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.phase import Pupil, limit_side_lobes, optimise_peak
from metafab.phase.optimise.peak import PeakDesign
from metafab.phase.optimise.side_lobes import AIRY_RADIUS, SideLobes, measured_side_lobes
from metafab.phase.pupil import FocalPlane

PUPIL = Pupil(48)


@pytest.fixture(scope="module")
def free() -> PeakDesign:
    return optimise_peak(4, pupil=PUPIL)


def test_the_gradient_is_that_of_finite_differences() -> None:
    pupil = Pupil(20)
    problem = SideLobes(pupil, np.array([-4.0, 3.0]), np.array([[3.0, 1.0], [-2.0, 2.5]]), 9.0)
    random = np.random.default_rng(4)
    phase, direction = random.normal(size=pupil.count), random.normal(size=pupil.count)
    by_peak, by_side = np.array([0.7, -1.1]), np.array([2.0, 0.4])

    def value(phases: np.ndarray) -> float:
        values = problem.evaluate(np.exp(1j * phases))
        return float(values.peak @ by_peak + values.side @ by_side)

    mask = np.exp(1j * phase)
    slope = problem.gradient(mask, problem.evaluate(mask), by_peak, by_side) @ direction
    step = 1e-5
    expected = (value(phase + step * direction) - value(phase - step * direction)) / (2.0 * step)
    assert slope == pytest.approx(expected, rel=1e-7)  # rounding 1e-16 / 1e-5, curvature step^2


def test_the_norm_is_at_least_the_largest_sample_outside() -> None:
    aim = np.array([[3.0, 0.0]])
    problem = SideLobes(PUPIL, np.array([1.0]), aim, 12.0)
    mask = np.exp(1j * np.random.default_rng(1).normal(size=PUPIL.count))
    values = problem.evaluate(mask)
    axis = FocalPlane(PUPIL, 12.0, 0.85).axis
    outside = np.hypot(axis[None, :] - 3.0, axis[:, None]) > AIRY_RADIUS
    assert values.side[0] >= (np.abs(values.amplitude[0]) ** 2)[outside].max()


def test_a_clear_aperture_has_the_first_ring_of_airy() -> None:
    """1.75 % of the peak at v = 5.14; the rim of 256 squares is right to 1 / 256 of the amplitude."""
    pupil = Pupil(256)
    side_lobe = measured_side_lobes(pupil, np.ones(pupil.count, dtype=complex), np.zeros(1), 8.0)
    assert side_lobe[0] == pytest.approx(0.01750, rel=0.06)


def test_limits_are_met_and_cost_more_the_tighter_they_are(free: PeakDesign) -> None:
    limits = (0.9, 0.34, 0.28)
    designs = [limit_side_lobes(free, limit, pupil=PUPIL) for limit in limits]
    for design, limit in zip(designs, limits, strict=True):
        assert design.limited <= limit
        again = measured_side_lobes(PUPIL, np.exp(1j * design.phase_rad), free.defocus_rad, 14.0)
        np.testing.assert_allclose(again, design.side_lobe)
    gains = [design.peak_gain for design in designs]
    assert gains[0] == pytest.approx(free.peak_gain, rel=1e-6), "a limit that binds nobody changes nothing"
    assert gains[0] > gains[1] > gains[2] > 1.36
    # An optimum below the limit would be no optimum: it comes near.
    assert designs[2].limited > 0.95 * 0.28
    rate = np.polyfit(free.defocus_rad, np.radians(designs[2].lobe.phi_deg), 1)[0]
    assert rate == pytest.approx(-0.25, rel=0.03)


def test_the_mean_may_be_held_instead_of_the_worst(free: PeakDesign) -> None:
    without = limit_side_lobes(free, 0.9, over="mean", pupil=PUPIL)
    limit = 0.95 * without.limited
    mean = limit_side_lobes(free, limit, over="mean", pupil=PUPIL)
    assert mean.side_lobe.mean() <= limit < mean.side_lobe.max()
    assert mean.limited_at_start == pytest.approx(without.limited)
    assert mean.peak_gain < without.peak_gain


def test_limits_that_cannot_be_kept_are_refused(free: PeakDesign) -> None:
    for limit in (0.0, 1.0, -0.3):
        with pytest.raises(ValueError, match="between 0 and 1"):
            limit_side_lobes(free, limit, pupil=PUPIL)
    with pytest.raises(ValueError, match="the lowest met"):
        limit_side_lobes(free, 0.01, pupil=PUPIL, iterations=3)
