"""Modulation transfer and pinholes against closed forms: Gaussian, circular aperture, Airy pattern, defocus."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0, j1

from metafab.core.conventions import FloatArray
from metafab.optics import Psf, PsfNumerics, psf
from metafab.optics.geometry.polarisation import FocusIntegrals
from metafab.optics.measures import metrics
from metafab.optics.measures.mtf import lens_cut_off_per_um, lens_modulation, modulation_transfer
from metafab.optics.point_spread import PsfDetails
from metafab.spec import Device
from tests import optics_lens as lens
from tests.conjugate_pair import helix_psf

OPTICS = lens.imaging(split_angle_deg=0.0, sensor_distance_um=450.0)
DEVICE = Device(aperture_um=OPTICS.aperture_um, focal_length_mm=OPTICS.focal_length_mm)
FOCUS_M = 1e-6 / (1.0 / 300.0 - 1.0 / 450.0)
CUT_OFF = OPTICS.aperture_um / (OPTICS.wavelength_um * OPTICS.sensor_distance_um)


def _stack(image: FloatArray, pixel_um: float) -> Psf:
    base = helix_psf(np.array([0.25]), window_px=8)
    return replace(base, psf=np.array([image, image])[:, None], pixel_um=pixel_um)


def test_the_mtf_of_a_gaussian_is_one() -> None:
    pixel_um, sigma_um = 2.0, 12.0
    axis = (np.arange(96) - 48) * pixel_um
    spot = np.exp(-(axis[None, :] ** 2 + axis[:, None] ** 2) / (2 * sigma_um**2))
    frequency, mtf = modulation_transfer(_stack(spot, pixel_um))
    expected = np.exp(-2.0 * (math.pi * sigma_um * frequency) ** 2)
    assert frequency[-1] == pytest.approx(0.5 / pixel_um, rel=0.01)
    # A ring is h = 1/192 per um wide; its mean differs by curvature times h^2 / 24, (2 pi sigma h)^2 / 24 = 0.006.
    assert np.abs(mtf - expected).max() < 0.0065


def test_light_outside_the_window_counts_without_modulation() -> None:
    """Half of the transmitted light misses the window: every frequency but 0 transfers half."""
    pixel_um, sigma_um = 2.0, 12.0
    axis = (np.arange(96) - 48) * pixel_um
    spot = np.exp(-(axis[None, :] ** 2 + axis[:, None] ** 2) / (2 * sigma_um**2)) / (2 * math.pi * sigma_um**2)
    inside, whole = (
        _stack(spot, pixel_um),
        replace(_stack(0.4 * spot, pixel_um), details=PsfDetails(transmitted=(0.8, 0.8))),
    )
    (_, of_window), (_, of_all) = modulation_transfer(inside), modulation_transfer(whole)
    np.testing.assert_allclose(of_all[..., 0], 1.0)
    np.testing.assert_allclose(of_all[..., 1:], 0.5 * of_window[..., 1:], atol=1e-12)


def test_a_narrow_window_lifts_no_lens_above_its_limit() -> None:
    """Per light in a window of 8 wavelengths / NA, the ideal lens lies 2 % above its own limit."""
    fine = replace(OPTICS, pixel_um=0.25 / CUT_OFF)
    stack = psf(lens.ideal(fine, lens.eq_3_and_4(fine)), fine, [FOCUS_M], PsfNumerics(window_px=64))
    frequency, mtf = modulation_transfer(stack)
    shown = (frequency > 0.0) & (frequency < CUT_OFF)
    limit = lens_modulation(OPTICS, DEVICE, FOCUS_M, frequency, FOCUS_M)
    assert (mtf[0, 0] - limit)[shown].max() < 5e-3


def test_a_circular_aperture_in_focus_has_the_textbook_mtf() -> None:
    frequency = np.linspace(0.0, 1.2 * CUT_OFF, 40)
    share = np.minimum(frequency / CUT_OFF, 1.0)
    expected = 2.0 / np.pi * (np.arccos(share) - share * np.sqrt(1.0 - share**2))
    found = lens_modulation(OPTICS, DEVICE, FOCUS_M, frequency, FOCUS_M)
    # The rim is cut along samples, 1/192 of the diameter: 1e-3 of the area. At NA 0.067 the pupil of a flat lens is
    # 0.4 % higher at its rim than in its middle.
    assert np.abs(found - expected).max() < 2e-3


def test_a_flat_lens_of_high_aperture_has_the_mtf_of_its_diffraction_integral() -> None:
    """NA 0.6: the Hankel transform of the squared field integral; the paraxial cut-off lies 25 % higher."""
    sine, wavelength_um = 0.6, 0.532
    focal_um = 50.0 / math.tan(math.asin(sine))
    optics = replace(OPTICS, wavelength_um=wavelength_um, sensor_distance_um=focal_um, aperture_um=100.0)
    assert lens_cut_off_per_um(optics) == pytest.approx(2.0 * sine / wavelength_um)
    radius = np.linspace(0.0, 40.0, 4001)  # wavelengths
    image = FocusIntegrals.at(radius, sine).scalar ** 2
    frequency = np.linspace(0.0, 1.1, 12) * 2.0 * sine  # per wavelength
    transform = np.array([np.trapezoid(j0(2.0 * np.pi * f * radius) * image * radius, radius) for f in frequency])
    # Parseval: the integral of (1 / (1 - s^2))^2 s over the pupil.
    whole = 0.5 * (1.0 / (1.0 - sine**2) - 1.0) / (2.0 * np.pi) ** 2
    found = lens_modulation(
        optics, Device(aperture_um=100.0, focal_length_mm=1.0), math.inf, frequency / wavelength_um, math.inf
    )
    # The rim is cut along samples, 1/192 of the diameter, where the pupil is 1.56 times that on the axis.
    assert np.abs(found - transform / whole)[1:].max() < 5e-3
    assert found[-1] == 0.0


def test_a_defocused_lens_has_the_mtf_of_its_psf() -> None:
    """The pupil's autocorrelation against the propagation of the target phases, which share no line."""
    wide = replace(OPTICS, pixel_um=1.5)
    stack = psf(lens.ideal(wide, lens.eq_3_and_4(wide)), wide, [0.7 * FOCUS_M], PsfNumerics(window_px=128))
    frequency, mtf = modulation_transfer(stack)
    shown = frequency < 0.8 * CUT_OFF
    # Eq. 3 focuses parallel light; the standard lens is free of aberrations at its focus. NA 0.07: 2 % of a wave.
    found = lens_modulation(OPTICS, DEVICE, 0.7 * FOCUS_M, frequency, FOCUS_M)
    assert mtf[0, 0, shown].min() < 0.1  # strongly defocused
    assert np.abs(found - mtf[0, 0])[shown].max() < 0.02


