"""Each sentence of ``metafab.core.conventions`` that optics can test, executed (cells have a file of their own)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.core.conventions import FloatArray, image_distance_mm, sensor_distance_um, wrap_phase
from metafab.optics import Imaging, PsfNumerics, psf, relative_l2
from metafab.optics.geometry.path import Ray
from metafab.optics.measures.metrics import main_lobe_px
from tests import optics_lens as lens

OPTICS = lens.imaging()
#: Object distance at which the lens of ``optics_lens`` is sharp: 1/z = 1/f - 1/(1.5 f).
FOCUS_M = 0.9e-3


@given(st.floats(-1e4, 1e4))
def test_phases_are_wrapped_to_minus_pi_excluded_pi_included(phase_rad: float) -> None:
    wrapped = float(wrap_phase(phase_rad))
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - phase_rad) == pytest.approx(1.0, abs=1e-9)


def test_minus_pi_becomes_pi() -> None:
    assert float(wrap_phase(-math.pi)) == math.pi


def test_a_longer_path_has_the_larger_phase() -> None:
    """A phase that grows towards +x is a longer path there: the light leaves towards +x, as from a prism."""
    optics = replace(OPTICS, split_angle_deg=0.0, sensor_distance_um=300.0)

    def wedge(x_um: FloatArray, y_um: FloatArray, polarisation: str) -> FloatArray:
        return np.asarray(optics.wavenumber * 0.05 * x_um[None, :] + 0.0 * y_um[:, None])

    source = lens.ideal(optics, wedge)
    x = np.linspace(-60.0, 60.0, 121)
    irradiance = direct_irradiance(source, optics, 10.0, (0.0, 0.0), x, np.zeros_like(x), 0)
    centroid = float(np.sum(x * irradiance) / np.sum(irradiance))
    assert centroid == pytest.approx(0.05 * 300.0, rel=0.1)


def test_path_grows_with_distance() -> None:
    """Removing exp(-ik path) is undone by exp(+ik path): path is positive where the way over (x, y) is longer."""
    ray = Ray(1.0 / 900.0, (0.0, 0.0), (0.0, 0.0, 450.0))
    way = math.hypot(30.0, 900.0) + math.hypot(30.0, 450.0) - 1350.0
    assert float(ray.path_um(np.array(30.0), np.array(0.0))) == pytest.approx(way, rel=1e-12)


def test_the_first_row_is_the_lowest_y_and_the_first_column_the_lowest_x() -> None:
    """A plain lens' lobe, seen in a window centred for another direction, moves to where its image is.

    The object at +y is imaged at -y (inverted): its lobe lies in rows below the centre row; likewise for x.
    """
    source = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))
    centre = OPTICS.image_point_um(0, (0.0, 0.0))
    x, y = lens.window_points(OPTICS, np.array(centre), 32)
    for tangent, axis in (((0.02, 0.0), 1), ((0.0, 0.02), 0)):
        image = direct_irradiance(source, OPTICS, FOCUS_M, tangent, x, y, 0).reshape(32, 32)
        place = np.unravel_index(int(np.argmax(image)), image.shape)
        assert place[axis] < 16 and abs(int(place[1 - axis]) - 16) <= 1


@pytest.mark.parametrize("polarisation", [0, 1])
@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.06, 0.0), (-0.06, 0.0), (0.0, 0.06), (0.05, -0.04)])
def test_the_centre_pixel_is_the_geometric_image_point(polarisation: int, tangent: tuple[float, float]) -> None:
    """Traced: the main lobe of a plain split lens lies on the grating-law image, within half an Airy radius.

    The image is inverted, and pixel centres lie on integers times the pitch about it. What remains is coma.
    """
    result = psf(
        lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS)), OPTICS, [FOCUS_M], PsfNumerics(window_px=32), tangent=tangent
    )
    airy_px = 0.61 * 0.8 * OPTICS.sensor_distance_um / (0.5 * OPTICS.aperture_um) / OPTICS.pixel_um
    x, y, _ = main_lobe_px(result.psf[polarisation, 0])
    assert math.hypot(x, y) < 0.5 * airy_px
    pinhole = -np.array(tangent) * OPTICS.sensor_distance_um
    moved = result.centre_um[polarisation, 0] - OPTICS.image_point_um(polarisation, (0.0, 0.0))
    for axis in (0, 1):
        assert moved[axis] == pytest.approx(pinhole[axis], rel=0.12, abs=2.0)


def test_x_polarisation_focuses_at_minus_theta_and_y_at_plus_theta() -> None:
    """The signs of Eqs. 3 and 4: on the sensor's plane the light of x lies at x = -z tan(theta)."""
    source = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))
    aside = OPTICS.sensor_distance_um * math.tan(math.radians(lens.ANGLE_DEG))
    both = np.array([-aside, aside])
    x_light = direct_irradiance(source, OPTICS, FOCUS_M, (0.0, 0.0), both, np.zeros(2), 0)
    y_light = direct_irradiance(source, OPTICS, FOCUS_M, (0.0, 0.0), both, np.zeros(2), 1)
    assert x_light[0] > 100.0 * x_light[1]
    assert y_light[1] > 100.0 * y_light[0]


