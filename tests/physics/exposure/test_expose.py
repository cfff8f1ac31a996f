"""Printed sizes and corrected doses of a lens."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from metafab.exposure import ExposureNumerics, expose
from metafab.layout import PillarMap
from tests.physics.exposure.conftest import BEAM, pattern


def test_correction_prints_what_is_drawn(lens: PillarMap) -> None:
    """Half a nanometre is asked; 64 classes leave a tenth of it."""
    plain = expose(lens, BEAM, numerics=ExposureNumerics(samples=5))
    corrected = expose(lens, BEAM, correct=True, numerics=ExposureNumerics(samples=5))
    assert abs(plain.figures.cd_bias_nm) < 0.05
    assert plain.figures.cd_error_rms_nm > 0.3
    assert corrected.figures.cd_error_rms_nm < 0.1
    assert corrected.figures.cd_error_max_nm < 0.5
    assert corrected.figures.error < 2e-4
    assert corrected.figures.unprinted == 0
    # Where many neighbours expose a pillar, it needs less.
    middle, rim = corrected.dose[350, 350], corrected.dose[350, 3]
    assert rim > 1.03 * middle


def test_printed_edge_lies_where_the_energy_is_the_clearing_energy(lens: PillarMap) -> None:
    """Direct sum with the pillar itself drawn at its printed size crosses the threshold at the printed edge."""
    result = expose(lens, BEAM, numerics=ExposureNumerics(samples=4))
    ratio = result.figures.base_over_clearing_dose
    for pillar in result.samples:
        shift = 0.5 * (pillar.printed_width_nm - pillar.width_nm)
        # The slope of a Gaussian edge of range 8 nm and the power law's share beside it.
        own = 0.55 * 0.5 * (erf((pillar.width_nm + shift) / 8.0) - erf(shift / 8.0))
        at_edge = 0.55 * 0.5 * erf(pillar.width_nm / 8.0)
        predicted = pillar.energy_edge_x + ratio * pillar.dose * (own - at_edge)
        assert predicted == pytest.approx(1.0, abs=0.01)


def test_pillars_are_listed_once_each_and_as_many_as_there_are() -> None:
    """Three pillars on a lattice of two million sites: each is listed, and drawing them ends."""
    index = np.zeros((1500, 1500), dtype=np.uint16)
    index[3, 7] = index[700, 1400] = index[1499, 0] = 1
    result = expose(pattern(np.array([(150.0, 200.0)]), index), BEAM, numerics=ExposureNumerics(samples=10))
    assert result.figures.pillars == 3
    assert len({(pillar.x_um, pillar.y_um) for pillar in result.samples}) == len(result.samples) == 3
