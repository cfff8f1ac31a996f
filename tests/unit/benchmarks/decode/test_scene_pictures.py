"""Pictures with their depth of the scene benchmark: light, depths and the scenes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.decode import scene_pictures
from benchmarks.decode.scene_pictures import FIELD_PX, RANGE_M, rgbd


@pytest.fixture(autouse=True)
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(scene_pictures, "KEPT", tmp_path)
    return tmp_path


@pytest.mark.parametrize("with_pictures", [True, False])
@pytest.mark.parametrize("name", ["motorcycle", "steps", "plain_ground", "room"])
def test_a_picture_fills_the_field_and_the_range(
    name: str, with_pictures: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if with_pictures:
        pytest.importorskip("skimage")
    else:
        monkeypatch.setattr(scene_pictures, "_data", lambda: None)
    scene = rgbd(name, 500.0)(1e-3, 1)
    assert scene.field_px == FIELD_PX and scene.photons_per_pixel == 500.0 and scene.rgbd is not None
    light, depth_m = np.load(scene.rgbd.image_file), scene.rgbd.depths_m()
    assert light.shape == depth_m.shape and light.min() >= 0.0 and np.isfinite(light).all()
    assert (np.nanmin(depth_m), np.nanmax(depth_m)) == pytest.approx(RANGE_M)
    assert np.isfinite(depth_m).mean() > 0.8


def test_files_are_written_once(kept: Path) -> None:
    first = rgbd("plain_ground", 3000.0)(1e-3, 1)
    written_ns = {file: file.stat().st_mtime_ns for file in kept.rglob("*.npy")}
    assert rgbd("plain_ground", 3000.0)(1e-3, 2) == first  # the seed is that of the noise alone
    assert len(written_ns) == 2
    assert {file: file.stat().st_mtime_ns for file in kept.rglob("*.npy")} == written_ns


def test_the_plain_ground_has_no_texture_and_lies_behind() -> None:
    light, depth_m = scene_pictures._plain_ground()
    ground = light == scene_pictures._GROUND
    assert ground.mean() == pytest.approx(2.0 / 3.0, abs=0.01)
    assert depth_m[ground].min() > depth_m[~ground].max()


def test_a_room_recedes_to_its_back_wall_and_its_boxes_stand_before() -> None:
    _, depth_m = scene_pictures._room()
    near_m, far_m = RANGE_M
    middle = np.s_[200:280, 380:480]
    assert (depth_m[middle] == far_m).all()
    np.testing.assert_allclose(depth_m[[0, -1]], near_m)
    for _, box_m, (left, top), _ in scene_pictures._BOXES:
        row, column = (round(0.5 * (1.0 + place) * n) for place, n in zip((top, left), FIELD_PX, strict=True))
        assert depth_m[row, column] == box_m


def test_steps_have_equal_numbers_of_pixels() -> None:
    _, depth_m = scene_pictures._steps()
    _, counts = np.unique(depth_m, return_counts=True)
    assert len(counts) == scene_pictures._STEPS and np.ptp(counts) < 0.01 * depth_m.size
