"""Pictures that are too large are refused by their header, before they are decoded."""

from __future__ import annotations

import lzma
import resource
import struct
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile

from metafab.core.errors import InputError
from metafab.core.storage.pictures import read_array, read_counts, read_grey

SIDE = 30_720


def _png() -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + SIDE)) for _ in range(SIDE)) + packer.flush()
    head = struct.pack(">IIBBBBB", SIDE, SIDE, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join([chunk(b"IHDR", head), chunk(b"IDAT", rows), chunk(b"IEND", b"")])


def _tiff() -> bytes:
    """A whole grey picture in strips of 16 rows, all of which share one deflated strip of zeros."""
    strip = zlib.compress(bytes(2 * SIDE * 16), 9)
    strips = SIDE // 16
    after = 8 + 2 + 12 * 9 + 4
    tags = [
        (256, 4, 1, SIDE), (257, 4, 1, SIDE), (258, 3, 1, 16), (259, 3, 1, 8), (262, 3, 1, 1),
        (273, 4, strips, after), (277, 3, 1, 1), (278, 4, 1, 16), (279, 4, strips, after + 4 * strips),
    ]  # fmt: skip
    table = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    offsets = struct.pack("<I", after + 8 * strips) * strips + struct.pack("<I", len(strip)) * strips
    return b"II*\0" + struct.pack("<I", 8) + table + offsets + strip


def _npy() -> bytes:
    return b"\x93NUMPY\x01\x00v\x00" + (
        f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({SIDE}, {SIDE}), }}".ljust(117).encode() + b"\n"
    )


