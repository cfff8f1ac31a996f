"""Wavefronts behind lenses of known aberrations: the coefficients that went in, beyond a wave too, and the Strehl."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import AberrationFigures
from metafab.layout.pillars import Lattice
from metafab.optics import Imaging, ideal_field
from metafab.optics.measures.aberrations import aberrations
from metafab.optics.sources.source import apodised
from metafab.phase.terms.carriers import LensPhase
from metafab.phase.terms.profile import PhaseProfile
from metafab.phase.terms.zernike import ZernikePhase, zernike_number
from metafab.spec import Device

WAVELENGTH_UM, FOCAL_UM = 0.532, 100.0


def _found(
    *terms: tuple[int, float],
    convention: str = "noll",
    aperture_um: float = 60.0,
    transmission: Callable[[FloatArray, FloatArray], FloatArray] | None = None,
) -> AberrationFigures:
    """Aberrations of a lens with the polynomials (number, coefficient in waves)."""
    count = 2 * math.ceil(0.5e3 * aperture_um / 200)
    lattice, device = (
        Lattice(period_dbu=(200, 200), shape=(count, count), database_unit_nm=1.0),
        Device(aperture_um=aperture_um, focal_length_mm=1e-3 * FOCAL_UM),
    )
    added = []
    for number, waves in terms:
        degree, order, norm = zernike_number(number, convention)  # type: ignore[arg-type]
        added.append(
            ZernikePhase(
                degree=degree, order=order, amplitude_rad=2.0 * math.pi * norm * waves, radius_um=0.5 * aperture_um
            )
        )
    profile = PhaseProfile(
        (LensPhase(wavelength_um=WAVELENGTH_UM, image_distance_um=FOCAL_UM, object_distance_um=math.inf), *added)
    )
    imaging = Imaging(
        wavelength_um=WAVELENGTH_UM,
        focal_length_mm=1e-3 * FOCAL_UM,
        split_angle_deg=0.0,
        sensor_distance_um=FOCAL_UM,
        pixel_um=0.4,
        aperture_um=aperture_um,
    )
    return aberrations(apodised(ideal_field(profile, lattice, device), transmission), imaging, math.inf)


def test_a_perfect_lens_has_a_flat_wavefront() -> None:
    found = _found()
    assert found.rms_waves < 1e-4
    assert found.strehl_of_phase == pytest.approx(1.0, abs=1e-6)
    assert np.abs(found.noll_waves[1:]).max() < 1e-4


@pytest.mark.parametrize(
    ("convention", "terms"),
    [
        ("noll", [(4, 0.05), (7, -0.08), (11, 0.03)]),
        ("noll", [(5, 1.7), (8, -0.9), (2, 3.0)]),
        ("fringe", [(5, 0.1), (9, 0.2), (16, -0.05), (36, 0.03)]),
    ],
    ids=["small", "waves", "fringe"],
)
def test_the_coefficients_that_went_in_come_out(convention: str, terms: list[tuple[int, float]]) -> None:
    """Blocks of 3 pillars smooth the wavefront by the square of block over radius, 4e-4, times the degree."""
    found = _found(*terms, convention=convention)
    coefficients = found.noll_waves if convention == "noll" else found.fringe_waves
    expected = np.zeros(coefficients.size)
    for number, waves in terms:
        expected[number - 1] = waves
    np.testing.assert_allclose(coefficients[1:], expected[1:], atol=4e-3 * np.abs(expected).max())
    if convention == "noll":  # orthonormal over the circle, of which the blocks on the rim are left out
        # A tilt is no blur.
        assert found.rms_waves == pytest.approx(math.hypot(*expected[2:]), rel=0.07)
        assert found.residual_waves < 0.01 * found.rms_waves


@pytest.mark.parametrize(
    ("transmission", "spread", "without_rim"),
    [(lambda r: 1.0 * (r > 0.9), (1.0 - 0.81) / math.sqrt(12.0), 0.2), (lambda r: r, math.sqrt(1.0 / 18.0), 0.05)],
    ids=["ring", "apodised"],
)
def test_the_rms_is_that_of_the_light_that_passes(
    transmission: Callable[[FloatArray], FloatArray], spread: float, without_rim: float
) -> None:
    """Defocus is sqrt(3) (2 s - 1) in s = r^2, whose spread is that of even light, or of light with density 2 s.

    The blocks on the rim are left out, up to a sixth of the ring.
    """
    found = _found((4, 0.1), transmission=lambda x, y: transmission(np.hypot(x, y[:, None]) / 30.0))
    assert found.rms_waves == pytest.approx(0.1 * math.sqrt(3.0) * 2.0 * spread, rel=without_rim)


def test_the_strehl_ratio_of_astigmatism_is_that_of_its_phase() -> None:
    """Marechal: exp(-(2 pi rms)^2) to fourth order in the rms of 0.07 waves."""
    found = _found((6, 0.07))
    assert found.strehl_of_phase == pytest.approx(math.exp(-((2.0 * math.pi * 0.07) ** 2)), abs=0.01)


def test_a_tilt_moves_the_image_and_does_not_blur_it() -> None:
    """Coma of 0.05 waves with tilts of its ray centroid: the rms and the Strehl ratio are those of the coma alone."""
    coma, tilted = _found((7, 0.05)), _found((7, 0.05), (2, 0.4), (3, -0.3))
    assert tilted.noll_waves[1:3] == pytest.approx([0.4, -0.3], abs=2e-3)
    assert tilted.rms_waves == pytest.approx(coma.rms_waves, rel=1e-3)
    assert tilted.strehl_of_phase == pytest.approx(coma.strehl_of_phase, abs=1e-3)
    assert tilted.opd_waves == pytest.approx(coma.opd_waves, abs=1e-3, nan_ok=True)


def test_defocus_of_an_object_nearer_than_the_focus_is_the_sphere_that_it_sends() -> None:
    """The sag difference r^2 / (2 z) of an object at z is a defocus of r^2 / (4 sqrt(3) z) rms, to the NA squared."""
    found = aberrations_of_near_object(0.02)
    expected = 30.0**2 / (2.0 * 0.02e6) / (2.0 * math.sqrt(3.0)) / WAVELENGTH_UM
    assert found.noll_waves[3] == pytest.approx(expected, rel=0.05)


def aberrations_of_near_object(depth_m: float) -> AberrationFigures:
    lattice, device = (
        Lattice(period_dbu=(200, 200), shape=(300, 300), database_unit_nm=1.0),
        Device(aperture_um=60.0, focal_length_mm=1e-3 * FOCAL_UM),
    )
    profile = PhaseProfile(
        (LensPhase(wavelength_um=WAVELENGTH_UM, image_distance_um=FOCAL_UM, object_distance_um=math.inf),)
    )
    imaging = Imaging(
        wavelength_um=WAVELENGTH_UM,
        focal_length_mm=1e-3 * FOCAL_UM,
        split_angle_deg=0.0,
        sensor_distance_um=FOCAL_UM,
        pixel_um=0.4,
        aperture_um=60.0,
    )
    return aberrations(ideal_field(profile, lattice, device), imaging, depth_m)


def test_a_lens_of_few_pillars_is_refused() -> None:
    with pytest.raises(InputError, match="blocks of pillars with light"):
        _found(aperture_um=1.0)
    with pytest.raises(InputError, match="blocks of pillars with light"):
        _found(aperture_um=5.0, transmission=lambda x, y: 1.0 * (np.hypot(x, y[:, None]) > 0.9 * 2.5))
