"""Vectorial focusing against a direct dyadic sum, the integrals of Richards and Wolf, and published spots."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.pillars import Lattice
from metafab.optics import Imaging, Psf, PsfNumerics, ideal_field, psf
from metafab.optics.geometry.polarisation import FocusIntegrals, vectorial_effect
from metafab.optics.sources.source import IdealField
from metafab.phase.terms.carriers import LensPhase
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Device

WAVELENGTH_UM, PERIOD_NM = 0.532, 200


def _lens(sine: float, aperture_um: float) -> tuple[IdealField, Imaging]:
    """An ideal flat lens for parallel light, its pixel an eighth of wavelength / NA."""
    focal_um = 0.5 * aperture_um / math.tan(math.asin(sine))
    count = 2 * math.ceil(0.5e3 * aperture_um / PERIOD_NM)
    lattice = Lattice(period_dbu=(PERIOD_NM, PERIOD_NM), shape=(count, count), database_unit_nm=1.0)
    device = Device(aperture_um=aperture_um, focal_length_mm=1e-3 * focal_um)
    profile = PhaseProfile(
        (LensPhase(wavelength_um=WAVELENGTH_UM, image_distance_um=focal_um, object_distance_um=math.inf),)
    )
    imaging = Imaging(
        wavelength_um=WAVELENGTH_UM,
        focal_length_mm=1e-3 * focal_um,
        split_angle_deg=0.0,
        sensor_distance_um=focal_um,
        pixel_um=WAVELENGTH_UM / sine / 8.0,
        aperture_um=aperture_um,
    )
    return ideal_field(profile, lattice, device), imaging


def _focus(source: IdealField, imaging: Imaging, **numerics: object) -> Psf:
    return psf(source, imaging, [math.inf], PsfNumerics(window_px=33, **numerics))  # type: ignore[arg-type]


def _dyadic_sum(
    source: IdealField, imaging: Imaging, polarisation: int, u_um: FloatArray, v_um: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """E and H, shape (3, n) each, summed over all sites: E = curl of the potential of the surface field 2 z x E.

    Only the tangential E of the lens plane enters (Smythe 1947): E_x and E_y are its Rayleigh-Sommerfeld sums, E_z the
    sum with -(R_x E_x + R_y E_y) / R_z. H follows by the curl of E of each spherical wave in its far zone, s x E.
    """
    x, y = np.meshgrid(source.lattice.x_um(), source.lattice.y_um())
    amplitude = np.zeros(x.shape, dtype=np.complex128)
    for tile in source.tiles():
        values = tile.amplitude(polarisation)
        amplitude[tile.row : tile.row + values.shape[0], tile.column : tile.column + values.shape[1]] = values
    inside = np.abs(amplitude) > 0.0
    x, y, amplitude = x[inside], y[inside], amplitude[inside]
    k, z = imaging.wavenumber, imaging.sensor_distance_um
    cosine = z / np.sqrt(x**2 + y**2 + z**2)
    s = np.array([-x / z * cosine, -y / z * cosine])
    tangential = np.eye(2)[polarisation][:, None] - s * s[polarisation] / (1.0 + cosine)
    e_site = amplitude / np.sqrt(cosine) * tangential * source.lattice.cell_um2
    electric, magnetic = np.empty((2, 3, u_um.size), dtype=np.complex128)
    for n, (u, v) in enumerate(zip(u_um, v_um, strict=True)):
        r = np.array([u - x, v - y, np.full_like(x, z)])
        distance = np.sqrt((r**2).sum(axis=0))
        kernel = z / (2.0 * np.pi * distance**2) * (1.0 / distance - 1j * k) * np.exp(1j * k * distance)
        e_x, e_y = e_site * kernel
        e = np.array([e_x, e_y, -(r[0] * e_x + r[1] * e_y) / z])
        electric[:, n] = e.sum(axis=1)
        magnetic[:, n] = np.cross(r / distance, e, axis=0).sum(axis=1)
    return electric, magnetic


@pytest.mark.parametrize("sine", [0.6, 0.9])
@pytest.mark.parametrize("polarisation", [0, 1])
def test_flux_and_energy_are_those_of_a_direct_dyadic_sum(sine: float, polarisation: int) -> None:
    source, imaging = _lens(sine, 30.0)
    chosen = np.arange(2, 33, 4)
    u, v = np.meshgrid(*2 * [(chosen - 16) * imaging.pixel_um])
    e, h = _dyadic_sum(source, imaging, polarisation, u.ravel(), v.ravel())
    flux = (e[0] * h[1].conj() - e[1] * h[0].conj()).real.reshape(u.shape)
    energy = (np.abs(e) ** 2).sum(axis=0).reshape(u.shape)
    power = math.pi * 15.0**2
    for numerics, expected in (({"vectorial": True}, flux), ({"energy": True}, energy)):
        found = _focus(source, imaging, target_error=1e-4, **numerics).psf[polarisation, 0][np.ix_(chosen, chosen)]
        # The sum's E_z and H take the direction from each site to the point, the components that to the focus: they
        # differ by the place in the window over the distance.
        error = np.linalg.norm(found - expected / power) / np.linalg.norm(found)
        assert error < (2e-3 if sine < 0.7 else 1e-2)


@pytest.mark.parametrize("sine", [0.3, 0.6, 0.9])
def test_the_focus_is_that_of_the_diffraction_integrals(sine: float) -> None:
    """Along both axes, 60 um wide; the integrals are the limit of many wavelengths."""
    source, imaging = _lens(sine, 60.0)
    radius = np.abs(np.arange(33) - 16) * imaging.pixel_um / WAVELENGTH_UM
    focus = FocusIntegrals.at(radius, sine)
    along_x = (focus.i_0 + focus.i_2) ** 2 + focus.i_1**2
    along_y = (focus.i_0 - focus.i_2) ** 2
    image = _focus(source, imaging, energy=True).psf[0, 0]
    for found, expected in ((image[16], along_x), (image[:, 16], along_y)):
        # The rim is cut along sites of 0.2 um: 2e-3 of the area of the lens at 60 um, and its field accordingly.
        assert np.abs(found / image.max() - expected / expected.max()).max() < 1.5e-2 * (1.0 if sine < 0.8 else 2.0)
    flux = _focus(source, imaging, vectorial=True).psf[0, 0]
    limit = focus.i_0**2 - focus.i_2**2
    for found in (flux[16], flux[:, 16]):
        assert np.abs(found / flux.max() - limit / limit.max()).max() < 1.5e-2 * (1.0 if sine < 0.8 else 2.0)


def test_no_light_is_lost_or_gained() -> None:
    """The flux adds up to the power at the aperture; the energy density exceeds it by the mean of 1 / cos."""
    source, imaging = _lens(0.6, 30.0)
    scalar, flux, energy = (
        _focus(source, imaging, **numerics).efficiency[:, 0]
        for numerics in ({"vectorial": False}, {"vectorial": True}, {"energy": True})
    )
    assert flux == pytest.approx(scalar, abs=2e-4)
    # Mean of 1 / cos over the flux: 2 pi tan / cos^2 d(theta) over pi tan^2, 2 (1 / cos^3 - 1) / (3 tan^2) = 1.13.
    assert energy / flux == pytest.approx([1.13, 1.13], abs=0.02)


def test_it_switches_itself_on_where_it_counts() -> None:
    for sine, on in ((0.2, False), (0.3, True)):
        source, imaging = _lens(sine, 30.0)
        chosen, scalar = _focus(source, imaging), _focus(source, imaging, vectorial=False)
        assert np.array_equal(chosen.psf, scalar.psf) is not on
        if not on:  # its effect is then part of the error
            assert chosen.error[0] - scalar.error[0] == pytest.approx(vectorial_effect(imaging.numerical_aperture))
    assert vectorial_effect(0.05) < 2e-7