@pytest.mark.parametrize(("name", "make"), [("large.png", _png), ("large.tif", _tiff), ("large.npy", _npy)])
def test_a_picture_of_a_thousand_million_pixels_is_refused_by_its_header(
    name: str, make: object, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(make())  # type: ignore[operator]
    if name.endswith(".npy"):
        with path.open("r+b") as stream:
            stream.truncate(stream.seek(0, 2) + SIDE * SIDE)  # a sparse file, which holds all that it claims
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    with pytest.raises(InputError, match=r"pixels|values, got 30720 x 30720"):
        read_counts(path)
    assert time.process_time() - start < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100 * 1024


@pytest.mark.parametrize("compression", ["zlib", "lzma"])
@pytest.mark.parametrize("places", [{}, {"tile": (16, 16)}, {"rowsperstrip": 3}])
def test_a_strip_that_inflates_to_more_than_its_pixels_is_refused(
    compression: str, places: dict[str, object], tmp_path: Path
) -> None:
    """A strip of a small picture may hold a gigabyte of zeros; each page is looked at."""
    path, values = tmp_path / "strip.tif", np.arange(2 * 40 * 50, dtype=np.uint16).reshape(2, 40, 50)
    tifffile.imwrite(path, values, compression=compression, photometric="minisblack", metadata=None, **places)
    assert np.array_equal(read_array(path), values)
    pack = zlib.compress if compression == "zlib" else lzma.compress
    bomb = pack(bytes(10**6))
    with tifffile.TiffFile(path) as file:
        page = file.pages[1]
        offsets, counts = page.tags[324 if "tile" in places else 273], page.tags[325 if "tile" in places else 279]
        single = offsets.count == 1
        at = [tag.valueoffset for tag in (offsets, counts)]
        forms = ["<I" if tag.dtype == 4 else "<H" for tag in (offsets, counts)]
    image = bytearray(path.read_bytes())
    assert single == (not places) and forms[0] == "<I" and len(bomb) < 1 << 16
    struct.pack_into("<I", image, at[0], len(image))
    struct.pack_into(forms[1], image, at[1], len(bomb))
    path.write_bytes(image + bomb)
    with pytest.raises(InputError, match="inflates to far more than its"):
        read_array(path)


@pytest.mark.parametrize(("times", "match"), [(2, ""), (2000, "inflates to far more"), (0, "far more to inflate")])
def test_packed_strips_expand_to_their_pixels(times: int, match: str, tmp_path: Path) -> None:
    """tifffile expands PackBits in Python: strips that hold too much, or runs of nothing that many strips share."""
    side = 1000
    strip = bytes([0x81, 7]) * (side // 128 + 1) * times if times else bytes([0x80]) * 60_000
    strips, after = side, 8 + 2 + 12 * 9 + 4
    tags = [
        (256, 4, 1, side), (257, 4, 1, side), (258, 3, 1, 8), (259, 3, 1, 32773), (262, 3, 1, 1),
        (273, 4, strips, after), (277, 3, 1, 1), (278, 4, 1, 1), (279, 4, strips, after + 4 * strips),
    ]  # fmt: skip
    table = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    offsets = struct.pack("<I", after + 8 * strips) * strips + struct.pack("<I", len(strip)) * strips
    path = tmp_path / "packed.tif"
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + table + offsets + strip)
    start = time.process_time()
    if match:
        with pytest.raises(InputError, match=match):
            read_array(path)
    else:
        assert np.array_equal(read_array(path), np.full((side, side), 7))
    assert time.process_time() - start < 5.0


def test_a_picture_is_of_the_format_that_its_name_says(tmp_path: Path) -> None:
    """Pillow reads other formats in Python, some through programs of their own."""
    path = tmp_path / "plain.png"
    path.write_bytes(b"P2\n2 2\n255\n1 2 3 4\n")
    with pytest.raises(InputError, match="readable png"):
        read_array(path)


@pytest.mark.parametrize("kind", ["many values", "many arrays", "bzip2"])
def test_a_zip_file_holds_few_arrays_as_numpy_writes_them(kind: str, tmp_path: Path) -> None:
    path, small = tmp_path / "zipped.npz", np.zeros(3)
    if kind == "many values":  # as floats eight times what the file inflates to
        np.savez_compressed(path, values=np.zeros((5000, 5000), dtype=np.uint8))
    elif kind == "many arrays":
        np.savez(path, **{f"a{number}": small for number in range(1100)})
    else:
        np.save(tmp_path / "small.npy", small)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as file:
            file.write(tmp_path / "small.npy")
    with pytest.raises(InputError):
        read_counts(path)


def test_a_picture_within_the_budget_is_read(tmp_path: Path) -> None:
    values = np.arange(20, dtype=np.uint16).reshape(4, 5)
    np.save(tmp_path / "small.npy", values)
    assert read_counts(tmp_path / "small.npy")[0].tolist() == values.tolist()


def test_the_budget_is_a_number_of_pixels_whatever_the_sides(tmp_path: Path) -> None:
    values = np.lib.format.open_memmap(tmp_path / "wide.npy", "w+", np.uint8, (2049, 32_768))
    del values
    with pytest.raises(InputError, match=r"at most 6.71e\+07 values, got 2049 x 32768"):
        read_counts(tmp_path / "wide.npy")


@pytest.mark.parametrize("pages", [3, 300])
def test_pages_in_a_circle_are_refused(pages: int, tmp_path: Path) -> None:
    path = tmp_path / "circle.tif"
    with tifffile.TiffWriter(path) as writer:
        writer.write(np.ones((pages, 2, 3), dtype=np.uint16), photometric="minisblack", metadata=None)
    with tifffile.TiffFile(path) as file:
        assert read_array(path).shape == (pages, 2, 3)
        last = file.pages[-1].offset
    image = bytearray(path.read_bytes())
    (tags,) = struct.unpack_from("<H", image, last)
    struct.pack_into("<I", image, last + 2 + 12 * tags, 8)  # the link of the last page leads to the first
    path.write_bytes(image)
    with pytest.raises(InputError, match="form a circle"):
        read_array(path)


@pytest.mark.parametrize("shape", [(3, 40, 50), (5, 40, 50), (40, 50, 7), (40, 50, 2)])
def test_pages_are_no_colours(shape: tuple[int, ...], tmp_path: Path) -> None:
    """Colours stand on the last axis; the mean over columns of a stack of pages would be a picture of nothing."""
    np.save(tmp_path / "stack.npy", np.ones(shape))
    with pytest.raises(InputError, match="one grey frame"):
        read_grey(tmp_path / "stack.npy")
    np.save(tmp_path / "colours.npy", np.arange(40.0 * 50 * 3).reshape(40, 50, 3))
    assert read_grey(tmp_path / "colours.npy")[1, 2] == pytest.approx(3 * 52 + 1)


@pytest.mark.parametrize(
    ("arrays", "got"),
    [
        ({"depth": 1, "mask": 2}, r"2 arrays \(depth, mask\)"),
        ({}, "none"),
        (dict.fromkeys("abcdefghij", 1), r"10 arrays \(a, b, c, d, e, f, g, h, ...\)"),
    ],
)
def test_an_npz_of_several_arrays_is_named_as_such(arrays: dict[str, int], got: str, tmp_path: Path) -> None:
    path = tmp_path / "several.npz"
    np.savez(path, **{name: np.full((4, 4), value) for name, value in arrays.items()})
    with pytest.raises(InputError, match=rf"an .npz file of one array, got {got}; save the wanted one alone"):
        read_array(path)


@pytest.mark.parametrize("name", ["x.npy", "x.npz", "x.png", "x.tif"])
def test_empty_files_and_folders_are_called_so(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.touch()
    with pytest.raises(InputError, match="got an empty file; was it written whole"):
        read_array(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match="got a folder"):
        read_array(path)


def test_a_grey_png_with_transparency_is_grey(tmp_path: Path) -> None:
    from PIL import Image

    counts = np.arange(16, dtype=np.uint8).reshape(4, 4)
    Image.fromarray(np.stack([counts, np.full_like(counts, 9)], axis=-1), mode="LA").save(tmp_path / "grey.png")
    assert np.array_equal(read_counts(tmp_path / "grey.png")[0], counts)


def test_a_last_axis_of_one_value_is_no_colour(tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", np.arange(12.0).reshape(3, 4, 1))
    assert np.array_equal(read_counts(tmp_path / "one.npy")[0], np.arange(12.0).reshape(3, 4))


def test_pages_that_were_written_one_by_one_are_all_read_and_unlike_ones_refused(tmp_path: Path) -> None:
    pages = np.arange(60, dtype=np.uint16).reshape(3, 4, 5)
    for name, written in (("alike", pages), ("unlike", [pages[0], pages[1, :2]]), ("thumbnail", [pages[0]])):
        with tifffile.TiffWriter(tmp_path / f"{name}.tif") as file:
            for page in written:
                file.write(page)
            if name == "thumbnail":
                file.write(pages[1, ::2, ::2], subfiletype=1)
    np.testing.assert_array_equal(read_array(tmp_path / "alike.tif"), pages)
    np.testing.assert_array_equal(read_grey(tmp_path / "thumbnail.tif"), pages[0])
    with tifffile.TiffWriter(tmp_path / "mixed.tif") as file:
        file.write(pages[:1])
        file.write(pages[1])
        file.write(np.ones((2, 5), dtype=bool), subfiletype=4, photometric="mask")  # of transparency
    np.testing.assert_array_equal(read_array(tmp_path / "mixed.tif"), pages[:2])
    with pytest.raises(InputError, match="4 x 5 uint16, 2 x 5 uint16"):
        read_array(tmp_path / "unlike.tif")
