"""Sizes after exposure and etch."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.exposure import BeamPsf, BeamTerm, ExposureNumerics, expose
from metafab.exposure.etch import made_pillars
from metafab.layout import PillarMap
from metafab.layout.outlines import Outline
from metafab.spec.mask import Etch
from tests.physics.exposure.conftest import pattern

SHARP = BeamPsf.of([BeamTerm("gauss", 1.0, 5.0)], "assumption")


@pytest.fixture(scope="module")
def half_empty() -> PillarMap:
    """Every site of the left half, every second column of the right half; 120 x 200 nm."""
    index = np.ones((160, 320))
    index[:, 161::2] = 0
    return pattern(np.array([(120.0, 200.0)]), index)


def made(pillars: PillarMap, etch: Etch) -> PillarMap:
    exposed = expose(pillars, SHARP, numerics=ExposureNumerics(keep_sizes=True))
    return made_pillars(pillars, exposed, etch).pillars


def test_a_bias_changes_all_sizes_alike(half_empty: PillarMap) -> None:
    """A beam of 5 nm prints at size; half a nanometre is the unit."""
    exposed = expose(half_empty, SHARP, numerics=ExposureNumerics(keep_sizes=True))
    found = made_pillars(half_empty, exposed, Etch(bias_nm=-7.0))
    assert found.bias_nm == pytest.approx(-7.0, abs=0.26)
    assert found.bias_rms_nm < 0.3
    assert found.missing == 0


def test_microloading_follows_the_local_density(half_empty: PillarMap) -> None:
    """Far from the seam the densities are 0.196 and 0.098: sizes differ by half of that share."""
    loaded = made(half_empty, Etch(microloading_nm=100.0, microloading_range_um=4.5))
    sizes = loaded.size_nm()[loaded.to_array()]
    density = 120.0 * 200.0 / 350.0**2
    difference = sizes[80, 80] - sizes[80, 240]
    np.testing.assert_allclose(difference, 100.0 * 0.5 * density, atol=0.5)


def test_the_density_of_ellipses_is_that_of_their_area(half_empty: PillarMap) -> None:
    outline = Outline("ellipse", 0.5)
    exposed = expose(half_empty, SHARP, outline=outline, numerics=ExposureNumerics(keep_sizes=True))
    etch = Etch(microloading_nm=100.0, microloading_range_um=4.5)
    ellipses = made_pillars(half_empty, exposed, etch, outline)
    boxes = made_pillars(half_empty, exposed, etch)
    # The polygon of the mask is 1 % larger than the ellipse.
    assert ellipses.density == pytest.approx(0.25 * np.pi * boxes.density, rel=0.015)
    sizes = ellipses.pillars.size_nm()[ellipses.pillars.to_array()]
    density = 0.25 * np.pi * 120.0 * 200.0 / 350.0**2
    np.testing.assert_allclose(sizes[80, 80] - sizes[80, 240], 100.0 * 0.5 * density, atol=0.5)


def test_ranges_that_blocks_do_not_resolve_are_refused(half_empty: PillarMap) -> None:
    with pytest.raises(InputError, match="microloading_range_um"):
        made(half_empty, Etch(microloading_nm=10.0, microloading_range_um=1.0))


def test_pillars_that_are_etched_away_are_counted(half_empty: PillarMap) -> None:
    exposed = expose(half_empty, SHARP, numerics=ExposureNumerics(keep_sizes=True))
    found = made_pillars(half_empty, exposed, Etch(bias_nm=-125.0))
    assert found.missing == exposed.figures.pillars
    assert np.isinf(found.narrowest_nm)
    some = made_pillars(half_empty, exposed, Etch(bias_nm=-7.0))
    sizes_nm = some.pillars.size_nm()[np.unique(some.pillars.to_array())[1:]]
    assert some.narrowest_nm == pytest.approx(sizes_nm.min())
