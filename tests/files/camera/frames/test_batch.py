"""batch.h5: frames of several scenes and seeds with their truth, read back by metafab and by HDF5 alone."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.camera import Draw, batch, capture, load_draw, save_batch
from metafab.camera.frames.frame import Truth
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

#: Textures of the first change with the seed, those of the second do not.
SCENES = (
    Scene(objects=(SceneObject(depth_m=0.003, size=(0.04, 0.04)),), field_px=(40, 48)),
    Scene(
        objects=(SceneObject(depth_m=0.0028, size=(0.03, 0.04), texture="checker"),),
        field_px=(40, 48),
        full_well_e=4000.0,
    ),
)


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0027, 0.0032, 3), window_px=32)


@pytest.fixture(scope="module")
def all_draws(psf: Psf) -> list[Draw]:
    return list(batch(SCENES, psf, 2, 5))


@pytest.fixture(scope="module")
def batch_file(psf: Psf, all_draws: list[Draw], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("batch") / "batch.h5"
    save_batch(iter(all_draws), len(all_draws), ["one.toml", "two.toml"], psf, path)
    return path


def test_each_draw_is_the_frame_of_its_seed(psf: Psf, all_draws: list[Draw]) -> None:
    for draw in all_draws:
        alone = capture(SCENES[draw.scene], psf, seed=draw.seed)
        np.testing.assert_array_equal(draw.frame.frame, alone.frame)
    assert (all_draws[0].frame.frame != all_draws[1].frame.frame).mean() > 0.9


def test_frames_survive_their_file_in_single_precision(batch_file: Path, all_draws: list[Draw]) -> None:
    for number, draw in enumerate(all_draws):
        back = load_draw(batch_file, number)
        assert (back.scene, back.seed) == (draw.scene, draw.seed)
        np.testing.assert_array_equal(back.frame.frame, draw.frame.frame.astype(np.float32))
        assert back.frame.truth is not None
        assert draw.frame.truth is not None
        for item in fields(Truth):
            np.testing.assert_allclose(getattr(back.frame.truth, item.name), getattr(draw.frame.truth, item.name), 1e-7)
        for name in ("pixel_um", "origin_um", "truth_origin_um", "x_window", "read_noise_e", "saturation_e"):
            assert getattr(back.frame, name) == getattr(draw.frame, name)


def test_a_learner_finds_all_of_it_without_metafab(batch_file: Path, psf: Psf) -> None:
    with h5py.File(batch_file) as file:
        assert file["seed"][...].tolist() == [5, 6, 7, 8]
        assert file["scene"][...].tolist() == [0, 0, 1, 1]
        assert file["scene_file"][...].tolist() == [b"one.toml", b"two.toml"]
        np.testing.assert_array_equal(file["pair/psf"][...], psf.psf)
        assert file["frame"].chunks[0] == 1  # one frame is read without the others
        for name in ("frame", "truth/depth_m", "truth/label"):
            group = file[name].parent
            assert file[name].dims[0][0] == file["number"]
            assert file[name].dims[2][0] == group["x_um"]
            assert file[name].shape[2] == group["x_um"].size
        # Not the columns of the frames, which are called alike.
        assert file["pair/psf"].dims[3][0] == file["pair/x_um"]


def test_scenes_of_unlike_fields_leave_no_file(psf: Psf, all_draws: list[Draw], tmp_path: Path) -> None:
    path = tmp_path / "batch.h5"
    path.write_bytes(b"an earlier one")
    wider = capture(replace(SCENES[0], field_px=(40, 56)), psf)
    with pytest.raises(InputError, match=r"(?s)two\.toml.*field_px"):
        save_batch([all_draws[0], Draw(1, 9, wider)], 2, ["one.toml", "two.toml"], psf, path)
    assert [file.name for file in tmp_path.iterdir()] == ["batch.h5"]
    assert path.read_bytes() == b"an earlier one"


def test_a_full_disk_is_an_error_before_a_frame_is_written(
    psf: Psf, all_draws: list[Draw], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr("metafab.core.storage.hdf5.shutil.disk_usage", lambda _: usage)
    with pytest.raises(OSError, match="No space"):
        save_batch(all_draws[:1], 1, ["one.toml"], psf, tmp_path / "batch.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [-1, 4])
def test_a_missing_frame_and_a_damaged_file_are_refused(batch_file: Path, tmp_path: Path, number: int) -> None:
    with pytest.raises(InputError, match=f"0 to 3, got {number}"):
        load_draw(batch_file, number)
    damaged = tmp_path / "damaged.h5"
    content = bytearray(batch_file.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        load_draw(damaged, 0)
