"""HDF5 files that reach out of themselves or claim more than they hold are refused before anything is read."""

from __future__ import annotations

import resource
import struct
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.phase.terms.sampled import read_array


def _external_link(file: h5py.File, folder: Path) -> None:
    file["x"] = h5py.ExternalLink(str(folder / "secret.h5"), "/x")


def _soft_link(file: h5py.File, folder: Path) -> None:
    file["y"] = np.zeros(3)
    file["x"] = h5py.SoftLink("/y")


def _external_storage(file: h5py.File, folder: Path) -> None:
    (folder / "secret.bin").write_bytes(bytes(80))
    file.create_dataset("x", (10,), "f8", external=[(str(folder / "secret.bin"), 0, 80)])


def _virtual(file: h5py.File, folder: Path) -> None:
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "secret.h5"), "x", (3,))
    file.create_virtual_dataset("x", layout)


def _unwritten(file: h5py.File, folder: Path) -> None:
    file.create_dataset("x", (30_000, 30_000), "f8")


def _many_unwritten(file: h5py.File, folder: Path) -> None:
    for name in ["x", *map(str, range(20))]:
        file.create_dataset(name, (3000, 3000), "f8")


def _deflated_zeros(file: h5py.File, folder: Path) -> None:
    """As large as the budget, but not with the copy that a reader makes."""
    file.create_dataset("x", (10_000, 10_000), "f8", chunks=(5000, 5000), compression="gzip")


def _bytes_that_become_floats(file: h5py.File, folder: Path) -> None:
    file.create_dataset("x", (10_000, 10_000), "u1", chunks=(5000, 5000), compression="gzip")


def _huge_chunk(file: h5py.File, folder: Path) -> None:
    file.create_dataset("x", (4, 4), "f8", chunks=(16_000, 16_000), maxshape=(None, None), compression="gzip")


def _tiny_chunks(file: h5py.File, folder: Path) -> None:
    file.create_dataset("x", (50_000_000,), "f8", chunks=(1,))


def _objects(file: h5py.File, folder: Path) -> None:
    file["x"] = np.array([b"a", "b"], dtype=h5py.string_dtype())


def _record(file: h5py.File, folder: Path) -> None:
    file["x"] = np.zeros(3, dtype=[("real", "f8", (1000,)), ("imag", "f8")])


def _nothing(file: h5py.File, folder: Path) -> None:
    file["x"] = h5py.Empty("f8")


def _many_groups(file: h5py.File, folder: Path) -> None:
    for number in range(5000):
        file.create_group(str(number))


HOSTILE = [
    _external_link, _soft_link, _external_storage, _virtual, _unwritten, _many_unwritten, _huge_chunk, _tiny_chunks,
    _deflated_zeros, _bytes_that_become_floats, _objects, _record, _nothing, _many_groups,
]  # fmt: skip


@pytest.mark.parametrize("spoil", HOSTILE)
def test_hostile_content_is_refused_before_it_is_read(spoil: Callable[[h5py.File, Path], None], tmp_path: Path) -> None:
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = np.arange(3.0)
    path = tmp_path / "hostile.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"kind": "own", "format_version": 1})
        spoil(file, tmp_path)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    with (
        pytest.raises(InputError, match=r"source that you trust|if you trust the file"),
        hdf5.open_kind(path, kind="own", format_version=1, remedy="") as file,
    ):
        file["x"][()]
    if spoil is not _many_groups:
        with pytest.raises(InputError):
            read_array(path, "x") if spoil is not _many_unwritten else read_array(path, "none")
    assert time.process_time() - start < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200 * 1024


def test_free_space_of_no_size_in_a_heap_is_refused(tmp_path: Path) -> None:
    """The HDF5 library (1.14) would step over it forever, once an attribute is read."""
    path = tmp_path / "endless.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"kind": "own", "format_version": 1})
        file["x"] = np.arange(3.0)
    image = bytearray(path.read_bytes())
    place = image.index(b"GCOL") + 16  # the heap's first object, which holds the kind
    image[place : place + 2], image[place + 8 : place + 16] = bytes(2), bytes(8)
    path.write_bytes(image)
    with (
        pytest.raises(InputError, match="damaged heap"),
        hdf5.open_kind(path, kind="own", format_version=1, remedy=""),
    ):
        pass
    with pytest.raises(InputError, match="damaged heap"):
        read_array(path, "x")


def test_heaps_that_overlap_are_refused_in_time(tmp_path: Path) -> None:
    """Many heaps that all reach to one list of small objects, each of which would be walked for each heap."""
    path = tmp_path / "overlapping.h5"
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(3.0)
    heads, tail = 20_000, struct.pack("<QQ", 1, 0) * 60_000
    with path.open("ab") as stream:
        for k in range(heads):
            to_tail = 32 * (heads - k) - 32
            stream.write(b"GCOL\1\0\0\0" + struct.pack("<QQQ", 1 << 40, 1, to_tail))
        stream.write(tail)
    start = time.process_time()
    with pytest.raises(InputError, match="damaged heap"):
        read_array(path, "x")
    assert time.process_time() - start < 5.0


def test_a_group_that_holds_itself_ends(tmp_path: Path) -> None:
    path = tmp_path / "circle.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"kind": "own", "format_version": 1})
        file.create_group("a")
        file["a/again"] = file["a"]
        file["x"] = np.arange(3.0)
    with hdf5.open_kind(path, kind="own", format_version=1, remedy="") as file:
        assert file["x"][()].tolist() == [0.0, 1.0, 2.0]


def test_large_arrays_of_large_files_are_read(tmp_path: Path) -> None:
    """Noise of 16 MB and zeros of 560 MB, with their copy more than a small file may hold."""
    path = tmp_path / "large.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"kind": "own", "format_version": 1})
        file["x"] = np.random.default_rng(1).random(2_000_000)
        file.create_dataset("zeros", (70_000_000,), "f8", chunks=(1 << 20,))
    with hdf5.open_kind(path, kind="own", format_version=1, remedy="") as file:
        assert file["x"].shape == (2_000_000,)
