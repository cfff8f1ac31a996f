"""The optimised helices: proven bound, exact gradient, independence of the start, the law of rotation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.information.texture import Texture
from metafab.phase import DoubleHelixPhase, Pupil, main_lobe, optimise_blind, optimise_peak, profile_of
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.optimise.bound import peak_bound
from metafab.phase.optimise.peak import PeakDesign
from metafab.phase.pupil import FocalPlane, pupil_field, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field
from metafab.spec import Design

COARSE = Pupil(64)


@pytest.fixture(scope="module")
def best() -> PeakDesign:
    return optimise_peak(4, pupil=COARSE)


def _paper_defocus(count: int) -> FloatArray:
    return rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, count), 0.30, 1000.0, 0.8)


def test_rim_defocus_is_half_k_radius_squared_times_vergence() -> None:
    assert rim_defocus_per_dioptre_rad(1000.0, 0.8) == pytest.approx(0.5 * 2 * math.pi / 0.8e-6 * 1e-6, rel=1e-12)
    assert rim_defocus_rad(0.30, 0.30, 1000.0, 0.8) == 0.0
    # The exact excess path of a near point over the rim, less that of the point in focus; next order (R / z)^2 / 4.
    exact = 2 * math.pi / 0.8 * ((math.hypot(0.25e6, 1e3) - 0.25e6) - (math.hypot(0.30e6, 1e3) - 0.30e6))
    assert rim_defocus_rad(0.25, 0.30, 1000.0, 0.8) == pytest.approx(exact, rel=2e-5)


def test_a_clear_circular_pupil_has_the_airy_pattern() -> None:
    from scipy.special import j1

    pupil = Pupil(256)
    plane = FocalPlane(pupil, 8.0)
    psf = plane.psf(np.ones(pupil.count, dtype=complex), 0.0)[0]
    v = np.hypot(plane.axis[:, None], plane.axis[None, :])
    airy = np.where(v > 0, (2 * j1(np.maximum(v, 1e-9)) / np.maximum(v, 1e-9)) ** 2, 1.0)
    # A circle of square samples has a rim that is wrong by up to half a sample here and there: 1 / 256.
    np.testing.assert_allclose(psf, airy, atol=1.0 / 256)


def test_defocus_without_a_helix_dims_the_centre_as_a_sinc() -> None:
    pupil = Pupil(256)
    peak = FocalPlane(pupil, 0.3).psf(np.ones(pupil.count, dtype=complex), [0.0, 3.0, 5.0])[:, 1, 1]
    np.testing.assert_allclose(peak, np.sinc(np.array([0.0, 3.0, 5.0]) / (2 * math.pi)) ** 2, atol=1.0 / 256)


def test_a_tilted_pupil_moves_the_image_the_same_way() -> None:
    """Sign of the transform: a phase rising along +y deflects light towards +y."""
    field = np.exp(1j * (2.0 * COARSE.x + 4.0 * COARSE.y))
    lobe = main_lobe(COARSE, field, [0.0], 8.0)
    assert lobe.phi_deg[0] == pytest.approx(math.degrees(math.atan2(4.0, 2.0)), abs=0.2)
    assert lobe.radius[0] == pytest.approx(math.hypot(4.0, 2.0), rel=2e-3)
    assert lobe.peak[0] == pytest.approx(1.0, abs=2e-3)


def test_the_pair_is_conjugate_at_every_depth(best: PeakDesign) -> None:
    """PSF_y(x, y; z) = PSF_x(-x, -y; z): conventions, to rounding."""
    plane = FocalPlane(COARSE, 8.0)
    term = best.term(1.0)
    fields = [np.exp(1j * term(COARSE.axis, COARSE.axis, p)[COARSE.inside]) for p in ("x", "y")]  # type: ignore[arg-type]
    psf_x, psf_y = (plane.psf(field, [-5.0, 0.0, 7.0]) for field in fields)
    np.testing.assert_allclose(psf_y, psf_x[:, ::-1, ::-1], atol=1e-13)


@pytest.mark.parametrize("zones", [2, 4, 7])
def test_the_lobe_of_the_optimised_helix_keeps_the_law_over_the_whole_turn(zones: int) -> None:
    design = optimise_peak(zones, pupil=COARSE)
    assert (np.diff(design.lobe.phi_deg) < 0.0).all()
    rate = np.polyfit(design.defocus_rad, np.radians(design.lobe.phi_deg), 1)[0]
    assert rate == pytest.approx(-1.0 / zones, rel=0.02)  # the steering's rest
    over_scene = main_lobe(COARSE, pupil_field(design.term(1.0), COARSE, 1.0), _paper_defocus(36), 2.0 * zones + 6.0)
    assert (np.diff(over_scene.phi_deg) > 0.0).all()
    rate = np.polyfit(over_scene.defocus_rad, np.radians(over_scene.phi_deg), 1)[0]
    assert rate == pytest.approx(-1.0 / zones, rel=0.03)
    turned = design.lobe.phi_deg[0] - design.lobe.phi_deg[-1]
    assert turned == pytest.approx(360.0 * (1.0 - 1.0 / design.defocus_rad.size), rel=0.05)


def test_no_mask_beats_the_bound_and_the_design_all_but_reaches_it(best: PeakDesign) -> None:
    assert best.bound.dual <= best.bound.spectral
    assert 0.995 < best.bound_fraction <= 1.0 + 1e-9
    tilt = best.term(1.0).tilt_rad
    waves = np.exp(
        1j
        * (
            np.outer(tilt[:, 0], COARSE.x)
            + np.outer(tilt[:, 1], COARSE.y)
            - np.outer(best.defocus_rad, COARSE.radius_squared)
        )
    )
    random = np.random.default_rng(7)
    for iterations in (1, 5, 50):  # a bad relaxation gives a weaker bound, never a wrong one
        bound = peak_bound(waves, np.full(len(waves), 1.0 / len(waves)), iterations, seed=3)
        assert bound.dual >= best.reached - 1e-9
    for wave in waves[::5]:
        mask = wave * np.exp(0.3j * random.normal(size=COARSE.count))
        assert np.mean(np.abs(waves.conj() @ mask / COARSE.count) ** 2) <= best.bound.dual


def test_small_changes_of_the_mask_never_raise_the_mean_peak(best: PeakDesign) -> None:
    """The optimum is stationary: the first-order change vanishes, the second is negative."""
    term = best.term(1.0)
    field = pupil_field(term, COARSE, 1.0)
    waves = np.exp(
        1j
        * (
            np.outer(term.tilt_rad[:, 0], COARSE.x)
            + np.outer(term.tilt_rad[:, 1], COARSE.y)
            - np.outer(term.defocus_rad, COARSE.radius_squared)
        )
    )

    def mean_peak(mask: np.ndarray) -> float:
        return float(np.mean(np.abs(waves.conj() @ mask / COARSE.count) ** 2))

    random = np.random.default_rng(5)
    top = mean_peak(field)
    for _ in range(5):
        change = random.normal(size=COARSE.count)
        for step in (0.02, -0.02, 0.1):
            assert mean_peak(field * np.exp(1j * step * change)) < top


def test_the_result_does_not_depend_on_the_seed() -> None:
    gains = [optimise_peak(4, pupil=COARSE, seed=seed).peak_gain for seed in range(4)]
    assert max(gains) / min(gains) < 1.001


def test_the_worst_depth_can_be_raised_instead(best: PeakDesign) -> None:
    worst = optimise_peak(4, pupil=COARSE, goal="worst")
    assert worst.worst_gain >= 1.5
    assert worst.target.min() > 1.5 * best.target.min()
    assert 0.94 < worst.bound_fraction <= 1.0
    # The smallest peak of the mask with the best mean is one of the values that the bound is about, too.
    assert best.bound.dual > worst.bound.dual > worst.reached


def test_a_square_aperture_is_optimised_too() -> None:
    design = optimise_peak(3, pupil=Pupil(48, "square"))
    assert design.peak_gain > 1.2
    assert design.bound_fraction > 0.95


def test_a_single_zone_is_refused() -> None:
    with pytest.raises(ValueError, match="zones"):
        optimise_peak(1)


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


def test_profiles_of_a_design_optimise_as_asked(small_design: Design) -> None:
    figures = profile_of(small_design).figures
    assert figures["peak_gain"] >= 1.36
    assert figures["bound_fraction"] > 0.95
    # The small lens turns as the paper's does between 25 and 34 cm: 1.06 dioptre of 56 degrees at R = 1 mm.
    assert figures["rotation_deg"] == pytest.approx(56.25 * (4.0 - 1.0 / 0.34), rel=0.1)
    assert figures["rotation_deg_per_dioptre"] == pytest.approx(figures["rotation_deg_per_dioptre_theory"], rel=0.1)
    spiral = small_design.phase[0]
    gains = {}
    for wish in ("none", "worst_peak", "blind_information"):
        terms = (dataclasses.replace(spiral, optimise=wish), *small_design.phase[1:])  # type: ignore[arg-type]
        gains[wish] = profile_of(dataclasses.replace(small_design, phase=terms)).figures
    assert gains["none"]["peak_gain"] == 1.0
    assert gains["worst_peak"]["worst_gain"] >= 1.5
    assert gains["blind_information"]["blind_information_gain"] >= 1.4


def test_the_gain_does_not_depend_on_the_sampling_of_the_pupil(best: PeakDesign) -> None:
    """The mask is a formula: on a grid that the optimiser never saw it is as bright."""
    fine = Pupil(192)
    lobe = main_lobe(fine, pupil_field(best.term(1.0), fine, 1.0), best.defocus_rad, 14.0)
    plain = main_lobe(fine, spiral_field(fine, 4, 0.5), best.defocus_rad, 14.0)
    # The rim of a circle of 64 squares is off by up to half a square: a share of 1 / 64 of the radius, here and there.
    assert lobe.peak.mean() / plain.peak.mean() == pytest.approx(best.peak_gain, rel=1.0 / 64)


def test_a_double_helix_has_two_equal_lobes_that_turn() -> None:
    plane = FocalPlane(COARSE, 14.0)
    field = pupil_field(DoubleHelixPhase(1.0, 0.35, 5), COARSE, 1.0)
    psf = plane.psf(field, np.linspace(-7.0, 7.0, 15))
    np.testing.assert_allclose(psf, psf[:, ::-1, ::-1], atol=1e-12)
    v = plane.axis
    # Orientation of the long axis from second moments of the squared intensity, which the lobes dominate.
    weight = psf**2
    xx, yy = (weight * v[None, None, :] ** 2).sum((1, 2)), (weight * v[None, :, None] ** 2).sum((1, 2))
    xy = (weight * v[None, None, :] * v[None, :, None]).sum((1, 2))
    turn_deg = np.degrees(np.unwrap(np.arctan2(2.0 * xy, xx - yy)) / 2.0)
    assert (np.diff(turn_deg) < 0.0).all()
    assert turn_deg[0] - turn_deg[-1] > 120.0
