"""A filter's band: against the plain sum of many wavelengths, and against what a shift of the image must do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics import PsfNumerics, psf, relative_l2
from metafab.optics.propagation.band import at_wavelength
from tests import optics_lens as lens

OPTICS = lens.imaging(aperture_um=40.0)
WINDOW_PX = 16


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.06, -0.04)])
def test_a_band_is_the_sum_of_its_wavelengths(tangent: tuple[float, float]) -> None:
    """Against the direct sum over all sites at 16 Gauss-Legendre wavelengths, on the same pixels.

    The image moves by some 6 pixels in 13 nm: the integrand turns by 3 turns at the highest frequency, which 16
    points, exact to degree 31, carry to better than 1e-6.
    """
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    points = lens.window_points(OPTICS, np.array(OPTICS.image_point_um(0, tangent)), WINDOW_PX)
    total: FloatArray = np.zeros(points[0].size)
    for node, weight in zip(*np.polynomial.legendre.leggauss(16), strict=True):
        there = at_wavelength(OPTICS, OPTICS.wavelength_um + 6.5e-3 * float(node))
        total += 0.5 * weight * direct_irradiance(source, there, 0.9e-3, tangent, *points, 0)
    for target in (1e-2, 1e-3):
        band = psf(
            source,
            OPTICS,
            [0.9e-3],
            PsfNumerics(window_px=WINDOW_PX, target_error=target, filter_fwhm_nm=13.0),
            tangent=tangent,
        )
        assert relative_l2(band.psf[0, 0].ravel(), total) <= band.error[0] <= target
        assert band.details.filter_fwhm_nm == 13.0


def test_a_narrow_band_is_one_wavelength() -> None:
    """The smear of 1e-4 nm is nothing; the two windows' kernels keep to a tenth of the target each, in the field."""
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    one, band = (
        psf(source, OPTICS, [0.9e-3], PsfNumerics(window_px=WINDOW_PX, filter_fwhm_nm=w)) for w in (None, 1e-4)
    )
    assert relative_l2(band.psf, one.psf) < 4e-4
    assert one.details.filter_fwhm_nm is None


def test_the_smear_is_what_the_grating_law_says() -> None:
    """A uniform smear over s multiplies the spectrum along x by sinc(f s), along y by 1.

    s = z (sin theta / lambda) / cos^3 theta x width, the derivative of z tan(asin(lambda x constant)).
    """
    width_nm = 8.0
    source = lens.written(OPTICS, lens.eq_3_and_4(OPTICS), levels=24)
    depth = 1.0 / (1.0 / 300.0 - 1.0 / 450.0) * 1e-6
    one, band = (
        psf(source, OPTICS, [depth], PsfNumerics(window_px=64, target_error=1e-4, filter_fwhm_nm=width))
        for width in (None, width_nm)
    )
    theta = math.radians(lens.ANGLE_DEG)
    moved = OPTICS.sensor_distance_um * lens.SINE / OPTICS.wavelength_um / math.cos(theta) ** 3 * 1e-3 * width_nm
    f = 1.0 / (64 * OPTICS.pixel_um)
    for axis, expected in ((1, np.sinc(f * moved)), (0, 1.0)):
        before, after = (np.fft.fft(result.psf[0, 0].sum(axis=1 - axis)) for result in (one, band))
        share = abs(after[1] / after[0]) / abs(before[1] / before[0])
        # The band's ends are out of focus, too, by 0.5 % of the focal length: some 1e-3 at this frequency.
        assert share == pytest.approx(expected, abs=3e-3)


def test_pixels_that_fold_fringes_are_refused() -> None:
    source = lens.written(OPTICS, lens.eq_3_and_4(OPTICS))
    coarse = replace(OPTICS, pixel_um=6.0)
    with pytest.raises(InputError, match="pixel_um"):
        psf(source, coarse, [0.9e-3], PsfNumerics(window_px=8, filter_fwhm_nm=10.0))
