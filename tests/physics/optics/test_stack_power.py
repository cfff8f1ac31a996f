"""The second reference: against the direct sum, against the PSFs and their stated error, and the account of power."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.core.errors import InputError
from metafab.optics import PsfNumerics, psf, relative_l2
from metafab.optics.geometry.path import Ray, power_at_aperture
from tests import optics_lens as lens
from tests.angular_spectrum import AngularSpectrum

OPTICS = lens.imaging(aperture_um=40.0)
WINDOW_PX = 16
SOURCE = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))


def _axes(centre_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    step = (np.arange(WINDOW_PX) - WINDOW_PX // 2) * OPTICS.pixel_um
    return centre_um[0] + step, centre_um[1] + step


def _incident(depth_m: float, tangent: tuple[float, float], p: int) -> float:
    """Flux through the aperture, in the spectrum's units: that of path lengths times 1/z^2 sec^-3."""
    ray = Ray.towards_image(OPTICS, p, depth_m, tangent)
    distance = 1e6 * depth_m * np.sqrt(1.0 + tangent[0] ** 2 + tangent[1] ** 2)
    return power_at_aperture(OPTICS, ray) * 1e6 * depth_m / distance**3


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.08, -0.06), (-0.25, 0.1)])
@pytest.mark.parametrize("polarisation", [0, 1])
def test_two_references_agree_and_the_stated_error_bounds_both(tangent: tuple[float, float], polarisation: int) -> None:
    """One sums distances, the other directions; they share the sites' amplitudes and nothing else."""
    depths = [0.75e-3, 1.0e-3]
    results = {
        t: psf(SOURCE, OPTICS, depths, PsfNumerics(window_px=WINDOW_PX, target_error=t), tangent=tangent)
        for t in (1e-2, 1e-3)
    }
    for index, depth in enumerate(depths):
        centre = results[1e-3].centre_um[polarisation, index]
        x, y = _axes(centre)
        light = AngularSpectrum.of(SOURCE, OPTICS, depth, tangent, polarisation)
        spectrum = light.irradiance(x, y) / _incident(depth, tangent, polarisation)
        points = lens.window_points(OPTICS, centre, WINDOW_PX)
        direct = direct_irradiance(SOURCE, OPTICS, depth, tangent, *points, polarisation).reshape(spectrum.shape)
        assert relative_l2(spectrum, direct) < 1e-5
        for result in results.values():
            assert relative_l2(result.psf[polarisation, index], spectrum) <= result.error[index]


def test_all_power_is_accounted_for() -> None:
    """Window, the rest of the propagating light, and what stays bound to the lens add up to what is transmitted.

    The window's share comes from pixels on the sensor (the trapezoid rule on a band-limited function), the
    propagating power from directions, the transmitted one from the sites: three separate sums.
    """
    depth = 0.9e-3
    result = psf(SOURCE, OPTICS, [depth], PsfNumerics(window_px=64, target_error=1e-3))
    for p in (0, 1):
        light = AngularSpectrum.of(SOURCE, OPTICS, depth, (0.0, 0.0), p)
        incident = _incident(depth, (0.0, 0.0), p)
        assert light.power / incident == pytest.approx(result.details.transmitted[p], rel=1e-6)
        bound = (light.power - light.propagating_power()) / incident
        # The narrowest features, phase levels of single sites, scatter a little beyond 90 degrees.
        assert 0.0 <= bound < 0.05 * light.power / incident
        step = (np.arange(192) - 96) * OPTICS.pixel_um
        x_um, y_um = result.centre_um[p, 0]
        around = light.irradiance(x_um + step, y_um + step) / incident * OPTICS.pixel_um**2
        window = around[64:128, 64:128].sum()
        assert window == pytest.approx(result.efficiency[p, 0], rel=2.0 * result.error[0])
        beyond = light.propagating_power() / incident - window
        assert result.details.stray[p] == pytest.approx(beyond + bound, abs=2e-3)
        # A wider window only takes from what is stray, and never more than propagates.
        assert window < around.sum() <= light.propagating_power() / incident


def test_a_large_lens_is_refused() -> None:
    optics = lens.imaging(aperture_um=900.0)
    with pytest.raises(InputError, match="sites a side"):
        AngularSpectrum.of(lens.ideal(optics, lens.eq_3_and_4(optics)), optics, 0.3, (0.0, 0.0), 0)
