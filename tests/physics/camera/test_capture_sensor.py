"""What the sensor does: photon statistics, dark current, fixed pattern, shutters, vignetting, and shapes in depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.camera import RawFrame, capture, film
from metafab.camera.capture import FixedPattern, expose
from metafab.camera.rendering.motion import Shutter
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL = SceneObject(depth_m=0.0029, size=(0.4, 0.4), texture="uniform")


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32)


def scene(*objects: SceneObject, **settings: object) -> Scene:
    return Scene(objects=objects or (WALL,), **{"read_noise_e": 0.0, "field_px": (64, 64), **settings})


def exposed(level_e: float, seed: int = 1, **settings: object) -> FloatArray:
    sensor, shape = scene(**settings), (256, 256)
    return expose(np.full(shape, level_e), sensor, FixedPattern.of(sensor, shape, 7), np.random.default_rng(seed))


def inner_x(frame: RawFrame) -> FloatArray:
    """The x image's field without the rim that its blur softens."""
    assert frame.x_window is not None
    row, column, rows, columns = frame.x_window
    return frame.frame[row + 16 : row + rows - 16, column + 16 : column + columns - 16]


def test_variance_grows_by_one_electron_squared_an_electron() -> None:
    """The photon transfer line: read noise squared plus the mean, electron for electron."""
    levels = np.array([50.0, 200.0, 800.0, 3200.0])
    variance = np.array([exposed(level, read_noise_e=5.0).var() for level in levels])
    # 65536 pixels: 0.55 % a variance; four standard deviations.
    assert variance == pytest.approx(levels + 25.0, rel=0.022)


def test_rounding_of_dark_pixels_changes_no_other_pixel() -> None:
    """A mean of 0 once took no random number, and one of 1e-28 did: a frame differed by the machine's rounding."""
    sensor, shape = scene(), (32, 32)
    pattern, mean_e = FixedPattern.of(sensor, shape, 7), np.full(shape, 300.0)
    mean_e[::2] = 0.0
    rounded = np.where(mean_e == 0.0, np.random.default_rng(2).normal(0.0, 1e-28, shape), mean_e)
    first, second = (expose(mean, sensor, pattern, np.random.default_rng(1)) for mean in (mean_e, rounded))
    np.testing.assert_array_equal(first, second)


def test_unequal_pixels_add_a_variance_with_the_square_of_the_mean_that_differences_remove() -> None:
    first, second = (exposed(1e5, seed, response_rms=0.02) for seed in (1, 2))
    assert first.var() == pytest.approx(1e5 + (0.02 * 1e5) ** 2, rel=0.03)
    assert (first - second).var() / 2.0 == pytest.approx(1e5, rel=0.03)


def test_dark_current_adds_noise_with_the_exposure_and_no_mean() -> None:
    dark = exposed(0.0, dark_current_e_per_s=1e4, exposure_s=0.03, dark_e=100.0)
    assert dark.mean() == pytest.approx(0.0, abs=0.4)  # 20 electrons over 256 pixels a side: 0.08
    assert dark.var() == pytest.approx(400.0, rel=0.03)


def test_half_the_quantum_efficiency_is_half_the_electrons_at_their_own_noise(psf: Psf) -> None:
    full, half = (
        capture(scene(photons_per_pixel=4e4, quantum_efficiency=efficiency), psf) for efficiency in (1.0, 0.5)
    )
    assert inner_x(half).mean() == pytest.approx(0.5 * inner_x(full).mean(), rel=1e-3)
    assert full.truth is not None
    assert half.truth is not None
    assert half.truth.intensity_x == pytest.approx(0.5 * full.truth.intensity_x)


def test_hot_pixels_stay_in_place_from_frame_to_frame(psf: Psf) -> None:
    settings = {"full_well_e": 1e4, "hot_pixels": 0.01, "frames": 2}
    first, second = (frame.frame == 1e4 for frame in film(scene(**settings), psf))
    assert first.sum() > 50
    assert (first == second).all()


def test_vignetting_is_the_fourth_power_of_the_cosine(psf: Psf) -> None:
    """Against the same wall without it: the lens' and the surface's projection, twice each."""
    settings = {"photons_per_pixel": 1e9}
    natural, none = (capture(scene(vignetting=kind, **settings), psf) for kind in ("natural", "none"))
    assert natural.truth is not None
    assert none.truth is not None
    pixel = psf.pixel_um / psf.sensor_distance_um
    y, x = (np.mgrid[:64, :64] - 32) * pixel
    assert natural.truth.intensity_x / none.truth.intensity_x == pytest.approx((1.0 + x**2 + y**2) ** -2, abs=2e-4)
    assert inner_x(natural) / inner_x(none) == pytest.approx(((1.0 + x**2 + y**2) ** -2)[16:-16, 16:-16], abs=2e-3)


def moving(speed_px_per_s: float, psf: Psf, **settings: object) -> Scene:
    """An edge that moves to +x of the scene, -x of the image, on a dark ground."""
    speed = speed_px_per_s * psf.pixel_um / psf.sensor_distance_um * WALL.depth_m
    edge = SceneObject(
        depth_m=WALL.depth_m, centre=(-0.2, 0.0), size=(0.4, 0.4), texture="uniform", velocity_m_per_s=(speed, 0.0, 0.0)
    )
    return scene(edge, photons_per_pixel=1e8, vignetting="none", **settings)


