"""PSFs of a hexagonal lattice: against the direct sum over its sites, and beside a square lattice's."""

from __future__ import annotations

import pytest

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.layout.pillars import Lattice
from metafab.optics import PsfNumerics, ideal_field, psf, relative_l2
from metafab.optics.sources.source import IdealField
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Device
from tests import optics_lens as lens

OPTICS = lens.imaging(aperture_um=40.0)
WINDOW_PX = 20


@pytest.fixture(scope="module")
def hexagonal() -> IdealField:
    """Period 350 nm, rows 303 nm apart."""
    device = Device(
        aperture_um=OPTICS.aperture_um, focal_length_mm=OPTICS.focal_length_mm, aperture_shape=OPTICS.aperture_shape
    )
    profile = PhaseProfile((lens.eq_3_and_4(OPTICS),))  # type: ignore[arg-type]
    return ideal_field(
        profile, Lattice(period_dbu=(350, 606), shape=(133, 229), database_unit_nm=0.5, hexagonal=True), device
    )


def test_the_stated_error_bounds_the_true_one(hexagonal: IdealField) -> None:
    result = psf(hexagonal, OPTICS, [0.8e-3], PsfNumerics(window_px=WINDOW_PX, target_error=1e-3))
    for polarisation in (0, 1):
        points = lens.window_points(OPTICS, result.centre_um[polarisation, 0], WINDOW_PX)
        true = direct_irradiance(hexagonal, OPTICS, 0.8e-3, (0.0, 0.0), *points, polarisation)
        assert relative_l2(result.psf[polarisation, 0].ravel(), true) <= result.error[0] <= 1.5e-3


def test_the_lattice_does_not_matter_to_a_lens_of_full_transmission(hexagonal: IdealField) -> None:
    """Either lattice samples the same phases, and a pillar stands for its cell: absolute irradiance agrees but for the
    rim, where a cell belongs to the lens or not: 2 pi R times half a period is 2 % of the area, and random."""
    square = psf(
        lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS)),
        OPTICS,
        [0.8e-3],
        PsfNumerics(window_px=WINDOW_PX, target_error=1e-3),
    )
    other = psf(hexagonal, OPTICS, [0.8e-3], PsfNumerics(window_px=WINDOW_PX, target_error=1e-3))
    assert other.psf.max() == pytest.approx(square.psf.max(), rel=0.01)
    assert other.efficiency[:, 0] == pytest.approx(square.efficiency[:, 0], rel=0.01)
