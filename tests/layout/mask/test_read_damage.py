"""Missing, truncated, damaged and foreign mask files: refused in words, never a crash, never a hang."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.mask.named_files import LISTS, list_in_a_block
from metafab import drc, mask
from metafab.core.errors import InputError
from metafab.mask.gdsii.records import real, record, text
from metafab.mask.oasis import elements
from metafab.mask.oasis.writer import CBLOCK, CELL, END, MAGIC, PLACEMENT, START
from metafab.spec import Design

FORMATS = ("gds", "oas")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no file at that path"),
        (b"", "an empty file"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "a file of another kind"),
        (b"HEADER 600\nBGNLIB", "a file of another kind"),
        (b"\x00\x06\x00\x02\x02\x58", "inside a record"),
        (b"%SEMI-OASIS\r\n", "truncated"),
    ],
)
def test_files_that_are_no_masks(content: bytes | None, message: str, tiny_design: Design, tmp_path: Path) -> None:
    path = tmp_path / "layout.gds"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        mask.read(path, tiny_design)
    assert caught.value.faults[0].remedy


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("share", [0.001, 0.3, 0.5, 0.999])
def test_truncated_files(
    suffix: str, share: float, tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path
) -> None:
    whole = tiny_files[suffix].read_bytes()
    path = tmp_path / f"cut.{suffix}"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError):
        mask.read(path, tiny_design)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
@pytest.mark.parametrize("suffix", FORMATS)
def test_flipped_bytes_are_refused_or_seen(
    suffix: str, data: st.DataObject, tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path
) -> None:
    """OASIS has a checksum, so any flip is refused.

    GDSII has none: some flips make another valid file. Its pillars are the same (the flip hit a name or a date), or the
    design rules say that they are not.
    """
    content = bytearray(tiny_files[suffix].read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path / f"flipped.{suffix}"
    path.write_bytes(content)
    try:
        report = drc.check(path, tiny_design)
    except InputError:
        return
    assert suffix == "gds"
    whole = drc.check(tiny_files[suffix], tiny_design)
    assert not report.clean or report.pillars_sha256 == whole.pillars_sha256


_BEGIN, _END = record(0x0800), record(0x1100)
_LAYER, _DATATYPE = record(0x0D02, b"\0\1"), record(0x0E02, bytes(2))
_XY = record(0x1003, struct.pack(">10i", -100, -100, 100, -100, 100, 100, -100, 100, -100, -100))


@pytest.mark.parametrize(
    "element",
    [
        _BEGIN + _LAYER + _DATATYPE + _XY + _BEGIN + _LAYER + _DATATYPE + _XY + _END,
        _BEGIN + _LAYER + _DATATYPE + _XY + record(0x0A00) + record(0x1206, b"P\0") + _END,
        _BEGIN + _LAYER + _DATATYPE + _XY + record(0x1100, bytes(8)),
        record(0x0800, bytes(6)) + _LAYER + _DATATYPE + _XY + _END,
        _BEGIN + _DATATYPE + _XY + _END,
        _BEGIN + _LAYER + _XY + _END,
        _BEGIN + _LAYER + _LAYER + _DATATYPE + _XY + _END,
        _BEGIN + _LAYER + _DATATYPE + record(0x1004, bytes(40)) + _END,
        record(0x0801) + _LAYER + _DATATYPE + _XY + _END,
    ],
)
def test_elements_that_hide_others_are_refused(element: bytes, tiny_design: Design, tmp_path: Path) -> None:
    """What a lost end, a longer record or a lost layer would swallow."""
    good = _structure("T", _BEGIN + _LAYER + _DATATYPE + _XY + _END)
    assert mask.read(_gds(tmp_path, good), tiny_design).off_site.count == 1
    with pytest.raises(InputError, match="damaged"):
        mask.read(_gds(tmp_path, _structure("T", element)), tiny_design)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(garbage=st.binary(max_size=300))
@pytest.mark.parametrize(
    "start", [b"\x00\x06\x00\x02\x02\x58", MAGIC + bytes([START]) + b"\x031.0\x00\xd0\x0f" + bytes(13)]
)
def test_garbage_after_a_good_beginning(start: bytes, garbage: bytes, tiny_design: Design, tmp_path: Path) -> None:
    end = bytes([END]) + bytes(255) if start.startswith(MAGIC) else b""
    path = tmp_path / "garbage"
    path.write_bytes(start + garbage + end)
    try:
        read_back = mask.read(path, tiny_design)
    except InputError:
        return
    assert not read_back.pillars.to_array().any()


def _gds(tmp_path: Path, *structures: bytes) -> Path:
    path = tmp_path / "made.gds"
    head = record(0x0002, b"\x02\x58") + record(0x0102, bytes(24)) + record(0x0206, text("L"))
    path.write_bytes(head + record(0x0305, real(5e-4) + real(5e-10)) + b"".join(structures) + record(0x0400))
    return path


def _structure(name: str, *elements: bytes) -> bytes:
    return record(0x0502, bytes(24)) + record(0x0606, text(name)) + b"".join(elements) + record(0x0700)


def _reference(name: str) -> bytes:
    return record(0x0A00) + record(0x1206, text(name)) + record(0x1003, bytes(8)) + record(0x1100)


def _array(name: str, columns: int, rows: int) -> bytes:
    points = struct.pack(">6i", 0, 0, 700 * columns, 0, 0, 700 * rows)
    head = record(0x0B00) + record(0x1206, text(name)) + record(0x1302, struct.pack(">2h", columns, rows))
    return head + record(0x1003, points) + record(0x1100)


def _square(layer: int = 1) -> bytes:
    points = struct.pack(">10i", -100, -100, 100, -100, 100, 100, -100, 100, -100, -100)
    head = record(0x0800) + record(0x0D02, struct.pack(">h", layer)) + record(0x0E02, bytes(2))
    return head + record(0x1003, points) + record(0x1100)


def test_cells_that_contain_one_another(tiny_design: Design, tmp_path: Path) -> None:
    path = _gds(
        tmp_path,
        _structure("T", _reference("A")),
        _structure("A", _reference("B")),
        _structure("B", _reference("A")),
    )
    with pytest.raises(InputError, match="circles"):
        mask.read(path, tiny_design)


def test_a_missing_cell(tiny_design: Design, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'GONE'"):
        mask.read(_gds(tmp_path, _structure("T", _reference("GONE"))), tiny_design)


def test_nested_arrays_that_would_fill_the_memory_are_counted_not_expanded(tiny_design: Design, tmp_path: Path) -> None:
    """Five levels of 32767^2 copies: 10^45 pillars in a kilobyte."""
    levels = [_structure(f"L{n}", _array(f"L{n + 1}", 32767, 32767)) for n in range(5)]
    path = _gds(tmp_path, *levels, _structure("L5", _square()))
    with pytest.raises(InputError, match="`shapes`: expected at most"):
        mask.read(path, tiny_design)


def test_an_oasis_block_that_would_fill_the_memory_is_refused(tiny_design: Design, tmp_path: Path) -> None:
    head = MAGIC + bytes([START]) + elements.string("1.0") + b"\x00" + elements.unsigned(2000) + bytes(13)
    cell = bytes([CELL]) + elements.string("T")
    blocks = [
        bytes([CBLOCK, 0]) + elements.unsigned(size) + elements.unsigned(4) + bytes(4) for size in (1 << 40, 4129)
    ]
    place = bytes([PLACEMENT, 0b1000_1000]) + elements.string("T")
    repetition = bytes([1]) + elements.unsigned(1 << 40) + elements.unsigned(1 << 20) + bytes(2)
    for content in (*blocks, place + repetition):
        path = tmp_path / "bomb.oas"
        path.write_bytes(head + cell + content + bytes([END]) + bytes(255))
        with pytest.raises(InputError, match=r"CBLOCK of|too long"):
            mask.read(path, tiny_design)


@pytest.mark.parametrize("kind", LISTS)
def test_lists_in_a_block_are_bounded_before_they_are_expanded(kind: str, tiny_design: Design, tmp_path: Path) -> None:
    """60 kB that would take 1 to 3 GB: a corner or a place of a list takes a byte of the block."""
    path = tmp_path / "list.oas"
    path.write_bytes(list_in_a_block(kind, 60_000_000, layer=2))
    with pytest.raises(InputError, match=r"blocks and lists of at most \d+ MB.*limits\.memory_mb"):
        mask.read_shapes(path, tiny_design)


def test_arrays_mirrors_turns_and_other_layers(tiny_design: Design, tmp_path: Path) -> None:
    """A 3 x 2 array of a cell that holds a turned reference: positions by hand."""
    turned = record(0x0A00) + record(0x1206, text("P")) + record(0x1A01, b"\x80\x00")
    turned += record(0x1C05, real(90.0)) + record(0x1003, struct.pack(">2i", 350, 350)) + record(0x1100)
    bar = struct.pack(">10i", 100, -150, 100, 150, -100, 150, -100, -150, 100, -150)  # clockwise, another corner
    bar = record(0x0800) + record(0x0D02, b"\0\1") + record(0x0E02, bytes(2)) + record(0x1003, bar) + record(0x1100)
    path = _gds(
        tmp_path,
        _structure("TOP", _array("MID", 3, 2)),
        _structure("MID", turned, _square(layer=7)),
        _structure("P", bar),
    )
    read_back = mask.read(path, tiny_design)
    index = read_back.pillars.to_array()
    row, column = np.nonzero(index)
    # 114 sites: the centre of site 57 lies half a period, 350 units, right of the axis.
    assert sorted(set(column.tolist())) == [57, 58, 59]
    assert sorted(set(row.tolist())) == [57, 58]
    assert np.array_equal(read_back.pillars.size_dbu[1:], [[300, 200]])
    assert read_back.other_layers == {"7/0": 6}


def test_everything_that_is_no_pillar_is_reported(tiny_design: Design, tmp_path: Path) -> None:
    triangle = record(0x0800) + record(0x0D02, b"\0\1") + record(0x0E02, bytes(2))
    triangle += record(0x1003, struct.pack(">8i", 0, 0, 90, 0, 0, 90, 0, 0)) + record(0x1100)
    bent = record(0x0900) + record(0x0D02, b"\0\1") + record(0x0E02, bytes(2)) + record(0x0F03, struct.pack(">i", 40))
    bent += record(0x1003, struct.pack(">6i", 0, 0, 90, 0, 90, 90)) + record(0x1100)
    straight = record(0x0900) + record(0x0D02, b"\0\1") + record(0x0E02, bytes(2))
    straight += record(0x0F03, struct.pack(">i", 200)) + record(0x1003, struct.pack(">4i", 250, 350, 450, 350))
    magnified = record(0x0A00) + record(0x1206, text("P")) + record(0x1A01, bytes(2))
    magnified += record(0x1B05, real(2.0)) + record(0x1003, bytes(8)) + record(0x1100)
    elements = (triangle, bent, straight + record(0x1100), magnified, _square())
    read_back = mask.read(_gds(tmp_path, _structure("TOP", *elements), _structure("P", _square())), tiny_design)
    assert {kind: left.count for kind, left in read_back.foreign.items()} == {
        "magnified or obliquely turned reference": 1,
        "path": 1,
        "polygon": 1,
    }
    assert np.array_equal(read_back.foreign["polygon"].boxes_nm, [[0.0, 0.0, 45.0, 45.0]])
    assert read_back.off_site.count == 1  # the square at the origin: between sites of an even lattice
    assert np.array_equal(read_back.off_site.boxes_nm, [[-50.0, -50.0, 100.0, 100.0]])
    assert np.count_nonzero(read_back.pillars.to_array()) == 1  # the straight path is a rectangle at a site


def test_an_oasis_block_that_holds_more_than_pillars_is_read_in_full(tiny_design: Design, tmp_path: Path) -> None:
    """The index skips blocks that begin with a rectangle; a placement and a text behind one must not get lost."""
    rectangle = bytes([20, 0b0111_1011, 1, 0]) + b"".join(map(elements.unsigned, (200, 200)))
    rectangle += elements.signed(-100) + elements.signed(-100)
    place = bytes([PLACEMENT, 0b1011_0000]) + elements.string("P") + elements.signed(350) + elements.signed(350)
    label = bytes([19, 0b0101_1011]) + elements.string("X") + bytes([9, 0]) + elements.signed(5) + elements.signed(5)
    records = rectangle + place + label
    packer = zlib.compressobj(6, zlib.DEFLATED, -15)
    packed = packer.compress(records) + packer.flush()
    block = bytes([CBLOCK, 0]) + elements.unsigned(len(records)) + elements.unsigned(len(packed)) + packed
    head = MAGIC + bytes([START]) + elements.string("1.0") + b"\x00" + elements.unsigned(2000) + bytes(13)
    cells = bytes([CELL]) + elements.string("T") + block + bytes([CELL]) + elements.string("P") + rectangle
    path = tmp_path / "mixed.oas"
    path.write_bytes(head + cells + bytes([END]) + elements.unsigned(252) + bytes(253))
    read_back = mask.read(path, tiny_design)
    assert read_back.top_cells == ("T",)
    assert np.count_nonzero(read_back.pillars.to_array()) == 1
    assert read_back.off_site.count == 1
    assert read_back.other_layers == {"9/0 text": 1}
