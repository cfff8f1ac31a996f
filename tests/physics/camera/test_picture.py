"""A picture with its depth: the same frames as objects give, continuous depths, holes, and outlines by geometry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.core.conventions import FloatArray, sensor_distance_um
from metafab.core.errors import InputError
from metafab.core.storage.limits import limited
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject, load_scene
from metafab.spec.scene import Rgbd
from tests.conjugate_pair import ANGLE_DEG, FOCAL_LENGTH_MM, FOCUS_DEPTH_M, PIXEL_UM, helix_psf

PIXEL = PIXEL_UM / sensor_distance_um(FOCAL_LENGTH_MM, ANGLE_DEG, FOCUS_DEPTH_M)
DEPTHS_M = np.linspace(0.0025, 0.0034, 10)
SIDE = 48
#: Photons at which shot noise is below 1e-4, and a sensor without any other.
QUIET = {"field_px": (SIDE, SIDE), "photons_per_pixel": 1e9, "read_noise_e": 0.0, "vignetting": "none"}


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(DEPTHS_M, window_px=32)


def picture(folder: Path, light: FloatArray, depth_m: FloatArray, **more: object) -> Scene:
    np.save(folder / "light.npy", light)
    np.save(folder / "depth.npy", depth_m)
    return Scene(rgbd=Rgbd(image_file=folder / "light.npy", depth_file=folder / "depth.npy", **more), **QUIET)


def inner(frame: RawFrame) -> FloatArray:
    assert frame.x_window is not None
    row, column, n_y, n_x = frame.x_window
    return frame.frame[row + 14 : row + n_y - 14, column + 14 : column + n_x - 14]


def test_a_picture_of_one_depth_is_an_object_of_that_depth(psf: Psf, tmp_path: Path) -> None:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    light = 1.0 + 0.5 * np.sin(columns / 5.0) * np.sin(rows / 7.0)
    flat = capture(picture(tmp_path, light, np.full(light.shape, 0.00283)), psf)
    size = (SIDE * PIXEL, SIDE * PIXEL)
    np.save(tmp_path / "texture.npy", light)
    contrast = float(light.std() / light.mean())
    texture = {"texture": "image", "texture_file": tmp_path / "texture.npy", "texture_contrast": contrast}
    same = capture(Scene(objects=(SceneObject(depth_m=0.00283, size=size, **texture),), **QUIET), psf)
    assert flat.truth is not None and same.truth is not None
    # Texels are joined linearly here and by cubic splines there; the rims differ by a part of a pixel.
    assert np.abs(inner(flat) / inner(same) - 1.0).max() < 0.01
    assert np.nanmax(np.abs(flat.truth.depth_m - 0.00283)) < 1e-9
    sharp = [truth.intensity_x[2:-2, 2:-2].ravel() for truth in (flat.truth, same.truth)]
    assert np.corrcoef(*sharp)[0, 1] > 0.999


def test_depth_is_continuous(psf: Psf, tmp_path: Path) -> None:
    """A ramp of depth against a tilted object in its steps of 0.4 %."""
    across = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    ramp = np.broadcast_to(0.0029 * (1.0 + 0.1 * across), (SIDE, SIDE))
    light = np.broadcast_to(1.0 + 0.5 * np.sign(np.sin(np.arange(SIDE) / 2.0))[:, None], (SIDE, SIDE))
    mine = capture(picture(tmp_path, light, ramp), psf)
    np.save(tmp_path / "texture.npy", light)
    texture = {"texture": "image", "texture_file": tmp_path / "texture.npy"}
    contrast = float(light.std() / light.mean())
    size = (SIDE * PIXEL, SIDE * PIXEL)
    tilted = SceneObject(depth_m=0.0029, size=size, tilt=(0.1, 0.0), texture_contrast=contrast, **texture)
    other = capture(Scene(objects=(tilted,), **QUIET), psf)
    assert mine.truth is not None and other.truth is not None
    assert np.nanmax(np.abs(mine.truth.depth_m / other.truth.depth_m - 1.0)) < 0.004
    assert np.abs(inner(mine) - inner(other)).max() < 0.05 * inner(other).max()


def test_a_hole_is_dark_and_unknown(psf: Psf, tmp_path: Path) -> None:
    depth_m = np.full((SIDE, SIDE), 0.003)
    depth_m[:, :24] = np.nan
    frame = capture(picture(tmp_path, np.ones((SIDE, SIDE)), depth_m), psf)
    assert frame.truth is not None
    # The image is inverted: the picture's left is the frame's right.
    known = np.isfinite(frame.truth.depth_m)
    assert known[:, :22].all() and not known[:, 26:].any()
    assert (frame.truth.intensity_x[~known] == 0.0).all() and (frame.truth.label == known).all()
    whole = capture(picture(tmp_path, np.ones((SIDE, SIDE)), np.full((SIDE, SIDE), 0.003)), psf)
    assert frame.frame.sum() / whole.frame.sum() == pytest.approx(0.5, abs=0.02)


def test_a_picture_whose_known_depths_fall_between_the_pixels_is_dark(psf: Psf, tmp_path: Path) -> None:
    depth_m = np.full((2 * SIDE, 2 * SIDE), np.nan)
    depth_m[::2, ::2] = 0.003  # Pixels of the field take the depths of odd rows and columns.
    frame = capture(picture(tmp_path, np.ones(depth_m.shape), depth_m), psf)
    assert frame.truth is not None
    assert not np.isfinite(frame.truth.depth_m).any() and (frame.frame == 0.0).all()


def test_an_outline_hides_by_geometry_and_touching_depths_do_not(psf: Psf, tmp_path: Path) -> None:
    """Before a far wall, the light beside a near half and behind its outline is that of the objects."""
    depth_m = np.full((SIDE, SIDE), 0.0033)
    depth_m[:, 24:] = 0.0026
    whole = capture(picture(tmp_path, np.ones((SIDE, SIDE)), depth_m), psf)
    frame = inner(whole)
    size = (SIDE * PIXEL, SIDE * PIXEL)
    wall = SceneObject(depth_m=0.0033, size=size, texture="uniform")
    half = replace(wall, depth_m=0.0026, centre=(0.25 * size[0], 0.0), size=(0.5 * size[0], size[1]))
    objects = inner(capture(Scene(objects=(wall, half), **QUIET), psf))
    assert np.abs(frame - objects).max() < 0.02 * objects.max()
    depth_m[:, 24:] = 0.003301
    flat = inner(capture(picture(tmp_path, np.ones((SIDE, SIDE)), depth_m), psf))
    alone = capture(picture(tmp_path, np.ones((SIDE, SIDE)), np.full((SIDE, SIDE), 0.0033)), psf)
    assert np.abs(flat / inner(alone) - 1.0).max() < 1e-3
    # What is hidden on one side of the outline is seen on the other.
    assert whole.frame.sum() == pytest.approx(alone.frame.sum(), rel=0.02)


def test_scaled_depths_contrast_and_paths(tmp_path: Path, psf: Psf) -> None:
    from PIL import Image

    counts = np.full((24, 24), 200, dtype=np.uint8)
    counts[:12], counts[0, 0] = 100, 0
    Image.fromarray(counts).save(tmp_path / "depth.png")
    Image.fromarray(np.full((24, 24), 90, dtype=np.uint8)).save(tmp_path / "light.png")
    np.savez(tmp_path / "ratio.npz", np.full((24, 24), 3.0))
    (tmp_path / "scene.toml").write_text(
        'field_px = [48, 48]\nphotons_per_pixel = 1e8\n[rgbd]\nimage_file = "light.png"\ndepth_file = "depth.png"\n'
        'contrast_file = "ratio.npz"\ndepth_range_m = [0.0026, 0.0032]\n'
    )
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.depths_m == pytest.approx((0.0026, 0.0032))
    frame = capture(scene, psf)
    assert frame.truth is not None
    known = np.isfinite(frame.truth.depth_m)
    assert 0 < (~known).sum() <= 9
    # Top row first: the nearer half is at +y, lowest in the inverted image.
    assert np.nanmax(frame.truth.depth_m[:20]) == pytest.approx(0.0026)
    ratio = frame.truth.intensity_x[known] / frame.truth.intensity_y[known]
    assert ratio == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("depth_m", "more", "message"),
    [
        (np.full((SIDE, SIDE), 0.01), {}, "inside the PSF calibration"),
        (np.full((SIDE, 9), 0.003), {}, "shape"),
        (np.full((SIDE, SIDE), np.nan), {}, "known depths"),
        (np.full((SIDE, SIDE), -1.0), {}, "above zero"),
        (np.full((SIDE, SIDE), 3), {}, "depth_range_m"),
    ],
)
def test_what_is_no_depth_is_refused(
    psf: Psf, tmp_path: Path, depth_m: FloatArray, more: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        capture(picture(tmp_path, np.ones((SIDE, SIDE)), depth_m, **more), psf)


def test_a_scene_is_objects_or_a_picture(tmp_path: Path) -> None:
    (tmp_path / "both.toml").write_text(
        '[rgbd]\nimage_file = "a.png"\ndepth_file = "b.npy"\n[[objects]]\ndepth_m = 1.0\n'
    )
    (tmp_path / "none.toml").write_text("seed = 1\n")
    (tmp_path / "order.toml").write_text('[rgbd]\nimage_file="a.png"\ndepth_file="b.npy"\ndepth_range_m = [0.6, 0.3]\n')
    for name, message in (("both", "one of both"), ("none", "one of both"), ("order", "near < far")):
        with pytest.raises(InputError, match=message):
            load_scene(tmp_path / f"{name}.toml")


@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_light_has_any_unit(scale: float, psf: Psf, tmp_path: Path) -> None:
    light, depth_m = 1.0 + np.random.default_rng(2).random((SIDE, SIDE)), np.full((SIDE, SIDE), 0.00283)
    frames = [capture(picture(tmp_path, unit * light, depth_m), psf).frame for unit in (1.0, scale)]
    assert np.abs(frames[1] - frames[0]).max() < 1e-3 * frames[0].max()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("light", np.nan, "rgbd.image_file.*got values such as nan in 1 of 2304 pixels; set such pixels to 0"),
        ("light", -2.0, "rgbd.image_file.*got values such as -2 in 1 of 2304"),
        ("contrast", 0.0, "rgbd.contrast_file.*got values such as 0 in 1 of 2304 pixels; set such pixels to 1"),
        ("contrast", 1e40, "rgbd.contrast_file.*at most 1e.15, got values such as 1e.40 in 1 of 2304 pixels; set such"),
    ],
)
def test_a_value_that_makes_no_sense_is_named(name: str, value: float, message: str, psf: Psf, tmp_path: Path) -> None:
    arrays = {"light": np.ones((SIDE, SIDE)), "contrast": np.ones((SIDE, SIDE))}
    arrays[name][3, 4] = value
    np.save(tmp_path / "contrast.npy", arrays["contrast"])
    depth_m = np.full((SIDE, SIDE), 0.00283)
    scene = picture(tmp_path, arrays["light"], depth_m, contrast_file=tmp_path / "contrast.npy")
    with pytest.raises(InputError, match=message):
        capture(scene, psf)


def test_a_field_beyond_all_memory_is_refused_before_any_is_taken(psf: Psf, tmp_path: Path) -> None:
    scene = picture(tmp_path, np.ones((SIDE, SIDE)), np.full((SIDE, SIDE), 0.00283))
    with pytest.raises(InputError, match=r"field_px.*at most 1.6e.07 pixels.*got 1000000 x 1000000"):
        capture(replace(scene, field_px=(1_000_000, 1_000_000)), psf)


def test_a_field_above_16_million_pixels_says_what_limit_it_needs(psf: Psf, tmp_path: Path) -> None:
    scene = picture(tmp_path, np.ones((SIDE, SIDE)), np.full((SIDE, SIDE), 0.00283))
    with pytest.raises(InputError, match=r"got 4000 x 4200, which take 4301 MB; .*`--limit memory_mb=N`"):
        capture(replace(scene, field_px=(4000, 4200)), psf)
    # With that limit, the field is refused for its images alone, which overlap.
    with limited(memory_mb=4301), pytest.raises(InputError, match="side by side"):
        capture(replace(scene, field_px=(4000, 4200)), psf)


def test_all_missing_files_are_named(psf: Psf, tmp_path: Path) -> None:
    scene = picture(tmp_path, np.ones((SIDE, SIDE)), np.full((SIDE, SIDE), 0.00283), contrast_file=tmp_path)
    (tmp_path / "light.npy").unlink()
    with pytest.raises(InputError) as refused:
        capture(scene, psf)
    assert [fault.field for fault in refused.value.faults] == ["rgbd.image_file", "rgbd.contrast_file"]
