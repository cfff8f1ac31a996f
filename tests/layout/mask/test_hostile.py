"""Small files that claim huge masks are refused within 5 s and 1 GB, before anything is expanded."""

from __future__ import annotations

import math
import resource
import struct
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import mask
from metafab.core.errors import InputError
from metafab.mask.gdsii import records as gds
from metafab.mask.oasis.elements import real, signed, string, unsigned
from metafab.mask.oasis.reader import OasisReader
from metafab.mask.read import read_shapes
from metafab.spec import Design
from metafab.spec.design import Limits

_MAGIC = b"%SEMI-OASIS\r\n"
_START = b"\x01" + string("1.0") + real(1000.0) + b"\x01"
#: 2^14 columns and rows, 600 apart.
_REPETITION = b"\x01" + unsigned(2**14 - 2) * 2 + unsigned(600) * 2
_PILLAR = b"\x14\x7b" + unsigned(1) + unsigned(0) + unsigned(200) * 2 + signed(0) * 2


def _oasis(*parts: bytes, start: bytes = _START) -> bytes:
    end = b"\x02" + b"\x00" * 12
    return _MAGIC + start + b"".join(parts) + end + b"\x00" * (256 - len(end))


def _cell(name: str, *parts: bytes) -> bytes:
    return b"\x0e" + string(name) + b"".join(parts)


def _place(name: str, repetition: bytes = b"", x: int = 0) -> bytes:
    return b"\x11" + bytes([0xB8 if repetition else 0xB0]) + string(name) + signed(x) + signed(0) + repetition


def _turned(angle: float) -> bytes:
    return b"\x12\xb2" + string("A") + b"\x07" + struct.pack("<d", angle) + signed(0) * 2


