"""Frames in the files of real cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from metafab.camera import Counts, RawFrame, capture, counts_of, load, load_frame, save, save_counts
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import PIXEL_UM, helix_psf


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0027, 0.0032, 3), window_px=32)


@pytest.fixture(scope="module")
def frame(psf: Psf) -> RawFrame:
    return capture(Scene(objects=(SceneObject(depth_m=0.003, size=(0.04, 0.04)),), field_px=(40, 48)), psf)


@pytest.mark.parametrize(
    ("suffix", "dtype"), [("tif", np.uint8), ("tif", np.uint16), ("png", np.uint8), ("png", np.uint16)]
)
def test_camera_frames_come_with_the_lowest_row_first(psf: Psf, tmp_path: Path, suffix: str, dtype: type) -> None:
    counts = np.arange(60, dtype=dtype).reshape(6, 10)
    path = tmp_path / f"frame.{suffix}"
    if suffix == "tif":
        tifffile.imwrite(path, counts)
    else:
        Image.fromarray(counts).save(path)
    frame = load_frame(path, psf)
    assert (frame.frame == counts[::-1]).all()
    assert frame.saturation_e == np.iinfo(dtype).max
    assert frame.origin_um == pytest.approx((-5 * PIXEL_UM, -3 * PIXEL_UM))
    assert frame.truth is None


def test_twelve_bits_in_sixteen_saturate_at_twelve(psf: Psf, tmp_path: Path) -> None:
    counts = np.full((4, 4), 4095, dtype=np.uint16)
    tifffile.imwrite(tmp_path / "frame.tif", counts)
    assert load_frame(tmp_path / "frame.tif", psf).saturation_e == 4095.0


def test_numpy_frames(psf: Psf, tmp_path: Path) -> None:
    np.save(tmp_path / "frame.npy", np.eye(5))
    assert (load_frame(tmp_path / "frame.npy", psf, first_row="bottom").frame == np.eye(5)).all()


@pytest.mark.parametrize(
    ("name", "content", "field"),
    [
        ("frame.jpg", b"x", "file"),
        ("frame.tif", b"not a tiff", "file"),
        ("frame.png", b"", "file"),
        ("frame.npy", b"\x93NUMPY", "file"),
        ("none.tif", None, "file"),
    ],
)
def test_unreadable_frames_are_refused(psf: Psf, tmp_path: Path, name: str, content: bytes | None, field: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_frame(tmp_path / name, psf)
    assert caught.value.faults[0].field == field
    assert caught.value.faults[0].remedy


@pytest.mark.parametrize("values", [np.zeros((2, 3, 4)), np.zeros(7), np.zeros((0, 5)), np.array([["a"]])])
def test_frames_that_are_no_grey_picture_are_refused(psf: Psf, tmp_path: Path, values: np.ndarray) -> None:
    np.save(tmp_path / "frame.npy", values)
    with pytest.raises(InputError):
        load_frame(tmp_path / "frame.npy", psf)


@pytest.mark.parametrize("name", ["frame.tif", "frame.png", "frame.npy"])
def test_a_frame_in_counts_comes_back_where_it_was(psf: Psf, frame: RawFrame, tmp_path: Path, name: str) -> None:
    """Whole electrons, the axis in the middle of the file: every pixel has the place on the sensor that it had."""
    save_counts(frame, tmp_path / name)
    back = load_frame(tmp_path / name, psf)
    assert back.pixel_um == frame.pixel_um
    column, row = (
        round((there - here) / PIXEL_UM) for there, here in zip(frame.origin_um, back.origin_um, strict=True)
    )
    n_y, n_x = frame.frame.shape
    part = back.frame[row : row + n_y, column : column + n_x]
    np.testing.assert_array_equal(part, np.clip(np.round(frame.frame), 0, 65535))
    assert back.frame.sum() == part.sum()
    assert back.saturation_e == 65535.0
    again = tmp_path / f"again_{name}"
    save_counts(frame, again)
    assert again.read_bytes() == (tmp_path / name).read_bytes()


def test_no_frame_goes_into_another_kind_of_file(frame: RawFrame, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="jpg"):
        save_counts(frame, tmp_path / "frame.jpg")
    assert list(tmp_path.iterdir()) == []


def test_black_level_and_gain_make_electrons_of_counts(psf: Psf, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "frame.tif", np.array([[64, 164], [4095, 264]], dtype=np.uint16))
    frame = load_frame(tmp_path / "frame.tif", psf, counts=Counts(64.0, 2.5, 3.0))
    np.testing.assert_array_equal(frame.frame, [[2.5 * 4031.0, 500.0], [0.0, 250.0]])
    assert frame.saturation_e == 2.5 * 4031.0
    assert frame.read_noise_e == 3.0


def test_our_own_frames_are_in_electrons_already(psf: Psf, frame: RawFrame, tmp_path: Path) -> None:
    save(frame, tmp_path / "raw.h5")
    with pytest.raises(InputError, match="electrons already"):
        load_frame(tmp_path / "raw.h5", psf, counts=Counts(black=64.0))


@pytest.mark.parametrize("black", [0, 100])
@pytest.mark.parametrize("name", ["frame.tif", "frame.png", "frame.npy"])
def test_full_pixels_are_full_in_counts_too(psf: Psf, tmp_path: Path, name: str, black: int) -> None:
    """The full well fills the file's bits: which pixels are full is known from the file alone."""
    own = np.arange(-6.0, 66.0).reshape(8, 9) * 100.0
    full = own >= 4000.0
    frame = RawFrame(np.minimum(own, 4000.0), PIXEL_UM, (-4 * PIXEL_UM, -4 * PIXEL_UM), 2.0, saturation_e=4000.0)
    save_counts(frame, tmp_path / name, black=black)
    meant = counts_of(frame, black=black)
    back = load_frame(tmp_path / name, psf, counts=Counts(meant.black, meant.electrons_per_count))
    assert back.saturation_e == pytest.approx(4000.0)
    assert not back.saturation_assumed
    assert ((back.frame >= back.saturation_e)[:, 1:] == full).all()
    # Half a count is 0.03 electrons; a black level of 100 counts keeps 6 electrons below zero.
    lowest = -100 * meant.electrons_per_count if black else 0.0
    np.testing.assert_allclose(back.frame[:, 1:], np.maximum(frame.frame, lowest), atol=0.04)