def edge_columns(frame: RawFrame) -> FloatArray:
    """Where the x image's edge is in each inner row: the light right of it with all of its blur, from the right."""
    assert frame.x_window is not None
    row, column, rows, columns = frame.x_window
    light = frame.frame[row + 16 : row + rows - 16, column - 16 : column + columns + 16]
    return -light.sum(axis=1) / inner_x(frame).max()


def test_a_rolling_shutter_skews_a_moving_edge_by_its_speed(psf: Psf) -> None:
    speed, row_s = 500.0, 2e-4
    times = {"exposure_s": 0.0, "row_time_s": row_s, "frame_interval_s": 0.04}
    rolling = capture(moving(speed, psf, **times), psf)
    slope = np.polyfit(np.arange(32), edge_columns(rolling), 1)[0]
    # The image is inverted: the edge moves towards smaller columns, by 0.1 pixels a row.
    assert slope == pytest.approx(-speed * row_s, rel=0.05)
    still = capture(moving(speed, psf, **{**times, "row_time_s": 0.0}), psf)
    assert np.polyfit(np.arange(32), edge_columns(still), 1)[0] == pytest.approx(0.0, abs=2e-3)


def test_the_truth_of_a_rolling_shutter_is_skewed_with_the_frame(psf: Psf) -> None:
    frame = capture(moving(500.0, psf, exposure_s=0.0, row_time_s=2e-4, frame_interval_s=0.04), psf)
    assert frame.truth is not None
    shift = np.polyfit(np.arange(64), -(frame.truth.label == 1).sum(axis=1), 1)[0]
    assert shift == pytest.approx(-0.1, rel=0.1)


@given(st.floats(0.0, 0.03), st.floats(0.0, 3e-4), st.integers(1, 100))
def test_every_row_is_exposed_once_about_its_middle(exposure_s: float, row_time_s: float, rows: int) -> None:
    fast = SceneObject(depth_m=1.0, velocity_m_per_s=(1.0, 0.0, 0.0))
    film_scene = Scene(objects=(fast,), exposure_s=exposure_s, row_time_s=row_time_s, field_px=(100, 64))
    shutter = Shutter.of(film_scene, 0.5, rows, 1e-3)
    assert shutter.weights.sum(axis=1) == pytest.approx(1.0, abs=1e-9)
    assert (shutter.weights >= 0.0).all()
    part_s = (exposure_s + row_time_s * (rows - 1)) / shutter.instants_s.size
    assert shutter.weights @ shutter.instants_s == pytest.approx(shutter.middle_s, abs=0.51 * part_s + 1e-12)


def test_a_ball_rises_towards_its_middle(psf: Psf) -> None:
    """z = z0 (1 + 4 b (u^2 + v^2)): the truth's depth over the outline, to half a step of 0.4 %."""
    ball = SceneObject(depth_m=0.0027, size=(0.06, 0.06), outline="ellipse", bulge=(0.05, 0.05))
    frame = capture(scene(ball), psf)
    assert frame.truth is not None
    pixel = psf.pixel_um / psf.sensor_distance_um
    y, x = (np.mgrid[:64, :64] - 32) * pixel / 0.06
    inside = np.hypot(x, y) < 0.45
    expected = 0.0027 * (1.0 + 0.2 * (x**2 + y**2))
    assert frame.truth.depth_m[inside] == pytest.approx(expected[inside], rel=3.5e-3)
    assert ball.relative_depths == pytest.approx((0.0, 0.1))


def test_a_tilted_bulge_is_lowest_at_its_vertex() -> None:
    piece = SceneObject(depth_m=1.0, tilt=(0.1, 0.0), bulge=(0.1, -0.02))
    u = np.linspace(-0.5, 0.5, 2001)
    heights = 0.1 * u + 0.4 * u**2
    assert piece.relative_depths == pytest.approx((heights.min() - 0.02, heights.max()), abs=1e-6)


def test_a_scenes_depths_span_tilts_and_films() -> None:
    leaving = SceneObject(depth_m=0.3, tilt=(0.1, 0.0), velocity_m_per_s=(0.0, 0.0, 0.1))
    shown = Scene(objects=(leaving,), frames=11, frame_interval_s=0.1)
    assert (shown.depths_m[0], shown.depths_m[-1]) == pytest.approx((0.285, 0.42))


@pytest.mark.parametrize("wrong", [{"bulge": (0.4, 0.2)}, {"tilt": (0.9, 0.2)}])
def test_shapes_that_reach_the_lens_are_refused(wrong: dict[str, tuple[float, float]]) -> None:
    with pytest.raises(InputError, match="at most half"):
        SceneObject(depth_m=1.0, **wrong)


def test_a_rolling_shutter_slower_than_the_film_is_refused() -> None:
    with pytest.raises(InputError, match="row_time_s"):
        scene(row_time_s=1e-3)
