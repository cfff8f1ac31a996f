"""The brightest helix: conjugate pair, law of rotation, stationarity, independence of the start."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.phase import Pupil, main_lobe, optimise_peak
from metafab.phase.optimise.peak import PeakDesign
from metafab.phase.pupil import FocalPlane, pupil_field, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field

COARSE = Pupil(64)


@pytest.fixture(scope="module")
def best() -> PeakDesign:
    return optimise_peak(4, pupil=COARSE)


def _paper_defocus(count: int) -> FloatArray:
    return rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, count), 0.30, 1000.0, 0.8)


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


def test_the_gain_does_not_depend_on_the_sampling_of_the_pupil(best: PeakDesign) -> None:
    """The mask is a formula: on a grid that the optimiser never saw it is as bright."""
    fine = Pupil(192)
    lobe = main_lobe(fine, pupil_field(best.term(1.0), fine, 1.0), best.defocus_rad, 14.0)
    plain = main_lobe(fine, spiral_field(fine, 4, 0.5), best.defocus_rad, 14.0)
    # The rim of a circle of 64 squares is off by up to half a square: a share of 1 / 64 of the radius, here and there.
    assert lobe.peak.mean() / plain.peak.mean() == pytest.approx(best.peak_gain, rel=1.0 / 64)
