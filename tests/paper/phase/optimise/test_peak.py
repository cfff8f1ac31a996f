"""Gain and rotation of the lobe in Shen et al., Nature Communications 14, 1035 (2023)."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.phase import Pupil, main_lobe, optimise_peak
from metafab.phase.optimise.peak import PeakDesign
from metafab.phase.optimise.rotation import rotation_deg_per_dioptre
from metafab.phase.pupil import pupil_field, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field

WAVELENGTH_UM, RADIUS_UM, FOCAL_UM, ANGLE_DEG, FOCUS_M = 0.8, 1000.0, 20000.0, 8.0, 0.30


@pytest.fixture(scope="module")
def best() -> PeakDesign:
    return optimise_peak(4, 0.5)


def test_the_iteration_beats_the_papers_gain(best: PeakDesign) -> None:
    assert best.peak_gain >= 1.36
    assert best.bound_fraction > 0.95
    assert (best.target <= 1.0).all()


@pytest.mark.parametrize("optimised", [False, True])
def test_rotation_over_25_to_60_cm(best: PeakDesign, optimised: bool) -> None:
    """Monotonic, counter-clockwise as the object recedes, at -225 / L degrees per dioptre."""
    pupil = Pupil()
    field = pupil_field(best.term(RADIUS_UM), pupil, RADIUS_UM) if optimised else spiral_field(pupil, 4, 0.5)
    depth_m = 1.0 / np.linspace(4.0, 1.0 / 0.6, 36)
    lobe = main_lobe(pupil, field, rim_defocus_rad(depth_m, FOCUS_M, RADIUS_UM, WAVELENGTH_UM), 14.0)
    assert (np.diff(lobe.phi_deg) > 0.0).all()
    rate = np.polyfit(1.0 / depth_m, lobe.phi_deg, 1)[0]
    assert rotation_deg_per_dioptre(4, RADIUS_UM, WAVELENGTH_UM) == pytest.approx(-225.0 / 4, rel=1e-3)
    assert rate == pytest.approx(-225.0 / 4, rel=0.03)
