"""Figures of a focus: diffraction integrals, Airy's pattern, and aberrations of known Strehl ratio."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import j0, j1

from metafab.core.conventions import FloatArray
from metafab.core.figures import FocusFigures
from metafab.layout.pillars import Lattice
from metafab.optics import Imaging, ideal_field
from metafab.optics.geometry.polarisation import FocusIntegrals
from metafab.optics.measures.focus import LensFocus, PerfectLens, focus
from metafab.phase.terms.carriers import LensPhase
from metafab.phase.terms.profile import PhaseProfile
from metafab.phase.terms.zernike import ZernikePhase
from metafab.spec import Device

WAVELENGTH_UM = 0.532


def _figures(sine: float, *, aperture_um: float = 60.0, aberration_rad: float = 0.0) -> FocusFigures:
    focal_um = 0.5 * aperture_um / math.tan(math.asin(sine))
    count = 2 * math.ceil(0.5e3 * aperture_um / 200)
    lattice, device = (
        Lattice(period_dbu=(200, 200), shape=(count, count), database_unit_nm=1.0),
        Device(aperture_um=aperture_um, focal_length_mm=1e-3 * focal_um),
    )
    terms = (
        LensPhase(wavelength_um=WAVELENGTH_UM, image_distance_um=focal_um, object_distance_um=math.inf),
        ZernikePhase(degree=2, order=2, amplitude_rad=aberration_rad, radius_um=0.5 * aperture_um),
    )
    imaging = Imaging(
        wavelength_um=WAVELENGTH_UM,
        focal_length_mm=1e-3 * focal_um,
        split_angle_deg=0.0,
        sensor_distance_um=focal_um,
        pixel_um=0.4,
        aperture_um=aperture_um,
    )
    perfect = ideal_field(PerfectLens(imaging, math.inf), lattice, device)
    return focus(ideal_field(PhaseProfile(terms), lattice, device), LensFocus(perfect, math.inf), imaging)


def _width(radius: FloatArray, curve: FloatArray) -> float:
    below = int(np.flatnonzero(curve < 0.5 * curve[0])[0])
    return 2.0 * float(np.interp(0.5 * curve[0], curve[[below, below - 1]], radius[[below, below - 1]]))


@pytest.mark.parametrize("sine", [0.3, 0.6])
def test_the_widths_are_those_of_the_vectorial_limit_integral(sine: float) -> None:
    figures = _figures(sine)
    radius = np.linspace(0.0, 1.5, 1501) / sine
    field = FocusIntegrals.at(radius, sine)
    unpolarised = field.i_0**2 + field.i_2**2 + 0.5 * field.i_1**2
    along_x, along_y = (field.i_0 + field.i_2) ** 2 + field.i_1**2, (field.i_0 - field.i_2) ** 2
    limit_um = WAVELENGTH_UM * _width(radius, unpolarised)
    assert [figures.fwhm_x_um, figures.fwhm_y_um, figures.fwhm_limit_um] == pytest.approx([limit_um] * 3, rel=0.01)
    (x_x, x_y), (y_x, y_y) = figures.fwhm_polarised_um
    wide, narrow = (WAVELENGTH_UM * _width(radius, curve) for curve in (along_x, along_y))
    assert [x_x, x_y, y_y, y_x] == pytest.approx([wide, narrow, wide, narrow], rel=0.01)


def test_a_perfect_lens_is_at_its_limit() -> None:
    figures = _figures(0.6)
    assert figures.strehl == pytest.approx(1.0, abs=1e-3)
    assert figures.encircled_energy == pytest.approx(figures.encircled_energy_limit, abs=1e-3)
    assert np.nanmax(np.abs(figures.section_x - figures.section_limit)) < 1e-3
    assert figures.numerical_aperture == pytest.approx(0.6, rel=1e-6)


def test_a_slow_lens_encircles_what_rayleigh_found() -> None:
    """1 - J0^2 - J1^2 of 2 pi NA r / wavelength (Rayleigh 1881): 83.8 % within the first dark ring."""
    figures = _figures(0.15)
    v = 2.0 * np.pi * 0.15 * figures.radius_um / WAVELENGTH_UM
    # NA 0.15 differs from the paraxial pattern by NA^2 / 4, and the rim is cut along sites.
    assert np.abs(figures.encircled - (1.0 - j0(v) ** 2 - j1(v) ** 2)).max() < 8e-3
    assert figures.encircled_energy == pytest.approx(0.838, abs=6e-3)


def test_the_strehl_ratio_of_astigmatism() -> None:
    """exp(-variance) to fourth order: r^2 cos 2 phi times a has the variance a^2 / 6 (Mahajan 1983)."""
    figures = _figures(0.3, aberration_rad=0.6)
    # A flat lens of NA 0.3 weights the rim by 10 % more: its variance by 2 %, of 0.06.
    assert figures.strehl == pytest.approx(math.exp(-(0.6**2) / 6.0), abs=4e-3)