def test_the_sensor_stands_where_the_focus_depth_is_sharp() -> None:
    """1/s' = 1/f - 1/z, plane at s' cos(theta): of objects at all depths, the one at z has the brightest lobe there.

    The split lens of Eq. 3 is made for infinity: a finite depth's vergence w enters as w across the plane of
    incidence and as w / cos^2 in it. Between the two line foci, w is (1 + cos^2) / 2 of the stated one (1 % less).
    Its spherical aberration at finite depth, some k r^4 / (8 f^3) = 0.03 rad at the rim, weighs as much as 0.8 %
    of the object's own 3.9 rad.
    """
    f_mm, angle = OPTICS.focal_length_mm, OPTICS.split_angle_deg
    stated = sensor_distance_um(f_mm, angle, FOCUS_M)
    assert stated == pytest.approx(image_distance_mm(f_mm, FOCUS_M) * 1e3 * math.cos(math.radians(angle)))
    assert stated == pytest.approx(OPTICS.sensor_distance_um)
    source = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))
    relative = np.linspace(1.2, 0.8, 13)
    peaks = psf(source, OPTICS, FOCUS_M / relative, PsfNumerics(window_px=16)).psf.max(axis=(2, 3))
    fine = np.linspace(0.8, 1.2, 4001)
    between = 0.5 * (1.0 + math.cos(math.radians(angle)) ** 2)
    for polarisation in (0, 1):
        best = fine[np.argmax(np.polynomial.Polynomial.fit(relative, peaks[polarisation], 4)(fine))]
        assert best == pytest.approx(between, abs=0.008)


def test_an_object_nearer_than_the_focal_length_has_no_image() -> None:
    with pytest.raises(ValueError, match="no real image"):
        image_distance_mm(20.0, 0.02)


@pytest.mark.parametrize("depth_m", [0.75e-3, FOCUS_M, 1.1e-3])
def test_the_pair_is_conjugate(depth_m: float) -> None:
    """PSF_y(x, y; z) = PSF_x(-x, -y; z), each about its geometric image point; exact on the axis.

    It follows from psi_y(x, y) = psi_x(-x, -y) and the mirrored lattice, so only rounding and the stated error
    (blocks are mirrored too, up to one block at the rim) are left.
    """
    source = lens.ideal(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    result = psf(source, OPTICS, [depth_m], PsfNumerics(window_px=33, target_error=1e-4))
    assert relative_l2(result.psf[1, 0], result.psf[0, 0, ::-1, ::-1]) < 2.0 * result.error[0]


def test_off_axis_the_pair_is_conjugate_for_opposite_fields() -> None:
    """PSF_y(r; field) = PSF_x(-r; -field)."""
    source = lens.ideal(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    here = psf(source, OPTICS, [FOCUS_M], PsfNumerics(window_px=33, target_error=1e-4), tangent=(0.05, 0.03))
    there = psf(source, OPTICS, [FOCUS_M], PsfNumerics(window_px=33, target_error=1e-4), tangent=(-0.05, -0.03))
    assert relative_l2(here.psf[1, 0], there.psf[0, 0, ::-1, ::-1]) < 2.0 * (here.error[0] + there.error[0])
    assert here.centre_um[1, 0] == pytest.approx(-there.centre_um[0, 0])


def test_orientation_is_that_of_x_and_turns_counter_clockwise_with_depth() -> None:
    """``phi_deg`` against the lobe of PSF_x; y's lobe lies opposite. Charges that grow outwards turn it this way."""
    source = lens.ideal(OPTICS, lens.eq_2(OPTICS, zones=4), lens.eq_3_and_4(OPTICS))
    depths = 1.0 / np.linspace(1e3 / 0.75, 1e3 / 1.05, 5)
    result = psf(source, OPTICS, depths, PsfNumerics(window_px=48))
    assert np.all(np.diff(result.phi_deg) > 0.0)
    for index in range(5):
        x, y, _ = main_lobe_px(result.psf[0, index])
        other_x, other_y, _ = main_lobe_px(result.psf[1, index])
        assert result.phi_deg[index] == pytest.approx(math.degrees(math.atan2(y, x)))
        assert (other_x, other_y) == pytest.approx((-x, -y), abs=0.05)


def test_irradiance_is_per_power_and_area() -> None:
    """Halving the pitch quarters the power a pixel stands for, not the irradiance at the pixels in common."""
    source = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))
    coarse = psf(source, OPTICS, [FOCUS_M], PsfNumerics(window_px=16, target_error=1e-4))
    fine = psf(
        source, replace(OPTICS, pixel_um=0.5 * OPTICS.pixel_um), [FOCUS_M], PsfNumerics(window_px=32, target_error=1e-4)
    )
    assert relative_l2(fine.psf[:, :, ::2, ::2], coarse.psf) < fine.error[0] + coarse.error[0]


def test_the_optical_axis_passes_through_the_lattice_centre() -> None:
    assert isinstance(OPTICS, Imaging)
    for count in (5, 6):
        lattice = replace(lens.lattice(OPTICS), shape=(count, count))
        assert lattice.x_um().sum() == pytest.approx(0.0, abs=1e-12)
        assert np.diff(lattice.x_um()) == pytest.approx(0.35)
