"""Hostile files by name: small ones that state much, and files of some 10 MB that hold as many records as fit."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np

from metafab import camera
from metafab.core.storage.hdf5 import SEAL_BYTES
from metafab.mask.gdsii import records as gds
from metafab.mask.oasis.elements import signed, string, unsigned
from metafab.mask.oasis.writer import CBLOCK, CELL, END, END_BYTES, MAGIC, PLACEMENT, START, TEXT, XYRELATIVE

#: Kinds of :func:`list_in_a_block`.
LISTS = ("corners", "places")
_MANY = 1 << 14
_RECTANGLE, _POLYGON, _TRAPEZOID, _REPEATED = 20, 21, 23, 0b100


@dataclass(frozen=True)
class NamedFile:
    """A hostile file."""

    name: str  #: What it holds.
    suffix: str  #: Format.
    make: Callable[[], bytes]  #: Makes its content.
    must_be_refused: bool = True  #: Whether to read it would be a fault.
    design: str = "helix_small"  #: Design whose mask it claims to be.


def named_files(design: str) -> list[NamedFile]:
    """All files; ``design`` is the text of a design file."""
    masks = [NamedFile(name, "oas", make) for name, make in _oasis().items()]
    masks = [NamedFile(name, "oas", make, must_be_refused=False) for name, make in _harmless().items()] + masks
    masks += [NamedFile(name, "gds", make) for name, make in _gdsii().items()]
    large = ("a rectangle 2^14 x 2^14 times", "a cell placed 2^14 x 2^14 times", "a block of 1 GB of padding")
    masks += [NamedFile(name, "oas", _oasis()[name], design="helix_2mm") for name in large]
    frames = [NamedFile(name, suffix, make) for (name, suffix), make in _frames().items()]
    return masks + frames + [NamedFile(name, "toml", make) for name, make in _designs(design).items()]


def list_in_a_block(kind: str, count: int, layer: int) -> bytes:
    """A polygon of ``count`` corners, or a trapezoid at ``count`` places: some bytes a thousand of them."""
    drawn = unsigned(layer) + b"\0"
    heads = {
        "corners": bytes([_POLYGON, 0b11_1011]) + drawn + unsigned(0) + unsigned(count),
        "places": bytes([_TRAPEZOID, 0b111_1111]) + drawn + unsigned(9) * 2 + bytes(4) + b"\4" + unsigned(count),
    }
    return _file(_cell("A") + _block(heads[kind] + b"\2" * (count + 1) + signed(0) * 2))


def records_in_a_block(count: int, layer: int) -> bytes:
    """``count`` rectangles of two bytes each."""
    return _file(_cell("A") + _block(_rectangle(layer) + bytes([_RECTANGLE, 0]) * count))


def _oasis() -> dict[str, Callable[[], bytes]]:
    top, grid = _cell("A") + _rectangle() + _cell("TOP"), _grid()
    behind = _cell("A") + _rectangle()
    files: dict[str, bytes | Callable[[], bytes]] = {
        "a rectangle 2^14 x 2^14 times": _cell("A") + _rectangle(grid=grid),
        "a cell placed 2^14 x 2^14 times": top + _placed("A", grid),
        "seven levels of 2^14 x 2^14 placements": _nested(8, lambda below: _placed(below, grid)),
        "cells nested 1000 deep": _nested(1000, _placed),
        "70 levels of two placements": _nested(70, lambda below: 2 * _placed(below)),
        "a block of 1 GB of padding": lambda: behind + _block(bytes(1 << 30)),
        "eight blocks of 1 GB of padding": lambda: behind + 8 * _block(bytes(1 << 30)),
        "a block of 100 million rectangles": lambda: behind + _block(bytes([_RECTANGLE, 0]) * 100_000_000),
        "1.2 million empty cells": lambda: b"".join(_cell(str(number)) for number in range(1_200_000)),
        "900 000 blocks of one rectangle": lambda: behind + _block(bytes([_RECTANGLE, 0x10, 2])) * 900_000,
        "9.9 million properties": lambda: behind + bytes([29]) * 9_900_000,
        "9.9 million mode records": lambda: behind + bytes([XYRELATIVE]) * 9_900_000,
        "4.9 million texts": lambda: behind + _text() + bytes([TEXT, 0]) * 4_900_000,
        "4.9 million single placements": lambda: top + _placed("A") + bytes([PLACEMENT, 0]) * 4_900_000,
        "4.9 million names": lambda: bytes([3, 0]) * 4_900_000 + behind,
        "200 000 repetitions on another layer": lambda: behind + _rectangle(9, grid) * 200_000,
    }
    units = {value: b"\7" + struct.pack("<d", value) for value in (5e-324, float("nan"), float("inf"), 0.0, -1.0)}
    found = {name: partial(_made, content) for name, content in files.items()}
    found |= {f"a unit of {value:g}": partial(_file, behind, unit) for value, unit in units.items()}
    for value in (float("nan"), float("inf")):
        turned = bytes([PLACEMENT + 1, 0b1011_0010]) + string("A") + b"\7" + struct.pack("<d", value) + signed(0) * 2
        found[f"a placement turned by {value:g}"] = partial(_file, top + turned)
    return found | {f"200 million {kind} in a block": partial(list_in_a_block, kind, 200_000_000, 1) for kind in LISTS}


def _harmless() -> dict[str, Callable[[], bytes]]:
    """Masks that may be read: those above are the same with more."""
    behind = _cell("A") + _rectangle()
    return {
        "an empty cell": partial(_file, _cell("A")),
        "a rectangle of another layer 2^14 x 2^14 times": partial(_file, behind + _rectangle(9, _grid())),
        "a text 2^14 x 2^14 times": partial(_file, behind + _text(_grid())),
        "3.3 million rectangles": lambda: _file(behind + bytes([_RECTANGLE, 0x10, 2]) * 3_300_000),
    }


def _gdsii() -> dict[str, Callable[[], bytes]]:
    return {
        "a cell in an array of 32767 x 32767": lambda: _library({"A": _boundary(1), "TOP": _array("A")}),
        "eight levels of such arrays": lambda: _library(_levels(9, _array)),
        "structures nested 1000 deep": lambda: _library(_levels(1000, _reference)),
        "structures in a circle": lambda: _library({"A": _boundary(1) + _reference("B"), "B": _reference("A")}),
        "220 000 empty structures": lambda: _library({str(number): b"" for number in range(220_000)}),
        "shapes of two layers in turn": lambda: _library({"A": (_boundary(1) + _boundary(9)) * 75_000}),
    }


def _frames() -> dict[tuple[str, str], Callable[[], bytes]]:
    """Raw frames: HDF5 without its checksum, TIFF and NPY."""
    zeros = {"chunks": (5000, 5000), "compression": "gzip", "compression_opts": 9}
    with_array: dict[str, dict[str, Any]] = {
        "an unwritten array of 30000 x 30000": {"shape": (30000, 30000), "dtype": "f8"},
        "chunks of 16000 x 16000 of an array of 2 x 2": {
            "shape": (2, 2), "dtype": "f8", "chunks": (16000, 16000), "maxshape": (None, None),
        },
        "100 million chunks of 1 x 1": {"shape": (10000, 10000), "dtype": "f8", "chunks": (1, 1)},
        "10000 x 10000 compressed zeros": {"data": np.zeros((10000, 10000)), **zeros},
        "external storage": {"shape": (24, 32), "dtype": "f8", "external": [("/etc/passwd", 0, 24 * 32 * 8)]},
    }  # fmt: skip
    frames: dict[tuple[str, str], Callable[[], bytes]] = {
        (name, "h5"): partial(_frame, partial(h5py.File.create_dataset, name="frame", **options))
        for name, options in with_array.items()
    }
    frames["an external link", "h5"] = partial(_frame, partial(_link, h5py.ExternalLink("/tmp/other.h5", "/frame")))
    frames["a soft link to nowhere", "h5"] = partial(_frame, partial(_link, h5py.SoftLink("/nowhere")))
    frames["30720 x 30720 pixels", "tif"] = partial(_tiff, 30720, bytes(100), 1)
    frames["a strip that inflates to 1 GiB", "tif"] = lambda: _tiff(100, zlib.compress(bytes(1 << 30), 9), 8)
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (30000, 30000), }".ljust(117) + b"\n"
    frames["30000 x 30000 numbers", "npy"] = lambda: b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head
    frames["heaps that overlap", "h5"] = _overlapping_heaps
    frames["a run of 600 MB", "tif"] = partial(_tiff, 100, b"\x81\0" * 4_900_000, 32773)
    frames["8192 x 8192 zeros", "npz"] = partial(_zipped, np.zeros((8192, 8192), dtype=np.uint8), zipfile.ZIP_DEFLATED)
    frames["4000 x 4000 zeros by bzip2", "npz"] = partial(_zipped, np.zeros((4000, 4000)), zipfile.ZIP_BZIP2)
    frames["a plain text of numbers", "png"] = lambda: b"P2\n8000 8000\n255\n" + b"1 " * 4_900_000
    for value in (np.nan, np.inf):
        frames[f"a frame of {value:g}", "npy"] = partial(_array_file, np.full((64, 64), value))
    return frames


def _designs(design: str) -> dict[str, Callable[[], bytes]]:
    """Design files."""
    quoted = 'name = "helix'
    texts = {
        "arrays nested 20 000 deep": "a = " + "[" * 20_000 + "]" * 20_000 + "\n" + design,
        "tables nested 20 000 deep": "a = " + "{b=" * 20_000 + "1" + "}" * 20_000 + "\n" + design,
        "a number of 5000 digits": "a = " + "9" * 5000 + "\n" + design,
        "NUL in a name": design.replace(quoted, 'name = "\\u0000helix', 1),
        "a key of 50 000 parts": ".".join(["a"] * 50_000) + " = 1\n" + design,
        "a head of 50 000 parts": design + "\n[" + ".".join(["a"] * 50_000) + "]\n",
        "1.9 million escaped quotes": 'a = "' + '\\"' * 1_900_000 + '"\n' + design,
        "330 000 unknown keys": "".join(f"a{number} = 1\n" for number in range(330_000)) + design,
        "10 MB of comment": design + "# " + "x" * 9_900_000 + "\n",
    }
    return {name: partial(str.encode, text) for name, text in texts.items()}


# OASIS


def _made(content: bytes | Callable[[], bytes]) -> bytes:
    return _file(content if isinstance(content, bytes) else content())


def _file(content: bytes, unit: bytes = b"\0" + unsigned(2000)) -> bytes:
    start = bytes([START]) + string("1.0") + unit + bytes(13)
    return MAGIC + start + content + bytes([END]) + bytes(END_BYTES - 1)


def _cell(name: str) -> bytes:
    return bytes([CELL]) + string(name)


def _block(content: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(content) + packer.flush()
    return bytes([CBLOCK, 0]) + unsigned(len(content)) + unsigned(len(packed)) + packed


def _grid() -> bytes:
    """Repetition of 2^14 columns and rows."""
    return b"\1" + unsigned(_MANY - 2) * 2 + unsigned(700) * 2


def _rectangle(layer: int = 1, grid: bytes = b"") -> bytes:
    info = 0b111_1011 | (_REPEATED if grid else 0)
    return bytes([_RECTANGLE, info]) + unsigned(layer) + b"\0" + unsigned(300) * 2 + bytes(2) + grid


def _text(grid: bytes = b"") -> bytes:
    info = 0b101_1011 | (_REPEATED if grid else 0)
    return bytes([TEXT, info]) + string("words") + unsigned(5) + bytes(3) + grid


def _placed(name: str, grid: bytes = b"") -> bytes:
    return bytes([PLACEMENT, 0b1011_0000 | (0b1000 if grid else 0)]) + string(name) + bytes(2) + grid


def _nested(depth: int, placed: Callable[[str], bytes]) -> bytes:
    above = (_cell(f"C{level}") + placed(f"C{level - 1}") for level in range(1, depth))
    return _cell("C0") + _rectangle() + b"".join(above)


# GDSII


def _library(cells: dict[str, bytes]) -> bytes:
    units = gds.record(gds.UNITS, gds.real(1e-3) + gds.real(5e-10))
    head = gds.record(gds.HEADER, b"\2\x58") + gds.record(gds.BGNLIB, bytes(24)) + gds.record(gds.LIBNAME, b"L\0")
    return head + units + b"".join(_structures(cells.items())) + gds.record(gds.ENDLIB)


def _structures(cells: Iterable[tuple[str, bytes]]) -> Iterable[bytes]:
    for name, content in cells:
        head = gds.record(gds.BGNSTR, bytes(24)) + gds.record(gds.STRNAME, gds.text(name))
        yield head + content + gds.record(gds.ENDSTR)


def _levels(depth: int, placed: Callable[[str], bytes]) -> dict[str, bytes]:
    return {"C0": _boundary(1)} | {f"C{level}": placed(f"C{level - 1}") for level in range(1, depth)}


def _boundary(layer: int) -> bytes:
    corners = struct.pack(">10i", 0, 0, 300, 0, 300, 300, 0, 300, 0, 0)
    on = gds.record(gds.LAYER, struct.pack(">h", layer)) + gds.record(gds.DATATYPE, bytes(2))
    return gds.record(gds.BOUNDARY) + on + gds.record(gds.XY, corners) + gds.record(gds.ENDEL)


def _reference(name: str) -> bytes:
    named = gds.record(gds.SREF) + gds.record(gds.SNAME, gds.text(name))
    return named + gds.record(gds.XY, bytes(8)) + gds.record(gds.ENDEL)


def _array(name: str, count: int = 32767) -> bytes:
    named = gds.record(gds.AREF) + gds.record(gds.SNAME, gds.text(name))
    size = gds.record(gds.COLROW, struct.pack(">2h", count, count))
    places = struct.pack(">6i", 0, 0, count * 700, 0, 0, count * 700)
    return named + size + gds.record(gds.XY, places) + gds.record(gds.ENDEL)


# Frames


def _frame(replace: Callable[[h5py.File], object]) -> bytes:
    """A raw frame whose array is replaced."""
    stream = io.BytesIO(_raw_frame())
    with h5py.File(stream, "r+") as file:
        attributes = dict(file["frame"].attrs)
        del file["frame"]
        made = replace(file)
        if isinstance(made, h5py.Dataset):
            made.attrs.update({name: attributes[name] for name in ("units", "description")})
    return stream.getvalue()


def _overlapping_heaps() -> bytes:
    """A raw frame behind which 150 000 heaps of texts all reach to one list of 300 000."""
    heads = (b"GCOL\1\0\0\0" + struct.pack("<QQQ", 1 << 40, 1, 32 * left) for left in reversed(range(150_000)))
    return _raw_frame() + b"".join(heads) + struct.pack("<QQ", 1, 0) * 300_000


def _zipped(array: np.ndarray[Any, Any], compression: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as file:
        file.writestr("frame.npy", _array_file(array))
    return stream.getvalue()


def _link(link: object, file: h5py.File) -> None:
    file["frame"] = link


def _raw_frame() -> bytes:
    """A whole raw frame of 24 x 32 pixels without its checksum, which would stop every change."""
    counts = np.random.default_rng(1).poisson(300.0, (24, 32)).astype(np.float64)
    with TemporaryDirectory() as folder:
        path = Path(folder, "whole.h5")
        camera.save(camera.RawFrame(counts, 3.45, (-15.5 * 3.45, -11.5 * 3.45), 2.0), path)
        return path.read_bytes()[:-SEAL_BYTES]


def _tiff(side: int, strip: bytes, compression: int) -> bytes:
    """One page of ``side`` x ``side`` pixels of 16 bits in one strip."""
    tags = {256: side, 257: side, 258: 16, 259: compression, 262: 1, 273: 8, 277: 1, 278: side, 279: len(strip)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    return b"II*\0" + struct.pack("<I", 8 + len(strip)) + strip + struct.pack("<H", len(tags)) + entries + bytes(4)


def _array_file(array: np.ndarray[Any, Any]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()
