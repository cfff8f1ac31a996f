"""Every reader against files with flipped, lost, added and moved bytes: it answers or refuses in words, and is done."""

from __future__ import annotations

import resource
import signal
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from metafab import camera, decode, fullwave, library, mask, optics
from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.core.storage.pictures import read_grey
from metafab.fullwave.patch import Patch, save_patch
from metafab.layout import PillarMap, lattice_of
from metafab.library import Library
from metafab.materials.record import read_table
from metafab.phase.terms.sampled import load_array
from metafab.spec import Design, load_design, load_scene, load_unit_cell
from metafab.spec.toml import unit_cell_of_library
from tests.closed_form_run import decoded_image, raw_frame, turning_psf
from tests.main_job import SMALL, UNIT_CELL

#: Nothing that these files could honestly hold takes a tenth of either.
SECONDS, MEGABYTES = 20, 400


@dataclass(frozen=True)
class Case:
    """A valid file and what reads it."""

    content: bytes = field(repr=False)
    name: str
    read: Callable[[Path], Any] = field(repr=False)


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library, small_design: Design) -> dict[str, Case]:
    folder = tmp_path_factory.mktemp("valid")
    grey = np.arange(24 * 20, dtype=np.uint16).reshape(24, 20)
    Image.fromarray(grey.astype(np.uint8)).save(folder / "8.png")
    Image.fromarray(grey).save(folder / "16.png")
    tifffile.imwrite(folder / "plain.tif", grey)
    tifffile.imwrite(folder / "packed.tif", grey, compression="zlib")
    np.save(folder / "grey.npy", grey)
    np.save(folder / "phase.npy", np.zeros((2, 8, 8)))
    (folder / "phase.csv").write_text("0,1.5\n2,-3e-1\n")
    (folder / "index.csv").write_text("# source\nwavelength_nm,n,k\n700,1.5,0\n800,1.6,0.1\n")
    library.save(smooth_library, folder / "library.h5")
    optics.save(turning_psf(), folder / "psf.h5")
    camera.save(raw_frame(), folder / "raw.h5")
    decode.save(decoded_image(), folder / "decoded.h5")
    sites = np.arange(4.0)
    ones = np.ones((4, 4), dtype=np.complex128)
    save_patch(Patch(sites, sites, "x", ones, ones, ones, 1e-2, 1.0, 12, 3), folder / "patch.h5", inputs_sha256="")
    design = replace(small_design, device=replace(small_design.device, aperture_um=6.0))
    lattice = lattice_of(design)
    index = np.ones(lattice.shape, dtype=np.uint16)
    pillars = PillarMap.from_array(lattice, np.array([[0, 0], [200, 400]], dtype=np.int32), index, 8)
    mask.write(pillars, folder, design)
    text = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib", UNIT_CELL.parent.as_posix())
    (folder / "design.toml").write_text(text, encoding="utf-8")
    readers: dict[str, Callable[[Path], Any]] = {
        "8.png": read_grey,
        "16.png": read_grey,
        "plain.tif": read_grey,
        "packed.tif": read_grey,
        "grey.npy": read_grey,
        "phase.npy": lambda path: load_array(path, 1.0, "phase", 2.0),
        "phase.csv": lambda path: load_array(path, 1.0, "phase", 1.0),
        "index.csv": lambda path: read_table(path, "index"),
        "library.h5": lambda path: (library.load(path), unit_cell_of_library(path)),
        "psf.h5": optics.load,
        "raw.h5": camera.load,
        "decoded.h5": decode.load,
        "patch.h5": fullwave.load_patch,
        "layout.gds": lambda path: mask.read(path, design),
        "layout.oas": lambda path: mask.read(path, design),
        "design.toml": lambda path: (load_design(path), load_scene(path)),
        "cell.toml": load_unit_cell,
    }
    (folder / "cell.toml").write_bytes(UNIT_CELL.read_bytes())
    return {name: Case((folder / name).read_bytes(), name, read) for name, read in readers.items()}


NAMES = (
    "8.png", "16.png", "plain.tif", "packed.tif", "grey.npy", "phase.npy", "phase.csv", "index.csv", "library.h5",
    "psf.h5", "raw.h5", "decoded.h5", "patch.h5", "layout.gds", "layout.oas", "design.toml", "cell.toml",
)  # fmt: skip


@contextmanager
def bounded() -> Iterator[None]:
    """Fail what takes too long or too much memory; other failures pass through."""

    def too_long(number: int, frame: FrameType | None) -> None:
        raise AssertionError(f"still reading after {SECONDS} s")

    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    previous = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 1024 * MEGABYTES


def survives(case: Case, content: bytes, folder: Path) -> bool:
    """Whether the reader takes the content; anything but an answer or a refusal in words is raised."""
    path = folder / case.name
    path.write_bytes(content)
    try:
        with bounded():
            case.read(path)
    except InputError as error:
        # Keys that contradict each other make one sentence, without a value that was found.
        assert error.faults and all(fault.expected and (fault.got or " " in fault.expected) for fault in error.faults)
        return False
    return True