def _block(data: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(data) + packer.flush()
    return b"\x22\x00" + unsigned(len(data)) + unsigned(len(packed)) + packed


def _gdsii(*cells: tuple[str, bytes]) -> bytes:
    times = struct.pack(">12h", *([0] * 12))
    head = gds.record(gds.HEADER, b"\x02\x58") + gds.record(gds.BGNLIB, times) + gds.record(gds.LIBNAME, b"L\0")
    head += gds.record(gds.UNITS, gds.real(1e-3) + gds.real(1e-9))
    body = b"".join(
        gds.record(gds.BGNSTR, times) + gds.record(gds.STRNAME, gds.text(name)) + content + gds.record(gds.ENDSTR)
        for name, content in cells
    )
    return head + body + gds.record(gds.ENDLIB)


def _boundary() -> bytes:
    xy = struct.pack(">10i", 0, 0, 200, 0, 200, 200, 0, 200, 0, 0)
    fields = gds.record(gds.LAYER, b"\0\1") + gds.record(gds.DATATYPE, b"\0\0") + gds.record(gds.XY, xy)
    return gds.record(gds.BOUNDARY) + fields + gds.record(gds.ENDEL)


def _array(name: str, side: int) -> bytes:
    xy = struct.pack(">6i", 0, 0, side * 2, 0, 0, side * 2)
    fields = gds.record(gds.SNAME, gds.text(name)) + gds.record(gds.COLROW, struct.pack(">2h", side, side))
    return gds.record(gds.AREF) + fields + gds.record(gds.XY, xy) + gds.record(gds.ENDEL)


def _single(name: str) -> bytes:
    fields = gds.record(gds.SNAME, gds.text(name)) + gds.record(gds.XY, bytes(8))
    return gds.record(gds.SREF) + fields + gds.record(gds.ENDEL)


REFUSED: dict[str, Callable[[], bytes]] = {
    "placement 2^14 x 2^14": lambda: _oasis(_cell("A", _PILLAR), _cell("T", _place("A", _REPETITION))),
    "pillar 2^14 x 2^14": lambda: _oasis(_cell("T", b"\x14\x7f" + _PILLAR[2:] + _REPETITION)),
    "list that is not there": lambda: _oasis(
        _cell("A", _PILLAR), _cell("T", _place("A", b"\x0a" + unsigned(2**28 - 2)))
    ),
    "nested 1000 deep": lambda: _oasis(
        _cell("C0", _PILLAR), *(_cell(f"C{k}", _place(f"C{k - 1}")) for k in range(1, 1001))
    ),
    "angle NaN": lambda: _oasis(_cell("A", _PILLAR), _cell("T", _turned(math.nan))),
    "angle inf": lambda: _oasis(_cell("A", _PILLAR), _cell("T", _turned(math.inf))),
    "placements beyond 2^63": lambda: _oasis(
        _cell("A", _PILLAR), _cell("T", b"\x10", *[_place("A", x=2**62 - 1)] * 4)
    ),
    "repetition beyond 2^63": lambda: _oasis(
        _cell("A", _PILLAR), _cell("T", _place("A", b"\x02" + unsigned(2**20) + unsigned(2**60)))
    ),
    "2^14 x 2^14, nested five times": lambda: _oasis(
        _cell("C0", _PILLAR), *(_cell(f"C{k}", _place(f"C{k - 1}", _REPETITION)) for k in range(1, 6))
    ),
    "unit 5e-324": lambda: _oasis(
        _cell("A", _PILLAR), start=b"\x01" + string("1.0") + b"\x07" + struct.pack("<d", 5e-324) + b"\x01"
    ),
    "unit of a billionth of the design's": lambda: _oasis(
        _cell("A", _PILLAR), start=b"\x01" + string("1.0") + real(1e12) + b"\x01"
    ),
    "blocks of 2 GB": lambda: _oasis(_cell("A", *[_block(bytes(1 << 27))] * 16)),
    "block of pillars 2^14 x 2^14": lambda: _oasis(_cell("T", _block(b"\x14\x7f" + _PILLAR[2:] + _REPETITION))),
    "block of circles 2^14 x 2^14": lambda: _oasis(_cell("T", _block(
        _PILLAR + b"\x1b\x3f" + unsigned(1) + unsigned(0) + unsigned(100) + signed(0) * 2 + _REPETITION
    ))),
    "block of single records": lambda: _oasis(_cell("A", _block(b"\x0f\x10" * (1 << 23)))),
    "GDSII nested 1000 deep": lambda: _gdsii(
        ("C0", _boundary()), *((f"C{k}", _single(f"C{k - 1}")) for k in range(1, 1001))
    ),
    "GDSII array of 32767 x 32767": lambda: _gdsii(("A", _boundary()), ("T", _array("A", 32767))),
}  # fmt: skip
READ: dict[str, Callable[[], bytes]] = {
    "text 2^14 x 2^14": lambda: _oasis(_cell("T", _PILLAR, b"\x13\x5f" + string("x") + unsigned(1) * 2
                                             + signed(0) * 2 + _REPETITION)),
    "other layer 2^14 x 2^14": lambda: _oasis(
        _cell("T", _PILLAR, b"\x14\x7f" + unsigned(9) + unsigned(0) + unsigned(200) * 2 + signed(0) * 2 + _REPETITION)
    ),
    "empty cell 2^14 x 2^14": lambda: _oasis(_cell("A"), _cell("T", _PILLAR, _place("A", _REPETITION))),
    "1 MB of padding": lambda: _oasis(_cell("T", _PILLAR, _block(bytes(10**6)))),
    "nested 90 deep": lambda: _oasis(
        _cell("C0", _PILLAR), *(_cell(f"C{k}", _place(f"C{k - 1}")) for k in range(1, 90))
    ),
    "GDSII empty array": lambda: _gdsii(("A", b""), ("T", _boundary() + _array("A", 32767))),
}  # fmt: skip


@pytest.fixture(scope="module")
def design(small_design: Design) -> Design:
    return replace(small_design, device=replace(small_design.device, aperture_um=6.0))


def _bounded(path: Path, read: Callable[[Path], object]) -> None:
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    try:
        read(path)
    finally:
        assert time.process_time() - start < 5.0
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 1 << 20


@pytest.mark.parametrize("make", REFUSED.values(), ids=REFUSED.keys())
def test_a_hostile_file_is_refused_in_words(make: Callable[[], bytes], design: Design, tmp_path: Path) -> None:
    path = tmp_path / "hostile"
    path.write_bytes(make())
    for read in (lambda file: mask.read(file, design), lambda file: list(read_shapes(file, design).chunks())):
        with pytest.raises(InputError):
            _bounded(path, read)


@pytest.mark.parametrize("make", READ.values(), ids=READ.keys())
def test_what_is_only_counted_costs_nothing(make: Callable[[], bytes], design: Design, tmp_path: Path) -> None:
    path = tmp_path / "odd"
    path.write_bytes(make())
    _bounded(path, lambda file: mask.read(file, design))
    _bounded(path, lambda file: list(read_shapes(file, design).chunks()))


#: Name of a limit, a file, a value that refuses it and one that lets it pass; None for the default.
LIMITS: dict[str, tuple[str, Callable[[], bytes], float | None, float | None]] = {
    "memory": ("memory_mb", lambda: _oasis(_cell("T", _block(b"\x0f" + bytes(10**6) + _PILLAR))), 0.9, None),
    "shapes": ("shapes", lambda: _oasis(_cell("T", _PILLAR * 20)), 19, 20),
    "depth": ("depth", lambda: _oasis(
        _cell("C0", _PILLAR), *(_cell(f"C{k}", _place(f"C{k - 1}")) for k in range(1, 250))
    ), None, 250),
    "seconds": ("seconds", lambda: _oasis(_cell("A", _PILLAR), _cell("T", *[_place("A")] * 100)), 3e-4, None),
    "GDSII depth": ("depth", lambda: _gdsii(
        ("C0", _boundary()), *((f"C{k}", _single(f"C{k - 1}")) for k in range(1, 250))
    ), None, 250),
    "GDSII seconds": ("seconds", lambda: _gdsii(("C0", (_boundary() + _single("C1")) * 50), ("C1", b"")), 1e-3, None),
}  # fmt: skip


@pytest.mark.parametrize("case", LIMITS.values(), ids=LIMITS.keys())
def test_a_design_sets_the_limits(
    case: tuple[str, Callable[[], bytes], float | None, float | None], design: Design, tmp_path: Path
) -> None:
    name, make, too_low, enough = case
    path = tmp_path / "mask"
    path.write_bytes(make())
    for read in (lambda of: mask.read(path, of), lambda of: list(read_shapes(path, of).chunks())):
        with pytest.raises(InputError, match=rf"raise `limits\.{name}` of the design, or `--limit {name}=N`"):
            read(replace(design, limits=Limits(**{name: too_low})))
        read(replace(design, limits=Limits(**{name: enough})))


#: Records that cost more than their bytes tell; today's estimate refuses them within a quarter of a second.
COSTLY: dict[str, Callable[[], bytes]] = {
    "cells": lambda: _oasis(*(_cell(str(k)) for k in range(15_000))),
    "blocks": lambda: _oasis(_cell("A", _PILLAR, _block(b"\x14\x10\x02") * 8000)),
    "properties": lambda: _oasis(_cell("A", _PILLAR, b"\x1d" * 150_000)),
    "mode records": lambda: _oasis(_cell("A", _PILLAR, b"\x10" * 150_000)),
    "repetitions": lambda: _oasis(
        _cell("A", _PILLAR, (b"\x14\x7f" + unsigned(9) + unsigned(0) + _PILLAR[4:] + _REPETITION) * 12_000)
    ),
    "compiled repetitions": lambda: _oasis(
        _cell("A", _PILLAR, (b"\x14\x04\x01" + unsigned(1022) * 2 + unsigned(600) * 2) * 60)
    ),
    "runs of one": lambda: _oasis(_cell("A", _PILLAR, (b"\x14\x10\x02" + b"\x10") * 30_000)),
}  # fmt: skip


@pytest.mark.parametrize("make", COSTLY.values(), ids=COSTLY.keys())
def test_records_spend_the_time_that_they_take(make: Callable[[], bytes], small_design: Design, tmp_path: Path) -> None:
    path = tmp_path / "costly"
    path.write_bytes(make())
    with pytest.raises(InputError, match=r"take about 0\.25 s at most.*limits\.seconds"):
        mask.read(path, replace(small_design, limits=Limits(seconds=0.25)))


def test_a_large_lens_gives_a_small_file_no_more_time(small_design: Design, tmp_path: Path) -> None:
    """Its shapes are the design's number; other records are not."""
    large = replace(small_design, device=replace(small_design.device, aperture_um=2000.0))
    path = tmp_path / "hostile"
    path.write_bytes(_oasis(_cell("T", b"\x14\x7f" + _PILLAR[2:] + _REPETITION)))
    for read in (lambda: mask.read(path, large), lambda: read_shapes(path, large)):
        with pytest.raises(InputError, match=r"take about 5\.\d+ s at most.*limits\.seconds"):
            read()
    path.write_bytes(_oasis(_cell("A", _PILLAR, b"\x1d" * 1_300_000)))
    with pytest.raises(InputError, match=r"take about 2\.\d+ s at most.*limits\.seconds"):
        mask.read(path, small_design)


def test_a_block_is_inflated_within_the_memory(small_design: Design, tmp_path: Path) -> None:
    path = tmp_path / "padding"
    path.write_bytes(_oasis(_cell("T", _PILLAR, _block(bytes(257_000_000)))))
    with pytest.raises(InputError, match=r"at most 256 MB.*limits\.memory_mb"):
        mask.read(path, small_design)
    path.write_bytes(_oasis(_cell("T", _PILLAR, _block(bytes(100_000_000)) * 3)))
    assert mask.read(path, small_design).off_site.count == 1  # blocks that are given back count one by one


def test_single_placements_of_a_cell_are_one_reference(design: Design, tmp_path: Path) -> None:
    path = tmp_path / "mask.oas"
    places = [(0, "A"), (700, "A"), (1400, "B"), (2100, "A"), (2800, "A")]
    path.write_bytes(_oasis(_cell("A", _PILLAR), _cell("B", _PILLAR), _cell("T", *(_place(n, x=x) for x, n in places))))
    reader = OasisReader(path, (1, 0, 0))
    assert [(each.cell, each.count) for each in reader.cells["T"].references] == [("A", 2), ("B", 1), ("A", 2)]
    shapes = np.concatenate([chunk.rectangles[:, :2] + chunk.shift for chunk in read_shapes(path, design).chunks()])
    assert shapes[:, 0].tolist() == [x for x, _ in places]
