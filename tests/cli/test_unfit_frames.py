"""``metafab decode`` of frames that no camera takes: refused with 2, and what lay under the output's name stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from metafab import camera, decode, optics
from metafab.cli import entry
from metafab.core.errors import InputError
from metafab.spec import Scene, SceneObject
from metafab.steps.images import decode_file
from tests.conjugate_pair import helix_psf
from tests.main_job import metafab

SHAPE = (176, 350)


@pytest.fixture(scope="module")
def psf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("unfit") / "psf.h5"
    optics.save(helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32), path)
    return path


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones((8, 8)), "does not hold both images"),
        (np.full(SHAPE, np.nan), "no finite number"),
        (np.full(SHAPE, -5.0), "at most -5"),
        (np.full(SHAPE, 1e308), "up to 1e\\+15"),
    ],
    ids=["small", "nan", "negative", "huge"],
)
def test_an_unfit_frame_replaces_nothing(tmp_path: Path, psf: Path, values: np.ndarray, message: str) -> None:
    raw, output = tmp_path / "raw.npy", tmp_path / "decoded.h5"
    np.save(raw, values)
    output.write_bytes(b"an older result")
    with pytest.raises(InputError, match=f"`frame`: .*{message}"):
        decode_file(raw, psf, output)
    assert output.read_bytes() == b"an older result"
    # A run goes on: its report says why there is no image.
    assert decode_file(raw, psf, output, unfit="empty").figures.reason
    assert not np.isfinite(decode.load(output).depth_m).any()


def test_the_command_exits_with_2_for_an_unfit_frame_and_says_that_one_is_dark(tmp_path: Path, psf: Path) -> None:
    raw, output = tmp_path / "raw.npy", tmp_path / "decoded.h5"
    np.save(raw, np.full(SHAPE, np.nan))
    answer = metafab("decode", raw, "--psf", psf, "-o", output, "--json")
    assert (answer.code, answer.stdout, output.exists()) == (2, "", False)
    np.save(raw, np.zeros(SHAPE))
    answer = metafab("decode", raw, "--psf", psf, "-o", output, "--json")
    assert answer.code == 0, answer.stderr
    assert f"metafab: {raw}: {decode.NO_LIGHT}" in answer.stderr
    assert answer.json["reason"] == decode.NO_LIGHT
    assert not np.isfinite(decode.load(output).depth_m).any()


@pytest.fixture(scope="module")
def counts(tmp_path_factory: pytest.TempPathFactory, psf: Path) -> np.ndarray:
    """A good frame, as a camera hands it over: 16-bit counts, the axis in the middle."""
    scene = Scene(objects=(SceneObject(depth_m=0.0029, size=(0.12, 0.12)),), field_px=(96, 96), seed=2)
    path = tmp_path_factory.mktemp("good") / "frame.tif"
    camera.save_counts(camera.capture(scene, optics.load(psf)), path)
    return np.asarray(tifffile.imread(path))


def decoded(
    raw: Path, psf: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *options: str
) -> tuple[int, str]:
    """Exit code and what was said, by the command itself; anything but an exit is a failure."""
    command = ["metafab", "decode", str(raw), "--psf", str(psf), "-o", str(raw) + ".out.h5", *options]
    monkeypatch.setattr("sys.argv", command)
    code = 0
    try:
        entry.main()
    except SystemExit as left:
        code = int(left.code or 0)
    said = capsys.readouterr()
    return code, said.out + said.err


def as_file(kind: str, counts: np.ndarray, folder: Path) -> Path:
    """A frame in one of the ways in which cameras and people write them."""
    share = counts / counts.max()
    name, _, how = kind.partition(" ")
    path = folder / f"frame.{name}"
    values = {
        "8": lambda: np.round(255 * share).astype(np.uint8),
        "12": lambda: np.round(4000 * share).astype(np.uint16),
        "16": lambda: np.round(60000 * share).astype(np.uint16),
        "float": lambda: counts.astype(np.float32),
        "black": lambda: np.zeros_like(counts),
        "saturated": lambda: np.full_like(counts, 65535),
        "flat": lambda: np.full_like(counts, 1000),
        "pixel": lambda: counts[:1, :1],
        "colour": lambda: np.stack([np.round(255 * share).astype(np.uint8)] * 3, axis=-1),
        "pages": lambda: np.stack([counts, counts]),
        "transposed": counts.T.copy,
        "truncated": lambda: counts,
        "holes": lambda: np.where(np.random.default_rng(1).random(counts.shape) < 0.2, np.nan, counts),
        "negative": lambda: -1.0 - counts,
        "infinite": lambda: np.where(counts > counts.mean(), np.inf, -np.inf),
        "complex": lambda: counts + 1j,
    }[how]()
    if name == "npy":
        np.save(path, values)
    elif name == "png":
        Image.fromarray(values).save(path)
    else:
        tifffile.imwrite(path, values)
    if how == "truncated":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


@pytest.mark.parametrize(
    "kind",
    ["tif 8", "tif 12", "tif 16", "tif float", "png 8", "png 16", "npy 16", "npy float", "npy holes"],
)
def test_frames_of_all_kinds_of_files_say_the_same_depth(
    tmp_path: Path, psf: Path, counts: np.ndarray, kind: str,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    raw = as_file(kind, counts, tmp_path)
    code, said = decoded(raw, psf, capsys, monkeypatch)
    assert code == 0, said
    depth_m = decode.load(Path(str(raw) + ".out.h5")).depth_m
    # The fifth of the pixels that are missing takes some of the texture, too.
    assert np.nanmedian(depth_m) == pytest.approx(0.0029, rel=0.02)


@pytest.mark.parametrize("kind", ["tif black", "tif flat", "png flat", "npy flat"])
def test_where_nothing_is_to_be_seen_nothing_is_claimed(
    tmp_path: Path, psf: Path, counts: np.ndarray, kind: str,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    raw = as_file(kind, counts, tmp_path)
    code, said = decoded(raw, psf, capsys, monkeypatch)
    assert code == 0, said
    assert "no light" in said or "no texture" in said
    assert not np.isfinite(decode.load(Path(str(raw) + ".out.h5")).depth_m).any()


@pytest.mark.parametrize(
    "kind",
    [
        "tif saturated", "tif pixel", "tif colour", "tif pages", "tif transposed", "tif truncated", "png colour",
        "png pixel", "png truncated", "npy colour", "npy negative", "npy infinite", "npy complex", "npy truncated",
    ],
)  # fmt: skip
def test_what_is_no_frame_of_this_camera_is_refused_in_words(
    tmp_path: Path, psf: Path, counts: np.ndarray, kind: str,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    raw = as_file(kind, counts, tmp_path)
    code, said = decoded(raw, psf, capsys, monkeypatch)
    assert code == 2, said
    assert said.startswith(f"metafab: {raw}")
    assert "Traceback" not in said
    assert not Path(str(raw) + ".out.h5").exists()


def test_a_full_well_in_counts_keeps_contrast_and_is_told(
    tmp_path: Path, psf: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contrast 3 of an object whose bright image is full in a few per cent of its pixels."""
    scene = Scene(
        objects=(SceneObject(depth_m=0.0029, size=(0.13, 0.13), polarisation_contrast=3.0),),
        photons_per_pixel=3000.0, read_noise_e=2.0, full_well_e=4300.0, field_px=(128, 128), seed=1,
    )  # fmt: skip
    frame = camera.capture(scene, optics.load(psf))
    camera.save_counts(frame, tmp_path / "full.tif")
    # Another camera's: an electron a count, so that full pixels are no special number.
    electrons = np.clip(np.round(frame.frame), 0, None).astype(np.uint16)
    np.save(tmp_path / "own.npy", electrons[::-1])
    clipped = int((frame.frame == 4300.0).sum())
    assert clipped > 300
    for name, options, told in (
        ("full.tif", ("--electrons-per-count", str(4300.0 / 65535.0)), False),
        ("own.npy", (), True),
        ("own.npy", ("--white", "4300"), False),
        ("own.npy", ("--white", "65535"), False),
    ):
        code, said = decoded(tmp_path / name, psf, capsys, monkeypatch, "--read-noise-e", "2", *options)
        assert code == 0, said
        image = decode.load(Path(str(tmp_path / name) + ".out.h5"))
        inside = image.segment == np.bincount(image.segment[image.segment > 0]).argmax()
        wrong = abs(float(np.median(image.contrast[inside])) / 3.0 - 1.0)
        seen = "65535" not in options
        assert (wrong < 0.02) == seen, (name, options, wrong)
        assert (image.figures.pixels_broken >= clipped) == seen
        assert ("taken as saturated" in str(image.figures.warning)) == told
        # In the answer, and on stderr.
        assert said.count("taken as saturated") == 2 * told


@pytest.mark.parametrize("command", ["decode", "calibrate"])
def test_no_result_goes_under_a_name_that_is_not_its_kind(
    tmp_path: Path, psf: Path, counts: np.ndarray, command: str
) -> None:
    raw = as_file("tif 16", counts, tmp_path)
    (tmp_path / "depths.csv").write_text(f"{raw.name}, 0.0029\n")
    more = ["--depths", tmp_path / "depths.csv"] if command == "calibrate" else []
    answer = metafab(command, raw, "--psf", psf, *more, "-o", tmp_path / "foo.txt")
    assert answer.code == 2
    assert "foo.txt" in answer.stderr
    assert ".h5" in answer.stderr
    assert not (tmp_path / "foo.txt").exists()


def test_a_white_level_below_black_is_refused(tmp_path: Path, psf: Path, counts: np.ndarray) -> None:
    answer = metafab("decode", as_file("tif 16", counts, tmp_path), "--psf", psf, "--black", "64", "--white", "63")
    assert answer.code == 2
    assert "--white" in answer.stderr
