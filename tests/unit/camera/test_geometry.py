"""The image map: places of directions and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.camera.geometry import ImageMap
from metafab.optics.point_spread import Psf
from tests.conjugate_pair import helix_psf

DEPTHS_M = np.linspace(0.0025, 0.0034, 7)
TANGENTS = np.linspace(-0.1, 0.1, 5)
MAP_PSF = helix_psf(np.array([0.003]), window_px=8, tangents=(TANGENTS, TANGENTS))


@pytest.fixture(scope="module")
def field_psf() -> Psf:
    return helix_psf(DEPTHS_M, window_px=32, tangents=(TANGENTS, TANGENTS))


@given(st.floats(-0.11, 0.11), st.floats(-0.11, 0.11), st.sampled_from([0, 1]))
def test_sensor_and_direction_are_inverse(tangent_x: float, tangent_y: float, polarisation: int) -> None:
    image_map = ImageMap.from_psf(MAP_PSF)
    place = image_map.to_sensor_um(polarisation, np.array(tangent_x), np.array(tangent_y))
    back = image_map.to_tangent(polarisation, *place)
    assert back[0] == pytest.approx(tangent_x, abs=1e-9)
    assert back[1] == pytest.approx(tangent_y, abs=1e-9)


def test_the_map_meets_the_calibrated_points(field_psf: Psf) -> None:
    assert field_psf.field is not None
    image_map = ImageMap.from_psf(field_psf)
    for polarisation in (0, 1):
        x, y = image_map.to_sensor_um(polarisation, *np.meshgrid(TANGENTS, TANGENTS))
        assert np.stack([x, y], axis=-1) == pytest.approx(field_psf.field.centre_um[polarisation, 3], abs=1e-6)


def test_the_map_follows_the_grating_law_between_the_points(field_psf: Psf) -> None:
    """Chief ray: sin(theta) -+ x/sqrt(1 + x^2); five points give it to a thousandth of a pixel."""
    between = 0.5 * (TANGENTS[1:] + TANGENTS[:-1])
    x, _ = ImageMap.from_psf(field_psf).to_sensor_um(1, between, np.zeros(4))
    slope = np.sin(np.radians(8.0)) - between / np.hypot(1.0, between)
    assert x == pytest.approx(field_psf.sensor_distance_um * slope / np.sqrt(1.0 - slope**2), abs=2.4e-3)


def test_the_jacobian_is_the_derivative(field_psf: Psf) -> None:
    image_map, step = ImageMap.from_psf(field_psf), 1e-6
    at = np.array(0.05), np.array(-0.03)
    jacobian = image_map.jacobian_um(0, *at)
    for axis in (0, 1):
        shifted = [t + step * (i == axis) for i, t in enumerate(at)]
        change = np.subtract(image_map.to_sensor_um(0, *shifted), image_map.to_sensor_um(0, *at)) / step
        assert jacobian[:, axis] == pytest.approx(change, rel=1e-4, abs=1e-2)


def test_without_field_points_the_image_is_an_inverting_pinholes() -> None:
    psf = helix_psf(DEPTHS_M, window_px=32)
    x, y = ImageMap.from_psf(psf).to_sensor_um(0, np.array(0.05), np.array(0.02))
    assert x == pytest.approx(psf.centre_um[0, 3, 0] - 0.05 * psf.sensor_distance_um)
    assert y == pytest.approx(psf.centre_um[0, 3, 1] - 0.02 * psf.sensor_distance_um)