@st.composite
def edits(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """A change of a file: places are shares of its length, half of them in its head, where formats decide."""
    places = st.one_of(st.floats(0.0, 1.0, exclude_max=True), st.floats(0.0, 0.05, exclude_max=True))
    start, other = draw(places), draw(places)
    kind = draw(st.sampled_from(("flip", "cut", "insert", "drop", "copy", "fill")))
    length = draw(st.sampled_from((1, 2, 4, 8, 64)))
    bits, added = draw(st.integers(1, 255)), draw(st.binary(min_size=1, max_size=16))

    def edit(content: bytes) -> bytes:
        at, away = int(start * len(content)), int(other * len(content))
        rest = content[at:]
        changed = {
            "flip": bytes([rest[0] ^ bits]) + rest[1:],
            "cut": b"",
            "insert": added + rest,
            "drop": rest[length:],
            "copy": content[away : away + length] + rest[length:],
            "fill": bytes([bits]) * min(length, len(rest)) + rest[length:],
        }
        return content[:at] + changed[kind]

    return edit


@pytest.mark.parametrize("name", NAMES)
def test_the_valid_file_is_read(cases: dict[str, Case], name: str, tmp_path: Path) -> None:
    assert survives(cases[name], cases[name].content, tmp_path)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edit=edits())
@pytest.mark.parametrize("name", NAMES)
def test_changed_files_are_read_or_refused(
    cases: dict[str, Case], name: str, edit: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    survives(cases[name], edit(cases[name].content), tmp_path)


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith((".h5", ".oas"))])
def test_no_change_of_a_file_with_a_checksum_goes_unseen(cases: dict[str, Case], name: str, tmp_path: Path) -> None:
    """A bit at each of forty places over the whole file, and the file cut short there."""
    case = cases[name]
    # The checksum of an HDF5 file is its last line, and its loss is what an honest change leaves behind.
    end = len(case.content) - (hdf5.SEAL_BYTES if name.endswith(".h5") else 0)
    for place in np.linspace(0, end - 1, 40).astype(int):
        flipped = bytearray(case.content)
        flipped[place] ^= 1 << int(place) % 8
        assert not survives(case, bytes(flipped), tmp_path), place
        assert not survives(case, case.content[:place], tmp_path), place


def test_a_file_that_was_changed_on_purpose_is_read(tmp_path: Path) -> None:
    path = tmp_path / "own.h5"
    with hdf5.create(path, kind="own", format_version=1, inputs_sha256="") as file:
        hdf5.put(file, "x", np.arange(5.0), units="1", description="numbers", dims=("x",))
    with h5py.File(path, "r+") as file:
        file["x"][2] = 7.0
    with hdf5.open_kind(path, kind="own", format_version=1, remedy="") as file:
        assert file["x"][()].tolist() == [0.0, 1.0, 7.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ({}, "metafab did not write"),
        ({"kind": "metafab library"}, "of kind 'metafab library'"),
        ({"kind": 3}, "of kind"),
        ({"kind": "metafab psf", "format_version": 99}, "update metafab"),
        ({"kind": "metafab psf", "format_version": "first"}, "unreadable or missing content"),
        ({"kind": "metafab psf", "format_version": 1}, "unreadable or missing content"),
        ({"kind": "metafab psf", "format_version": 1, "details": "{", "sensor_distance_um": 1.0}, "content"),
    ],
)
def test_hdf5_that_others_wrote(attributes: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = tmp_path / "psf.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update(attributes)
    with pytest.raises(InputError, match=said):
        optics.load(path)


# --- small files that claim to be large ------------------------------------------------------------------------------


def _png(columns: int, rows: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    parts = (chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(bytes(1000))), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _npy(shape: str) -> bytes:
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + bytes(64)


def test_rows_that_a_tiff_claims_are_not_walked_through(cases: dict[str, Case], tmp_path: Path) -> None:
    content = bytearray(cases["packed.tif"].content)
    with tifffile.TiffFile(_written(content, tmp_path)) as file:
        places = [file.pages.first.tags[name].valueoffset for name in ("ImageLength", "RowsPerStrip")]
    content[places[0] : places[0] + 4] = b"\x18\x00\x00\x10"
    content[places[1]] = 1
    with pytest.raises(InputError, match="pixels, more than"):
        read_grey(_written(content, tmp_path))


def _written(content: bytes | bytearray, folder: Path) -> Path:
    path = folder / "claim.tif"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("grey.npy", _npy("(200000, 200000)")),
        ("phase.npy", _npy("(4611686018427387904, 4)")),
        ("phase.npy", _npy("(-1, -1)")),
        ("phase.npy", _npy("(((2, 2")),
        ("phase.npy", b""),
        ("8.png", _png(60000, 40000)),
        ("8.png", _png(0, 0)),
        ("phase.csv", b"1,2\n1"),
        ("phase.csv", b"nan,1\n1,1\n"),
        ("index.csv", b"wavelength_nm,n,k\n" + b"9" * 5000 + b",1,0\n"),
    ],
)
def test_claims_are_not_believed(cases: dict[str, Case], name: str, content: bytes, tmp_path: Path) -> None:
    assert not survives(cases[name], content, tmp_path)