def spread(level: int | float, dtype: type, pixels: int = 200 * 200) -> np.ndarray:
    """Light of all strengths, at most ``level``."""
    return np.minimum(np.random.default_rng(1).poisson(3000.0, pixels), level).astype(dtype).reshape(-1, 200)


@pytest.mark.parametrize(("shift", "dtype"), [(0, np.uint16), (4, np.uint16), (0, np.float32)])
def test_a_full_well_that_nobody_states_is_seen_in_the_counts(
    psf: Psf, tmp_path: Path, shift: int, dtype: type
) -> None:
    counts = (spread(3060, np.uint16) << shift).astype(dtype)
    np.save(tmp_path / "frame.npy", counts)
    frame = load_frame(tmp_path / "frame.npy", psf, counts=Counts(100.0, 0.5))
    assert frame.saturation_assumed
    assert frame.saturation_e == 0.5 * ((3060 << shift) - 100)
    stated = load_frame(tmp_path / "frame.npy", psf, counts=Counts(100.0, 0.5, white=3060.0 * 2**shift))
    assert stated.saturation_e == frame.saturation_e
    assert not stated.saturation_assumed
    save(frame, tmp_path / "raw.h5")
    assert load(tmp_path / "raw.h5").saturation_assumed


@pytest.mark.parametrize(
    "counts",
    [
        spread(10**6, np.uint16),
        spread(10**6, np.uint16) // 250,  # a few counts only: many pixels share each of them
        np.full((200, 200), 7, dtype=np.uint16),
        np.zeros((200, 200), dtype=np.uint16),
        -1.0 - spread(10**6, np.float64).clip(2990),
        np.where(np.eye(200) > 0.0, np.inf, spread(10**6, np.float64)),
    ],
    ids=["photons", "coarse", "flat", "black", "negative", "infinite"],
)
def test_light_that_is_not_full_is_not_taken_for_it(psf: Psf, tmp_path: Path, counts: np.ndarray) -> None:
    np.save(tmp_path / "frame.npy", counts)
    frame = load_frame(tmp_path / "frame.npy", psf)
    assert not frame.saturation_assumed
    assert frame.saturation_e in {None, 65535.0}


def test_a_black_level_leaves_room_for_light(frame: RawFrame, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="black"):
        save_counts(frame, tmp_path / "frame.tif", black=40000)
