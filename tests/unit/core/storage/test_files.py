"""Whole files, fingerprints and HDF5 with units."""

from __future__ import annotations

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.core.storage.files import Latest, file_mark, file_sha256, fingerprint, whole_file, write_json


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), whole_file(path) as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_finished_write_replaces_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "new" / "result.txt"
    with whole_file(path) as part:
        part.write_text("new")
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def test_fingerprints_follow_values_not_order_or_types() -> None:
    assert fingerprint({"a": 1, "b": [1.0, 2.0]}) == fingerprint({"b": np.array([1.0, 2.0]), "a": 1})
    assert fingerprint(1.0) != fingerprint(1.0 + 2e-16)


def test_json_holds_complex_numbers_as_pairs(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_json(path, {"t": 1 + 2j, "nan": float("nan")})
    assert '"t": [\n    1.0,\n    2.0\n  ]' in path.read_text()
    assert '"nan": null' in path.read_text()


def _write(path: Path) -> None:
    with hdf5.create(path, kind="metafab test", format_version=1, inputs_sha256="0") as file:
        hdf5.put(file, "x_um", np.arange(3.0), units="um", description="position", dims=("x_um",))
        hdf5.put(file, "field", np.arange(3) * 1j, units="1", description="a field", dims=("x_um",))


def test_datasets_have_units_descriptions_and_scales(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    _write(path)
    with h5py.File(path) as file:
        assert file["field"].attrs["units"] == "1"
        assert file["field"].attrs["description"] == "a field"
        assert np.array_equal(file["field"].dims[0]["x_um"], [0.0, 1.0, 2.0])
        assert file.attrs["kind"] == "metafab test"


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.h5", "b.h5"):
        _write(tmp_path / name)
    assert file_sha256(tmp_path / "a.h5") == file_sha256(tmp_path / "b.h5")


@pytest.mark.parametrize("damage", ["missing", "empty", "truncated", "text", "foreign", "other kind", "newer"])
def test_unusable_hdf5_is_refused_with_what_to_do(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "x.h5"
    _write(path)
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "text":
        path.write_text("not HDF5")
    elif damage == "foreign":
        with h5py.File(path, "w") as file:
            file["x"] = 1
    elif damage == "other kind":
        with hdf5.create(path, kind="another", format_version=1, inputs_sha256="0"):
            pass
    else:
        with hdf5.create(path, kind="metafab test", format_version=2, inputs_sha256="0"):
            pass
    with (
        pytest.raises(InputError, match=r"make it again|update metafab"),
        hdf5.open_kind(path, kind="metafab test", format_version=1, remedy="make it again"),
    ):
        pass


def test_the_same_key_gives_the_same_object_and_another_takes_its_place() -> None:
    held: Latest[list[int]] = Latest()
    made: list[int] = []

    def make(number: int) -> list[int]:
        made.append(number)
        return [number]

    first = held.of(("a", 1), lambda: make(1))
    assert held.of(("a", 1), lambda: make(2)) is first
    assert held.of(("b", 1), lambda: make(3)) == [3]
    assert held.of(("a", 1), lambda: make(4)) == [4]
    assert made == [1, 3, 4]


def test_what_fails_is_not_held_and_leaves_nothing_of_the_one_before() -> None:
    held: Latest[float] = Latest()
    assert held.of(1, lambda: 10) == 10
    with pytest.raises(ZeroDivisionError):
        held.of(2, lambda: 1 / 0)
    assert held.of(2, lambda: 20) == 20
    assert held.of(1, lambda: 11) == 11


def test_a_mark_tells_another_content_size_or_place(tmp_path: Path) -> None:
    path, link = tmp_path / "mask.oas", tmp_path / "link.oas"
    path.write_bytes(b"abc")
    link.symlink_to(path)
    mark = file_mark(path)
    assert file_mark(link) == mark
    path.write_bytes(b"abcd")
    os.utime(path, ns=(mark[2], mark[2]))
    assert file_mark(path) != mark
    path.write_bytes(b"abd")
    os.utime(path, ns=(mark[2] + 1, mark[2] + 1))
    assert file_mark(path) != mark
    with pytest.raises(OSError, match="gone"):
        file_mark(tmp_path / "gone.oas")
