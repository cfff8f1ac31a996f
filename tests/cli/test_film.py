"""``metafab capture --frames`` and ``metafab film``: a moving scene as files, as figures, and as a moving picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from metafab import camera, optics, report
from metafab.core.errors import InputError, MissingToolError
from metafab.decode import decode
from metafab.spec import Scene, SceneObject, load_scene
from metafab.steps.images import capture_batch
from tests.conjugate_pair import helix_psf
from tests.main_job import SMALL, metafab

SCENE = """
field_px = [72, 72]
frames = 3
frame_interval_s = 0.05
vignetting = "none"
[[objects]]
depth_m = 0.0028
centre = [-0.02, 0.0]
size = [0.06, 0.08]
velocity_m_per_s = [0.001, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that moves by 26 micrometres a frame at 2.8 mm, and the pair that sees it."""
    path = tmp_path_factory.mktemp("film")
    (path / "scene.toml").write_text(SCENE)
    optics.save(helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32), path / "psf.h5")
    return path


def test_frames_are_files_whose_truth_moves(folder: Path) -> None:
    answer = metafab("capture", folder / "scene.toml", "--psf", folder / "psf.h5", "-o", folder / "raw.h5", "--frames",
                     "3", "--json")  # fmt: skip
    assert answer.code == 0, answer.stderr
    files = [Path(name) for name in answer.json["files"]]
    assert [file.name for file in files] == ["raw_0001.h5", "raw_0002.h5", "raw_0003.h5"]
    middles = []
    for file in files:
        truth = camera.load(file).truth
        assert truth is not None
        middles.append(np.argwhere(truth.label == 1)[:, 1].mean())
    # Inverted: to smaller columns, by 1 mm/s x 0.05 s / 2.8 mm = 0.0179 of tangent = 11.05 pixels a frame.
    assert np.diff(middles) == pytest.approx(-0.05e-3 / 0.0028 * 1485.4 / 2.4, abs=0.2)


def test_one_frame_is_one_file_with_the_first_frames_bytes(folder: Path) -> None:
    answer = metafab("capture", folder / "scene.toml", "--psf", folder / "psf.h5", "-o", folder / "one.h5", "--json")
    assert answer.code == 0, answer.stderr
    assert Path(answer.json["file"]).name == "one.h5"
    assert camera.load(folder / "one.h5").frame.shape == tuple(answer.json["shape"])
    command = ("decode", folder / "one.h5", "--psf", folder / "psf.h5", "-o", folder / "decoded.h5", "--json")
    refined, fast = metafab(*command), metafab(*command, "--fast")
    assert fast.code == 0, fast.stderr
    # One plane: nothing to refine but the outliers at its rim.
    assert fast.json["nmae"] == pytest.approx(refined.json["nmae"], abs=1e-3)


def test_a_batch_of_two_scenes_is_one_file(folder: Path) -> None:
    still = SCENE.replace("velocity_m_per_s = [0.001, 0.0, 0.0]", "")
    (folder / "still.toml").write_text(still)
    command = ("capture", folder / "scene.toml", folder / "still.toml", "--psf", folder / "psf.h5", "--json")
    answer = metafab(*command, "--draws", "2", "--seed", "4", "-o", folder / "batch.h5")
    assert answer.code == 0, answer.stderr
    assert answer.json["shape"][0] == 4
    assert [camera.load_draw(folder / "batch.h5", number).seed for number in range(4)] == [4, 5, 6, 7]
    third = metafab("capture", folder / "still.toml", "--psf", folder / "psf.h5", "--seed", "6", "-o",
                    folder / "third.h5", "--json")  # fmt: skip
    assert third.code == 0, third.stderr
    alone = camera.load(folder / "third.h5").frame.astype(np.float32)
    np.testing.assert_array_equal(camera.load_draw(folder / "batch.h5", 2).frame.frame, alone)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--draws", "2", "-o", "batch.tif"], "ending with .h5"),
        (["--draws", "2", "--frames", "2"], "--frames"),
        ([], "--draws N"),
    ],
)  # fmt: skip
def test_a_batch_refuses_what_it_cannot_hold(folder: Path, options: list[str], words: str) -> None:
    answer = metafab("capture", folder / "scene.toml", folder / "scene.toml", "--psf", folder / "psf.h5", *options)
    assert answer.code == 2
    assert words in answer.stderr


def test_scenes_of_unlike_fields_are_refused_before_the_first_frame(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    n_y, n_x = scene.field_px
    scenes = [(Path("one.toml"), scene), (Path("two.toml"), replace(scene, field_px=(n_y + 8, n_x)))]
    calls: list[tuple[str, int, int]] = []

    def progress(what: str, done: int, total: int) -> None:
        calls.append((what, done, total))

    with pytest.raises(InputError, match=rf"(?s)two\.toml.*field_px.*{n_y} x {n_x}.*one\.toml.*{n_y + 8} x {n_x}"):
        capture_batch(scenes, folder / "psf.h5", folder / "unlike.h5", 2, progress=progress)
    assert not calls
    assert not (folder / "unlike.h5").exists()


def _picture(folder: Path, name: str, depth_m: float, *more: str) -> Path:
    """A scene file of a picture with one depth."""
    np.save(folder / f"{name}_light.npy", np.ones((72, 72)))
    np.save(folder / f"{name}_depth.npy", np.full((72, 72), depth_m))
    files = f'image_file = "{name}_light.npy"\ndepth_file = "{name}_depth.npy"\n'
    (folder / f"{name}.toml").write_text("\n".join([*more, "field_px = [72, 72]", "[rgbd]", files]))
    return folder / f"{name}.toml"


@pytest.mark.parametrize(("depth_m", "words"), [(0.3, "inside the PSF calibration"), (-1.0, "above zero")])
def test_a_batch_names_the_scene_file_at_fault_before_the_first_frame(folder: Path, depth_m: float, words: str) -> None:
    sound, unfit = _picture(folder, "sound", 0.0028), _picture(folder, "unfit", depth_m)
    scenes = [(path, load_scene(path)) for path in (sound, unfit)]
    calls: list[tuple[str, int, int]] = []
    with pytest.raises(InputError, match=words) as refused:
        capture_batch(scenes, folder / "psf.h5", folder / "no.h5", 2, progress=lambda *call: calls.append(call))
    assert not calls and not (folder / "no.h5").exists()
    # The scene's own fault, or that of a file which it names.
    assert refused.value.source.split(" -> ")[0] == str(unfit)


def test_errors_of_objects_name_the_scene_file_in_frames_films_and_batches(folder: Path) -> None:
    (folder / "far.toml").write_text(SCENE.replace("0.0028", "0.28"))
    pair = ("--psf", folder / "psf.h5")
    for command in (
        ("capture", folder / "far.toml", *pair, "-o", folder / "no.h5"),
        ("film", folder / "far.toml", *pair, "-o", folder / "no.gif"),
        ("capture", folder / "scene.toml", folder / "far.toml", *pair, "--draws", "1", "-o", folder / "no.h5"),
    ):
        answer = metafab(*command)
        assert answer.code == 2
        assert f"{folder / 'far.toml'}:" in answer.stderr and "inside the PSF calibration" in answer.stderr


def test_psfs_of_a_picture_are_refused_by_the_name_of_its_scene_file(folder: Path) -> None:
    scene = _picture(folder, "picture", 0.0028)
    answer = metafab("psf", "--ideal", "--design", SMALL, "--scene", scene, "-o", folder / "no.h5")
    assert answer.code == 2
    assert f"{scene}:\n  `rgbd`: expected objects" in answer.stderr


def test_a_film_is_decoded_frame_by_frame_and_drawn(folder: Path) -> None:
    command = ("film", folder / "scene.toml", "--psf", folder / "psf.h5", "--json", "-o")
    first, second = (metafab(*command, folder / name) for name in ("a.gif", "b.gif"))
    assert first.code == 0, first.stderr
    assert first.json["frames"] == 3
    # One object of known depth; the pair that made the frames decodes them.
    assert max(first.json["nmae"]) < 0.02
    assert first.json["changed_share"][0] == 1.0
    # The scene's only object, in each frame; the worst of one is itself.
    assert [list(errors) for errors in first.json["objects"]] == [["1"]] * 3
    assert [abs(errors["1"]) for errors in first.json["objects"]] == first.json["worst_object_error"]
    assert max(first.json["worst_object_error"]) < 0.02
    assert (folder / "a.gif").read_bytes() == (folder / "b.gif").read_bytes()
    assert second.code == 0
    picture = Image.open(folder / "a.gif")
    assert picture.n_frames == 3
    assert picture.info["duration"] == 50
    frames = []
    for number in range(3):
        picture.seek(number)
        frames.append(np.asarray(picture.convert("RGB"), dtype=float))
    # The object leaves its place in every frame: the panels differ, the margins do not.
    assert np.abs(frames[2] - frames[0]).max() > 100.0
    assert (frames[2][:2] == frames[0][:2]).all()


def test_the_scene_stands_upright(tmp_path: Path) -> None:
    """An object above the axis is in the lower half of the sensor, and in the upper half of the picture."""
    pair = helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32)
    above = SceneObject(depth_m=0.0028, centre=(0.0, 0.04), size=(0.06, 0.04))
    raw = camera.capture(Scene(objects=(above,), field_px=(72, 72)), pair)
    assert np.argmax(raw.frame.sum(axis=1)) < raw.frame.shape[0] / 2
    report.write_film([(raw, decode(raw, pair))], tmp_path / "one.gif", frame_interval_s=0.1)
    picture = np.asarray(Image.open(tmp_path / "one.gif").convert("L"), dtype=float)
    dark = np.flatnonzero((picture < 10).mean(axis=1) > 0.4)
    panel = picture[dark[0] : dark[0] + round(picture.shape[1] * 0.96 * raw.frame.shape[0] / raw.frame.shape[1])]
    upper, lower = panel[: len(panel) // 2], panel[len(panel) // 2 :]
    assert (upper[upper < 250] > 60).mean() > 3.0 * (lower[lower < 250] > 60).mean()


def test_other_names_and_a_missing_ffmpeg_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        report.require_film_name(tmp_path / "film.avi")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(MissingToolError, match="ffmpeg"):
        report.require_film_name(tmp_path / "film.mp4")