@pytest.mark.parametrize("diameter_um", [20.0, 31.0, 44.0])
def test_an_airy_pattern_through_a_pinhole(diameter_um: float) -> None:
    """1 - J0^2 - J1^2 of pi d NA / wavelength passes (Rayleigh 1881), also where the rim cuts through pixels."""
    pixel_um, na_per_um = 1.3, 0.09
    x = (np.arange(160) - 80) * pixel_um
    v = 2.0 * np.pi * na_per_um * np.hypot(x[None, :], x[:, None])
    airy = np.pi * na_per_um**2 * np.where(v > 0.0, (2.0 * j1(np.maximum(v, 1e-9)) / np.maximum(v, 1e-9)) ** 2, 1.0)
    u = np.pi * na_per_um * diameter_um
    passed = metrics.pinhole_efficiency(_stack(airy, pixel_um), diameter_um)
    # What lies beyond the window, 0.5 / (pi u) at 80 pixels, is missing from the spectrum: its edge rings by 2e-4.
    assert passed == pytest.approx(1.0 - j0(u) ** 2 - j1(u) ** 2, abs=5e-4)


def test_the_main_lobe_is_placed_between_pixels() -> None:
    pixel_um, aside_um = 2.0, (3.3, -5.9)
    axis = (np.arange(64) - 32) * pixel_um
    spot = np.exp(-((axis - aside_um[0])[None, :] ** 2 + (axis - aside_um[1])[:, None] ** 2) / (2 * 6.0**2))
    assert metrics.main_lobe_um(_stack(spot, pixel_um)) == pytest.approx(np.tile(aside_um, (2, 1, 1)), abs=1e-3)


def test_a_pinhole_leaves_room_to_be_scanned() -> None:
    stack = _stack(np.ones((64, 64)), 1.0)
    assert metrics.largest_pinhole_um(stack, 40.0) == 40.0
    assert metrics.largest_pinhole_um(stack) == 48.0
