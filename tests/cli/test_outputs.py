"""A result that cannot stand in its place is refused before the work, with code 2, and no input is written over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.cli.outputs import require_file_output, require_output
from metafab.core.errors import InputError
from tests.main_job import SMALL, UNIT_CELL, metafab

SCENE = """field_px = [64, 64]
[[objects]]
depth_m = 0.003
texture = "image"
texture_file = "texture.png"
"""

#: Commands whose inputs are files without content: whichever is read first would be refused.
COMMANDS = {
    "decode": ["decode", "empty.h5", "--psf", "empty.h5"],
    "capture": ["capture", "empty.toml", "--psf", "empty.h5"],
    "batch": ["capture", "empty.toml", "--psf", "empty.h5", "--draws", "2"],
    "psf import": ["psf", "import", "empty.h5", "--depths", "1", "2", "3", "--pixel-um", "1"],
    "calibrate": ["calibrate", "empty.h5", "--psf", "empty.h5", "--depths", "empty.csv"],
    "fullwave": ["fullwave", "empty.json", "--library", "empty.h5", "--solver", "model"],
    "psf": ["psf", "--ideal", "--design", str(SMALL)],
    "library build": ["library", "build", str(UNIT_CELL)],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for ending in ("h5", "toml", "csv", "json"):
        (tmp_path / f"empty.{ending}").touch()
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
@pytest.mark.parametrize("place", ["empty.csv/result.h5", "empty.csv/further/result.h5"])
def test_a_closed_place_is_refused_before_the_work(command: list[str], place: str, folder: Path) -> None:
    before = sorted(folder.iterdir())
    answer = metafab(*command, "-o", place, cwd=folder)
    assert (answer.code, answer.stdout) == (2, "")
    assert "`output`: expected a place that can be written, got empty.csv/" in answer.stderr
    assert sorted(folder.iterdir()) == before


def test_the_same_without_a_name_for_the_result(folder: Path) -> None:
    (folder / "decoded.h5").mkdir()
    answer = metafab("decode", "empty.h5", "--psf", "empty.h5", cwd=folder)
    assert answer.code == 2
    assert "`output`: expected the name of a file, got the folder decoded.h5" in answer.stderr


#: Commands of results that are one file, and of results that are a folder of files.
ONE_FILE = {
    **{name: COMMANDS[name] for name in ("psf", "library build", "decode")},
    "library show": ["library", "show", "empty.h5"],
    "propose": ["propose", "--range-m", "1", "2", "--aperture-um", "100"],
    "tolerance": ["tolerance", "empty.h5", "--design", str(SMALL)],
    "exposure": ["expose", "empty.h5", "--design", str(SMALL), "-o", "folder.json"],
}
FOLDERS = {
    "run": ["run", str(SMALL)],
    "layout": ["layout", str(SMALL)],
    "drc": ["drc", "empty.h5", "--design", str(SMALL)],
    "expose": ["expose", "empty.h5", "--design", str(SMALL), "--correct"],
    "stokes": ["stokes", str(SMALL)],
    "compare": ["compare", str(SMALL)],
    "new": ["new", "lens", "--kind", "metalens"],
    "benchmark": ["benchmark", "cell"],
}


@pytest.mark.parametrize("command", ONE_FILE.values(), ids=ONE_FILE)
def test_a_folder_is_no_place_for_a_file(command: list[str], folder: Path) -> None:
    for name in ("folder.h5", "folder.json"):
        (folder / name).mkdir()
    answer = metafab(*command, *(() if "-o" in command else ("-o", "folder.h5")), cwd=folder)
    assert (answer.code, answer.stdout) == (2, "")
    assert "`output`: expected the name of a file, got the folder folder." in answer.stderr


@pytest.mark.parametrize("command", FOLDERS.values(), ids=FOLDERS)
def test_a_file_is_no_place_for_a_folder(command: list[str], folder: Path) -> None:
    before = sorted(folder.iterdir())
    answer = metafab(*command, "-o", "empty.csv", cwd=folder)
    assert (answer.code, answer.stdout) == (2, "")
    assert "`output`: expected a folder, old or new, got the file empty.csv; name another" in answer.stderr
    assert sorted(folder.iterdir()) == before


@pytest.mark.skipif(not Path("/proc/version").is_file(), reason="needs a folder in which not even root can write")
def test_rights_alone_do_not_open_a_place() -> None:
    with pytest.raises(InputError, match="can be written"):
        require_output(Path("/proc/result.h5"))


def test_an_open_place_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "old.h5").write_text("old")
    for name in ("old.h5", "new.h5", "new folder/\u00e9/new.h5"):
        require_file_output(tmp_path / name, [tmp_path / "other.h5"])
    assert [path.name for path in tmp_path.iterdir()] == ["old.h5"]
    assert (tmp_path / "old.h5").read_text() == "old"


@pytest.mark.parametrize(
    "command",
    [
        ["calibrate", "a.h5", "psf.h5", "--psf", "b.h5", "--depths", "empty.csv", "-o", "psf.h5"],
        ["psf", "import", "psf.h5", "--depths", "1", "2", "3", "--pixel-um", "1"],  # its result is psf.h5 by default
        ["psf", "import", "a.h5", "--depths", "psf.h5", "--pixel-um", "1"],
        ["capture", "scene.toml", "--psf", "b.h5", "-o", "texture.png"],
        ["capture", "a.toml", "b.toml", "--psf", "psf.h5", "--draws", "2", "-o", "psf.h5"],
    ],
)  # fmt: skip
def test_no_input_is_written_over(command: list[str], folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE)
    for name in ("a.h5", "b.h5", "psf.h5", "texture.png"):
        (folder / name).write_text(name)
    answer = metafab(*command, cwd=folder)
    assert answer.code == 2
    assert "expected a file of its own" in answer.stderr
    assert all((folder / name).read_text() == name for name in ("a.h5", "b.h5", "psf.h5", "texture.png"))


@pytest.mark.parametrize(
    "command",
    [
        ["decode", "a.tif", "--psf", "b.h5", "--read-noise-e", "1e300"],
        ["psf", "import", "a.npy", "--depths", "1", "2", "3", "--pixel-um", "1e300"],
        ["psf", "import", "a.npy", "--depths", "1", "2", "3", "--pixel-um", "1", "--split-um", "0", "-1e16"],
    ],
)  # fmt: skip
def test_a_number_beyond_all_units_is_refused(command: list[str], tmp_path: Path) -> None:
    answer = metafab(*command, cwd=tmp_path)
    assert answer.code == 2
    assert "1e+15" in answer.stderr


def test_a_batch_holds_its_seeds(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("[[objects]]\ndepth_m = 0.003\n")
    command = ("capture", "scene.toml", "--psf", "none.h5", "--draws", "2", "-o", "batch.h5", "--seed")
    answer = metafab(*command, str(2**63 - 1), cwd=tmp_path)
    assert (answer.code, "`seed`: expected a seed of which the last of 2 is below 2^63" in answer.stderr) == (2, True)


def test_frames_of_a_film_are_not_written_over_pictures_of_the_scene(tmp_path: Path) -> None:
    """The names that count are those of the frames."""
    np.save(tmp_path / "texture_0002.npy", np.ones((4, 4)))
    lines = ("[[objects]]", "depth_m = 0.003", 'texture = "image"', 'texture_file = "texture_0002.npy"')
    (tmp_path / "scene.toml").write_text("\n".join(lines) + "\n")
    command = ("capture", "scene.toml", "--psf", "none.h5", "--frames", "2", "-o")
    answer = metafab(*command, "texture.npy", cwd=tmp_path)
    assert (answer.code, "texture_0002.npy" in answer.stderr) == (2, True)
    assert "none.h5" in metafab(*command, "other.npy", cwd=tmp_path).stderr
