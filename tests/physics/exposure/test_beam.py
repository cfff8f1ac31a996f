"""Point-spread functions of the beam against their laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.exposure import BeamPsf, BeamTerm, beam_psf
from metafab.exposure.presets import PRESETS
from metafab.spec.mask import ExposureProcess
from tests.physics.exposure.conftest import BEAM


def test_density_of_a_power_law_is_the_power_law() -> None:
    """Gaussian mixture against (1 + r^2 / g^2)^(-nu / 2) over three decades of radius."""
    gamma, exponent = 30.0, 3.4
    beam = BeamPsf.of([BeamTerm("power", 1.0, gamma, exponent)], "assumption")
    radius = np.geomspace(1.0, 3000.0, 40)
    law = (exponent - 2.0) / (2.0 * math.pi * gamma**2) * (1.0 + (radius / gamma) ** 2) ** (-0.5 * exponent)
    np.testing.assert_allclose(beam.density(radius), law, rtol=2e-3)


def test_a_blur_of_a_gaussian_is_a_wider_gaussian() -> None:
    beam = BeamPsf.of([BeamTerm("gauss", 1.0, 12.0)], "assumption").blurred(5.0)
    assert beam.range_nm[0] == pytest.approx(13.0)


def test_a_table_is_fitted() -> None:
    """The energy within any radius is kept within 5 %: rings of the table are a fifth of their radius wide."""
    radius = np.geomspace(1.0, 6e4, 60)
    beam = BeamPsf.fitted(radius, BEAM.density(radius), "table")
    assert beam.fit_error < 0.05
    assert beam.weight.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_normalised_and_name_their_source(name: str) -> None:
    """The fitted share of energy within any radius differs from the table's by at most 0.1."""
    psf = beam_psf(ExposureProcess(preset=name))
    assert psf.weight.sum() == pytest.approx(1.0)
    assert psf.fit_error < 0.1
    assert psf.source.startswith("Monte Carlo by metafab: ")
    assert "assumed" in psf.source


def test_an_unknown_preset_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="hsq_sos_100kv"):
        beam_psf(ExposureProcess(preset="unknown"))


def test_one_function_is_asked() -> None:
    with pytest.raises(ValueError, match="one of"):
        ExposureProcess()
