"""Depth information for unknown texture: exact gradient, and its gain over the plain spiral."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.information.texture import Texture
from metafab.phase import Pupil, optimise_blind, optimise_peak
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import pupil_field, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field


def _paper_defocus(count: int) -> FloatArray:
    return rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, count), 0.30, 1000.0, 0.8)


def test_the_gradient_of_the_information_is_that_of_finite_differences() -> None:
    pupil = Pupil(24)
    problem = BlindInformation(pupil, np.array([-4.0, 0.5, 3.0]), Texture())
    random = np.random.default_rng(2)
    phase = np.angle(spiral_field(pupil, 3, 0.5)) + 0.1 * random.normal(size=pupil.count)
    direction = random.normal(size=pupil.count)
    gradient = problem.with_gradient(phase)[1]
    step = 1e-5
    ahead, behind = (problem.with_gradient(phase + s * direction)[0].mean() for s in (step, -step))
    # Central differences: rounding 1e-16 / 1e-5 of the value, curvature step^2.
    assert gradient @ direction == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


def test_information_rises_by_half_over_25_to_60_cm_and_a_lens_has_none() -> None:
    pupil = Pupil(48)
    problem = BlindInformation(pupil, _paper_defocus(10), Texture())
    spiral = spiral_field(pupil, 4, 0.5)
    start = pupil_field(optimise_peak(4, pupil=pupil).term(1.0), pupil, 1.0)
    design = optimise_blind(problem, start, iterations=25)
    assert design.information.mean() >= 1.5 * problem.of_field(spiral).mean()
    lens = problem.of_field(np.ones(pupil.count, dtype=complex))
    assert lens.max() < 1e-12 * problem.of_field(spiral).min()
    # The mask as a term, between its samples: the same information on another grid, to the interpolation's loss.
    fine = Pupil(96)
    again = BlindInformation(fine, _paper_defocus(4), Texture())
    ratio = again.of_field(pupil_field(design.term(1.0), fine, 1.0)) / again.of_field(spiral_field(fine, 4, 0.5))
    assert ratio.mean() > 1.4
