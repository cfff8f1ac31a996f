"""PSFs against the direct sum over every site, the Airy pattern, and the conservation of power."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.core.conventions import FloatArray
from metafab.optics import Imaging, Psf, PsfNumerics, psf, relative_l2
from metafab.optics.sources.source import Source
from tests import optics_lens as lens

OPTICS = lens.imaging()
WINDOW_PX = 24


def _direct(
    source: Source, optics: Imaging, result: Psf, depth: int, tangent: tuple[float, float], p: int
) -> FloatArray:
    count = result.psf.shape[-1]
    points = lens.window_points(optics, result.centre_um[p, depth], count)
    return direct_irradiance(source, optics, result.depth_m[depth], tangent, *points, p).reshape(count, count)


@pytest.mark.parametrize("target", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.08, -0.06)])
def test_the_stated_error_bounds_the_true_one(target: float, tangent: tuple[float, float]) -> None:
    """Irradiance, position and absolute scale at once: nothing is fitted between the two ways."""
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    result = psf(
        source, OPTICS, [0.75e-3, 1.0e-3], PsfNumerics(window_px=WINDOW_PX, target_error=target), tangent=tangent
    )
    for depth, polarisation in ((0, 0), (1, 1)):
        true = _direct(source, OPTICS, result, depth, tangent, polarisation)
        error = relative_l2(result.psf[polarisation, depth], true)
        assert error <= result.error[depth]
        assert result.error[depth] <= 1.5 * target


def test_a_square_aperture_and_an_object_at_infinity() -> None:
    """The reference takes finite depths only: 1 km is infinity to 1e-7 of a wave here."""
    optics = replace(OPTICS, aperture_shape="square", aperture_um=40.0, sensor_distance_um=300.0)
    source = lens.ideal(optics, lens.eq_3_and_4(optics))
    result = psf(source, optics, [math.inf], PsfNumerics(window_px=WINDOW_PX, target_error=1e-4))
    for polarisation in (0, 1):
        points = lens.window_points(optics, result.centre_um[polarisation, 0], WINDOW_PX)
        true = direct_irradiance(source, optics, 1e3, (0.0, 0.0), *points, polarisation)
        assert relative_l2(result.psf[polarisation, 0].ravel(), true) <= result.error[0]


def test_a_plain_lens_gives_the_airy_pattern() -> None:
    """Focus on the axis: pi R^2 / (lambda s)^2 [2 J1(v)/v]^2 per unit power, s the distance of the focus.

    At NA 0.02 the exact kernel differs from the paraxial one by NA^2 / 2 = 2e-4. The rim's sites make the aperture
    ragged: its area, known exactly, enters squared, its shape by some 1e-4 in the far side lobes.
    """
    optics = Imaging(
        wavelength_um=0.8,
        focal_length_mm=2.5,
        split_angle_deg=0.0,
        sensor_distance_um=2500.0,
        pixel_um=4.0,
        aperture_um=100.0,
    )
    f = optics.focal_length_mm * 1e3
    source = lens.ideal(optics, lambda x, y, p: -optics.wavenumber * (np.hypot(np.hypot(x, y[:, None]), f) - f))
    result = psf(source, optics, [math.inf], PsfNumerics(window_px=32, target_error=1e-4))
    x, y = lens.window_points(optics, np.zeros(2), 32)
    v = optics.wavenumber * 50.0 * np.hypot(x, y) / f
    airy = np.where(v > 0.0, (2.0 * j1(np.where(v > 0.0, v, 1.0)) / np.where(v > 0.0, v, 1.0)) ** 2, 1.0)
    area = sum(np.count_nonzero(tile.amplitude(0)) for tile in source.tiles()) * 0.35**2
    airy *= area**2 / (math.pi * 50.0**2) / (0.8 * f) ** 2
    for polarisation in (0, 1):
        assert relative_l2(result.psf[polarisation, 0].ravel(), airy) < 1e-3


def test_efficiencies_add_up_to_the_transmitted_power() -> None:
    """A large window takes nearly all light of a lens; the rest is its far side lobes, which fall like 1/r.

    The power outside a square window of half width w is about 2 / (pi v) with v = k NA w (Born and Wolf 8.5.2
    for a circle); and window plus stray plus lost light is 1 by construction of the three, of which the first is
    summed on the sensor and the second on the lens.
    """
    source = lens.written(OPTICS, lens.eq_3_and_4(OPTICS), levels=24)
    depth = 1.0 / (1.0 / 300.0 - 1.0 / 450.0) * 1e-6
    result = psf(source, OPTICS, [depth], PsfNumerics(window_px=96, target_error=1e-3))
    half_width = 48 * OPTICS.pixel_um
    v = OPTICS.wavenumber * (0.5 * OPTICS.aperture_um / OPTICS.sensor_distance_um) * half_width
    for index in (0, 1):
        # 24 levels keep sinc^2(1/24) = 0.994 of the light in the image, 0.81 of it passes.
        expected = 0.81 * np.sinc(1.0 / 24.0) ** 2 * (1.0 - 2.0 / (math.pi * v))
        assert result.efficiency[index, 0] == pytest.approx(expected, abs=0.01)
        parts = [result.efficiency[index, 0], result.details.stray[index], result.details.lost[index]]
        assert sum(parts) == pytest.approx(1.0, abs=1e-9)
        assert result.details.transmitted[index] == pytest.approx(0.81, abs=1e-3)


def test_the_other_polarisations_light_in_the_window_is_not_an_alias() -> None:
    """Unwanted power against the direct sum of y's field over x's window."""
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    result = psf(source, OPTICS, [0.9e-3], PsfNumerics(window_px=WINDOW_PX))
    points = lens.window_points(OPTICS, result.centre_um[0, 0], WINDOW_PX)
    unwanted = direct_irradiance(source, OPTICS, 0.9e-3, (0.0, 0.0), *points, 1).sum() * OPTICS.pixel_um**2
    assert result.efficiency[0, 0] / result.extinction_ratio[0] == pytest.approx(unwanted, rel=0.02)


def test_field_points_are_the_pairs_of_their_directions() -> None:
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    t_x, t_y = np.array([-0.05, 0.0, 0.05]), np.array([0.04])
    whole = psf(source, OPTICS, [0.8e-3, 0.9e-3], PsfNumerics(window_px=WINDOW_PX), field_tangents=(t_x, t_y))
    assert whole.field is not None and whole.field.psf.shape == (2, 2, 1, 3, WINDOW_PX, WINDOW_PX)
    for row, column in np.ndindex(1, 3):
        alone = psf(source, OPTICS, [0.8e-3, 0.9e-3], PsfNumerics(window_px=WINDOW_PX), tangent=(t_x[column], t_y[row]))
        assert whole.field.centre_um[:, :, row, column] == pytest.approx(alone.centre_um)
        error = relative_l2(whole.field.psf[:, :, row, column], alone.psf)
        assert error < whole.details.field_error + alone.error.max()


def test_no_pillars_give_no_light() -> None:
    source = lens.written(OPTICS, lens.eq_3_and_4(OPTICS))
    source.table[:] = 0.0
    result = psf(source, OPTICS, [0.9e-3], PsfNumerics(window_px=16))
    assert not result.psf.any() and not result.efficiency.any()
    assert math.isnan(result.extinction_ratio[0])


def test_one_pillar_is_a_point_source() -> None:
    """A single site radiates h: cell area (which is the aperture) times (z / (lambda R^2))^2 on the sensor."""
    optics = replace(OPTICS, aperture_um=0.35, aperture_shape="square", split_angle_deg=0.0)
    source = lens.ideal(optics, lambda x, y, p: np.zeros((y.size, x.size)))
    source = replace(source, lattice=replace(source.lattice, shape=(1, 1)))
    result = psf(source, optics, [0.9e-3], PsfNumerics(window_px=16))
    x, y = lens.window_points(optics, np.zeros(2), 16)
    r2 = x**2 + y**2 + optics.sensor_distance_um**2
    expected = 0.35**2 * (optics.sensor_distance_um / (0.8 * r2)) ** 2
    assert result.psf[0, 0].ravel() == pytest.approx(expected, rel=1e-4)
