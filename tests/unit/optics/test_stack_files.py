"""Stacks in files of other programs come back axis by axis, and unfit files are refused by name."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from scipy.io import savemat

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.stack_files import lowest_row_first, read_depths, read_stack

DEPTHS = 5
#: Two channels; no two axes of equal length.
STACK = np.random.default_rng(1).random((2, DEPTHS, 11, 13))
_FROM = {"cdyx": (0, 1, 2, 3), "dcyx": (1, 0, 2, 3), "yxdc": (2, 3, 1, 0), "yxcd": (2, 3, 0, 1)}


def _write(values: FloatArray, path: Path, kind: str) -> None:
    if kind == "npy":
        np.save(path, values)
    elif kind == "tif":
        tifffile.imwrite(path, values, photometric="minisblack")
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            file["group/stack"], file["pixel"] = values, 3.45
    elif kind == "mat5":
        savemat(path, {"stack": values, "pixel": 3.45})
    else:  # MATLAB 7.3: HDF5 with the axes in reverse
        with h5py.File(path, "w") as file:
            file["stack"] = values.transpose()


@pytest.mark.parametrize("kind", ["npy", "tif", "h5", "mat5", "mat73"])
@pytest.mark.parametrize("order", _FROM)
def test_each_order_of_axes_in_each_format(tmp_path: Path, kind: str, order: str) -> None:
    path = tmp_path / f"stack.{kind[:3]}"
    _write(STACK.transpose(_FROM[order]), path, kind)
    np.testing.assert_array_equal(read_stack(path, DEPTHS), STACK)


@pytest.mark.parametrize("kind", ["npy", "tif", "h5", "mat5", "mat73"])
@pytest.mark.parametrize("depth_last", [False, True])
def test_one_channel(tmp_path: Path, kind: str, depth_last: bool) -> None:
    path = tmp_path / f"stack.{kind[:3]}"
    _write(np.moveaxis(STACK[0], 0, -1) if depth_last else STACK[0], path, kind)
    np.testing.assert_array_equal(read_stack(path, DEPTHS), STACK[:1])


def test_a_cube_follows_the_custom_of_its_format(tmp_path: Path) -> None:
    cube = np.random.default_rng(2).random((9, 9, 9))
    _write(cube, tmp_path / "a.npy", "npy")
    _write(cube, tmp_path / "a.mat", "mat5")
    np.testing.assert_array_equal(read_stack(tmp_path / "a.npy", 9)[0], cube)
    np.testing.assert_array_equal(read_stack(tmp_path / "a.mat", 9)[0], np.moveaxis(cube, -1, 0))


def test_two_arrays_are_two_channels(tmp_path: Path) -> None:
    path = tmp_path / "stack.mat"
    savemat(path, {"left": STACK[0], "right": STACK[1]})
    np.testing.assert_array_equal(read_stack(path, DEPTHS, ("right", "left")), STACK[::-1])
    with pytest.raises(InputError, match=r"left \(5, 11, 13\), right.*name one"):
        read_stack(path, DEPTHS)
    with pytest.raises(InputError, match=r"middle.*choose one of these"):
        read_stack(path, DEPTHS, ("middle",))


@pytest.mark.parametrize("kind", ["npy", "tif", "h5", "mat5"])
def test_another_count_of_depths_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"stack.{kind[:3]}"
    _write(STACK, path, kind)
    with pytest.raises(InputError, match=r"7 depths.*\(2, 5, 11, 13\)"):
        read_stack(path, 7)


@pytest.mark.parametrize("name", ["stack.mat", "stack.h5", "stack.npy", "stack.tif"])
@pytest.mark.parametrize("content", [None, b"", b"MATLAB 5.0 MAT-file, cut", bytes(300)])
def test_missing_and_broken_files(tmp_path: Path, name: str, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_stack(tmp_path / name, DEPTHS)


def test_complex_and_huge_arrays(tmp_path: Path) -> None:
    np.save(tmp_path / "field.npy", STACK + 0j)
    with pytest.raises(InputError, match="real numbers"):
        read_stack(tmp_path / "field.npy", DEPTHS)
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        file.create_dataset("stack", (DEPTHS, 1 << 14, 1 << 14), dtype="f4", chunks=(1, 1 << 10, 1 << 10))
    with pytest.raises(InputError, match=r"at most 1.26e\+07 values"):
        read_stack(tmp_path / "huge.h5", DEPTHS)


def test_depths_from_files(tmp_path: Path) -> None:
    wanted = [0.25, 0.3, 0.35]
    np.save(tmp_path / "depths.npy", np.array(wanted)[:, None])
    (tmp_path / "lines.csv").write_text("# m\n0.25\n0.30\n0.35  # last\n")
    (tmp_path / "row.csv").write_text("0.25, 0.30, 0.35")
    (tmp_path / "marked.csv").write_text("0.25\n0.30\n0.35\n", encoding="utf-8-sig")  # as spreadsheets write it
    (tmp_path / "headed.csv").write_text("# bench\ndepth_m\n0.25\n0.30\n0.35\n")
    (tmp_path / "bad.csv").write_text("near\n0.30")
    (tmp_path / "empty.csv").write_text("# m\n")
    for name in ("depths.npy", "lines.csv", "row.csv", "marked.csv", "headed.csv"):
        assert read_depths(tmp_path / name).tolist() == wanted
    for name in ("bad.csv", "empty.csv", "none.csv", "none.npy"):
        with pytest.raises(InputError, match=name):
            read_depths(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth\n0.25\n", "got 'depth'; one depth in metres a line"),
        ("0.25;0.30;0.35;0.40;0.45;0.50;0.55;0.60;0.65;0.70", r"got '0.25;0.30;.*\.\.\.';"),
        ("0,25\n0,30\n0,35\n", "got decimal commas, such as 0,25; one depth in metres a line, with a decimal point"),
        ("", "got no number"),
        ("Ma\u00df", "got 'Ma\u00df'"),
    ],
)
def test_a_table_that_holds_something_else_says_what(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_depths(tmp_path / "table.csv")


def test_a_table_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    (tmp_path / "latin.csv").write_bytes("# Ma\u00df\n0.25".encode("latin-1"))
    (tmp_path / "folder.csv").mkdir()
    for name, got in (
        ("latin", "no text in UTF-8"),
        ("none", "none .No such file"),
        ("folder", "none .Is a directory"),
    ):
        with pytest.raises(InputError, match=f"expected a readable table of numbers, got {got}"):
            read_depths(tmp_path / f"{name}.csv")


def test_stacks_that_are_no_files_or_of_another_kind(tmp_path: Path) -> None:
    (tmp_path / "empty.h5").touch()
    (tmp_path / "folder.mat").mkdir()
    (tmp_path / "film.avi").touch()
    savemat(tmp_path / "flat.mat", {"psf": STACK[0, 0]})
    for name, words in (
        ("empty.h5", "an empty file"),
        ("folder.mat", "a folder"),
        ("film.avi", r"expected a .mat, .h5, .npy, .npz, .tif, .tiff or .png file, got '.avi'"),
        ("flat.mat", "got none; export the stack"),
    ):
        with pytest.raises(InputError, match=words):
            read_stack(tmp_path / name, DEPTHS)


@pytest.mark.parametrize("rows", [8, 9])
def test_a_picture_is_turned_upside_down_about_its_middle_row(rows: int) -> None:
    stack = np.zeros((1, 2, rows, 8))
    stack[..., rows // 2, 3], stack[..., rows // 2 - 2, 5] = 1.0, 2.0  # the second one lies two rows above the middle
    turned = lowest_row_first(stack)
    assert (turned[..., rows // 2, 3] == 1.0).all() and (turned[..., rows // 2 + 2, 5] == 2.0).all()
