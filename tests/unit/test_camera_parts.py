"""Parts of the camera: the image map, interpolated kernels, textures, rendered pieces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.render import Renderer
from metafab.camera.rendering.texture import make_texture
from metafab.core.conventions import FloatArray
from metafab.optics.interpolation.field import spline_weights
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

DEPTHS_M = np.linspace(0.0025, 0.0034, 7)
TANGENTS = np.linspace(-0.1, 0.1, 5)


@pytest.fixture(scope="module")
def field_psf() -> Psf:
    return helix_psf(DEPTHS_M, window_px=32, tangents=(TANGENTS, TANGENTS))


@given(st.floats(-0.11, 0.11), st.floats(-0.11, 0.11), st.sampled_from([0, 1]))
def test_sensor_and_direction_are_inverse(tangent_x: float, tangent_y: float, polarisation: int) -> None:
    image_map = ImageMap.from_psf(_MAP_PSF)
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


@given(st.integers(1, 9), st.floats(-2.0, 2.0))
def test_spline_weights_sum_to_one_and_interpolate(count: int, at: float) -> None:
    nodes = np.sort(np.cos(np.arange(count) * 1.3)) if count > 1 else np.zeros(1)
    assert spline_weights(nodes, at).sum() == pytest.approx(1.0, abs=1e-9)
    assert spline_weights(nodes, nodes) == pytest.approx(np.eye(count), abs=1e-9)


def test_kernels_between_depths_are_the_pair_at_that_depth() -> None:
    """Nodes 0.17 rad of rotation apart: the measured law of cubic interpolation allows a per cent."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0034, 1 / 0.0025, 7)[::-1], window_px=32)
    middle = 2.0 / (1.0 / psf.depth_m[2] + 1.0 / psf.depth_m[3])
    exact = PairKernels(helix_psf(np.array([middle]), window_px=32)).at_depth(middle)
    got = PairKernels(psf).at_depth(middle)
    exact, got = exact / exact.sum(), got / got.sum()
    assert np.linalg.norm(got - exact) < 0.01 * np.linalg.norm(exact)


@pytest.mark.parametrize("kind", ["fractal", "checker"])
def test_textures_have_mean_one_and_the_asked_contrast(kind: str) -> None:
    spec = SceneObject(depth_m=1.0, texture=kind, texture_contrast=0.25)
    texture = make_texture(spec, (96, 96), np.random.default_rng(1))
    place = (np.arange(384) + 0.5) / 384
    values = texture(*np.meshgrid(place, place))
    # Cubic sampling between texels smooths a 1/f pattern by some per cent.
    assert values.mean() == pytest.approx(1.0, abs=0.01)
    assert values.std() == pytest.approx(0.25, rel=0.06)
    assert values.min() >= 0.0


def test_a_picture_as_texture_keeps_its_top_up(tmp_path: Path) -> None:
    picture = np.zeros((32, 32))
    picture[:16] = 200.0  # the picture's upper half is bright
    np.save(tmp_path / "picture.npy", picture)
    spec = SceneObject(depth_m=1.0, texture="image", texture_file=tmp_path / "picture.npy", texture_contrast=0.3)
    texture = make_texture(spec, (8, 8), np.random.default_rng(1))
    assert texture(np.array([0.5]), np.array([0.8]))[0] > 1.2
    assert texture(np.array([0.5]), np.array([0.2]))[0] < 0.8


def grid(count: int = 64, half: float = 0.05) -> tuple[FloatArray, FloatArray]:
    tangent = -np.linspace(-half, half, count)  # images are inverted
    x, y = np.meshgrid(tangent, tangent)
    return x, y


@pytest.mark.parametrize(("outline", "share"), [("rectangle", 1.0), ("ellipse", np.pi / 4.0)])
def test_coverage_is_the_area(outline: str, share: float) -> None:
    piece = SceneObject(depth_m=1.0, centre=(0.003, -0.002), size=(0.041, 0.0317), outline=outline)
    x, y = grid()
    (rendered,) = Renderer.of(Scene(objects=(piece,)), 0.1 / 63, 1).pieces(x, y)
    area = rendered.coverage.sum() * (0.1 / 63) ** 2
    # Exact for a rectangle; an ellipse's edge is taken as straight across a quarter of a pixel.
    assert area == pytest.approx(share * 0.041 * 0.0317, rel=1e-9 if outline == "rectangle" else 3e-3)


def test_a_tilted_piece_is_made_of_adjoining_steps() -> None:
    flat = SceneObject(depth_m=1.0, size=(0.06, 0.06))
    tilted = SceneObject(depth_m=1.0, size=(0.06, 0.06), tilt=(0.1, 0.0))
    x, y = grid()
    (one,), (many,) = (tuple(Renderer.of(Scene(objects=(o,)), 1e-3, 1).pieces(x, y)) for o in (flat, tilted))
    assert many.depth_m.size == 25
    assert many.depth_m[[0, -1]] == pytest.approx([0.952, 1.048])
    assert many.coverage.sum(axis=0) == pytest.approx(one.coverage[0], abs=1e-12)
    # Depth rises with x/z, and so falls along the columns of the inverted image.
    first = np.flatnonzero(many.coverage[0].sum(axis=0))
    last = np.flatnonzero(many.coverage[-1].sum(axis=0))
    assert first.min() > last.max()


_MAP_PSF = helix_psf(np.array([0.003]), window_px=8, tangents=(TANGENTS, TANGENTS))
