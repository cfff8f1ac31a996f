"""Reader of grey pictures and stacks of them: TIFF and PNG of 8, 12 or 16 bit, and NumPy arrays."""

from __future__ import annotations

import logging
import lzma
import math
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import require_file
from metafab.core.storage.limits import beyond, limit

if TYPE_CHECKING:
    from tifffile import TiffFile

_SUFFIXES = {".tif": "tiff", ".tiff": "tiff", ".png": "png", ".npy": "npy", ".npz": "npz"}
#: Values of a pixel: three colours, or these and transparency.
_COLOURS = (3, 4)
#: Most pixels of a picture, times its colours or pages, unless the limit ``memory_mb`` is stated: 512 MiB of floats. A
#: file of up to 10 MB may hold 4096 x 3072, and 64 more for each further byte. Decoding takes 59 bytes a pixel.
_MOST_SAMPLES, _BYTES_OF_A_SAMPLE = 1 << 26, 8
_SMALL_FILE_BYTES, _MOST_SAMPLES_OF_A_SMALL_FILE = 10**7, 3 << 22
#: Longest side of a picture (pixels); no image sensor has more.
_LONGEST_SIDE_PX = 1 << 16
#: Most pages of a TIFF; the time for pages of unlike shapes grows with their square, to more than 20 s for 32 767.
_MOST_PAGES = 1 << 13
#: Arrays of an .npz file, and how NumPy compresses them; other methods of zip files inflate ten times more slowly.
_MOST_ARRAYS, _OF_NUMPY = 1 << 10, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
#: Most names of arrays in a message.
_MOST_NAMES = 8
#: Makers of decompressors, by TIFF compression: tifffile inflates strips and tiles of these at any ratio.
_OPENERS: dict[int, Callable[[], Any]] = {
    8: zlib.decompressobj,
    32946: zlib.decompressobj,
    34925: lzma.LZMADecompressor,
}
#: Compression of TIFF that tifffile expands in Python, to a list of eight bytes for each byte and in 0.2 us a run.
_PACKBITS = 32773
#: Most bytes and runs of a picture in this compression.
_MOST_UNPACKED_BYTES, _MOST_RUNS = 1 << 25, 1 << 23
#: Bytes that a strip may inflate to beyond twice its pixels, and fixed cost of a strip in bytes.
_SPARE_BYTES, _BYTES_OF_A_STRIP = 1 << 16, 512
#: Most strips and tiles of all pages, on top of one for each 256 bytes of the file; each costs 20 us.
_MOST_STRIPS = 1 << 16
_REMEDY = "save it as a grey TIFF, PNG or .npy of shape (rows, columns)"


def read_grey(path: Path) -> FloatArray:
    """Read a picture (else InputError) as floats, (rows, columns), first row as in the file; colours are averaged."""
    return read_counts(path, colours=True)[0]


def read_counts(path: Path, *, colours: bool = False) -> tuple[FloatArray, float | None]:
    """Read a grey picture (.tif, .tiff, .png, .npy, or .npz of one array) and its saturation level.

    The values have shape (rows, columns), first row as in the file; the level is the count at which the file type
    saturates, None for floats. 12-bit counts are not rescaled. Colours on the last axis are averaged with ``colours``,
    else refused; a last axis of one value is none. InputError if the file cannot be read, or is no such picture.
    """
    values = read_array(path)
    if values.ndim == 3 and values.shape[-1] == 1:
        values = values[..., 0]
    if values.ndim == 3 and values.shape[-1] in _COLOURS and colours:
        values = values[..., :3].mean(axis=-1).astype(values.dtype)
    if values.ndim != 2 or values.size == 0:
        got = f"an array of shape {values.shape}"
        raise InputError.single(str(path), "shape", "one grey frame (rows, columns)", got, _REMEDY)
    if values.dtype.kind not in "buif":
        raise InputError.single(str(path), "type", "real numbers", str(values.dtype), _REMEDY)
    return values.astype(np.float64), _saturation(values)


def read_array(path: Path) -> np.ndarray:
    """Read the array of a picture file, of any shape and type: the pages of a TIFF are its first axis.

    The file is .tif, .tiff, .png or .npy, or an .npz of one array, of at most 12.6 million values (67 million in a
    large file), or what ``memory_mb`` allows; else InputError.
    """
    kind = _SUFFIXES.get(path.suffix.lower())
    if kind is None:
        raise InputError.single(str(path), "file", "a .tif, .tiff, .png, .npy or .npz file", repr(path.suffix), _REMEDY)
    require_file(path, f"a {kind} file")
    if not path.stat().st_size:
        raise InputError.single(str(path), "file", f"a readable {kind} file", "an empty file", "was it written whole?")
    try:
        return _decoders()[kind](path)
    except InputError:
        raise
    except Exception as error:  # image libraries raise errors of any type on a broken file
        got = f"a truncated or foreign file ({type(error).__name__}: {error})"
        raise InputError.single(str(path), "file", f"a readable {kind} file", got, _REMEDY) from error


def _require_end(file: TiffFile) -> None:
    """Follow the links of the pages: ValueError if they form a circle, in which tifffile never ends, or are many."""
    layout, stream = file.tiff, file.filehandle
    order: Literal["little", "big"] = "little" if file.byteorder == "<" else "big"
    offset, seen = file.pages.first.offset, set[int]()
    while offset:
        if offset in seen:
            raise ValueError("its pages form a circle")
        if len(seen) == _MOST_PAGES:
            raise ValueError(f"more than {_MOST_PAGES} pages")
        seen.add(offset)
        stream.seek(offset)
        tags = int.from_bytes(stream.read(layout.tagnosize), order)
        stream.seek(offset + layout.tagnosize + tags * layout.tagsize)
        offset = int.from_bytes(stream.read(layout.offsetsize), order)


def _require_modest_strips(path: Path, file: TiffFile) -> None:
    """Refuse strips and tiles that take far more to inflate than their pixels: tifffile inflates them whole.

    ValueError, or InputError for tiles of more pixels than a picture may have.
    """
    stream = file.filehandle
    strips = work = runs = most_work = 0
    most_strips, most_runs = _MOST_STRIPS + stream.size // 256, max(_MOST_RUNS, stream.size)
    for page in file.pages:
        key = page.keyframe
        if key is None:
            continue
        strips += len(page.dataoffsets)
        if strips > most_strips:
            raise ValueError(f"more than {most_strips} strips or tiles")
        if key.compression != _PACKBITS and key.compression not in _OPENERS:
            continue
        if key.is_tiled:
            require_few(path, *key.chunks)
        pixels = math.prod(key.chunks) if key.is_tiled else min(math.prod(key.chunks), key.size)
        nbytes = pixels * -(-key.bitspersample // 8)
        most = 2 * nbytes + _SPARE_BYTES
        most_work += len(page.dataoffsets) * (3 * nbytes + _BYTES_OF_A_STRIP)
        # Strips may share one place in the file.
        for (place, size), times in Counter(zip(page.dataoffsets, page.databytecounts, strict=False)).items():
            stream.seek(place)
            packed = stream.read(min(size, most))
            if key.compression == _PACKBITS:
                inflated, count = _unpacked(packed, min(most, _MOST_UNPACKED_BYTES))
                runs, follows = runs + times * count, inflated >= _MOST_UNPACKED_BYTES
            else:
                opener = _OPENERS[key.compression]()
                inflated = len(opener.decompress(packed, most)) if size else 0
                # A second stream follows; zlib leaves it out, lzma does not.
                follows = isinstance(opener, lzma.LZMADecompressor) and bool(opener.unused_data.strip(b"\0"))
            if max(size, inflated) >= most or follows:
                raise ValueError(f"a strip or tile of {size} bytes that inflates to far more than its {pixels} pixels")
            work += times * (size + inflated)
            if work > most_work + _SPARE_BYTES or runs > most_runs:
                raise ValueError("strips or tiles that take far more to inflate than their pixels")


def _unpacked(packed: bytes, most: int) -> tuple[int, int]:
    """Bytes that PackBits expand to, counted to ``most``, and the number of runs among them."""
    place = inflated = runs = 0
    while place < len(packed) and inflated < most:
        count = packed[place]
        inflated += 257 - count if count > 128 else count + 1 if count < 128 else 0
        place += 2 if count > 128 else count + 2 if count < 128 else 1
        runs += 1
    return inflated, runs


def _decoders() -> dict[str, Callable[[Path], np.ndarray]]:
    def tiff(path: Path) -> np.ndarray:
        import tifffile

        # tifffile logs every unusual tag of a camera's file; a user gets one message instead.
        logging.getLogger("tifffile").setLevel(logging.CRITICAL)
        with tifffile.TiffFile(path) as file:
            _require_end(file)
            page = file.pages.first
            # A damaged size field may claim billions of strips.
            if max(page.imagewidth, page.imagelength) > _LONGEST_SIDE_PX:
                raise ValueError(f"{page.imagelength} x {page.imagewidth} pixels, more than {_LONGEST_SIDE_PX} a side")
            # Pages that were written one by one are a series each; thumbnails and masks of transparency are no pages.
            series = [one for one in file.series if not (one.keyframe.is_reduced or one.keyframe.is_mask)]
            pictures = series or list(file.series[:1])
            kinds = {(tuple(n for n in one.shape if n != 1), one.dtype): None for one in pictures}
            if len(kinds) > 1:
                got = ", ".join(f"{' x '.join(map(str, shape))} {dtype}" for shape, dtype in list(kinds)[:_MOST_NAMES])
                remedy = "save the wanted pages alone in a file"
                raise InputError.single(str(path), "file", "a TIFF file with pages of one size and type", got, remedy)
            require_few(path, *pictures[0].shape, *([len(pictures)] if len(pictures) > 1 else []))
            _require_modest_strips(path, file)
            pages = [np.asarray(one.asarray()) for one in pictures]
            return pages[0] if len(pages) == 1 else np.stack([np.squeeze(page) for page in pages])

    def png(path: Path) -> np.ndarray:
        from PIL import Image

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path, formats=("PNG",))  # Pillow's readers of other formats may take minutes.
        with image:
            require_few(path, *image.size)
            image.load()
            mode = {"LA": "L", "P": "RGB", "PA": "RGB", "RGBA": "RGB"}.get(image.mode, image.mode)
            return np.asarray(image.convert(mode))

    def npy(path: Path) -> np.ndarray:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        require_few(path, *mapped.shape)
        return np.array(mapped)

    def npz(path: Path) -> np.ndarray:
        arrays = read_arrays(path)
        if len(arrays) != 1:
            names = ", ".join(list(arrays)[:_MOST_NAMES]) + (", ..." if len(arrays) > _MOST_NAMES else "")
            got = f"{len(arrays)} arrays ({names})" if arrays else "none"
            remedy = "save the wanted one alone, as .npy or by `numpy.savez(file, array)`"
            raise InputError.single(str(path), "file", "an .npz file of one array", got, remedy)
        (values,) = arrays.values()
        require_few(path, *values.shape)
        return values

    return {"tiff": tiff, "png": png, "npy": npy, "npz": npz}


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read all arrays of an .npz file, of any shape, by name; its directory states how many bytes they inflate to.

    Raises:
        InputError: that is more than the limit ``memory_mb``.
        OSError, ValueError, BadZipFile: the file is no .npz file.
    """
    most_mb = _most_mb(path)
    with zipfile.ZipFile(path) as directory:
        entries = directory.infolist()
    if len(entries) > _MOST_ARRAYS:
        raise ValueError(f"{len(entries)} arrays, more than {_MOST_ARRAYS}")
    if any(entry.compress_type not in _OF_NUMPY for entry in entries):
        raise ValueError("arrays that are compressed otherwise than by NumPy")
    inflated = sum(entry.file_size for entry in entries)
    if inflated > 1e6 * most_mb:
        raise beyond(str(path), "arrays", "memory_mb", f"at most {most_mb:.0f} MB", f"{inflated / 1e6:.0f} MB")
    with np.load(path, allow_pickle=False) as file:
        return {name: np.asarray(file[name]) for name in file.files}


def require_few(path: Path, *shape: int) -> None:
    """Refuse (InputError) a picture whose header states more values than ``memory_mb`` holds, before it is decoded."""
    most_mb = _most_mb(path)
    if math.prod(shape) * _BYTES_OF_A_SAMPLE > 1e6 * most_mb:
        expected = f"at most {1e6 * most_mb / _BYTES_OF_A_SAMPLE:.3g} values"
        raise beyond(str(path), "shape", "memory_mb", expected, " x ".join(map(str, shape)))


def _most_mb(path: Path) -> float:
    """Limit of a file's values as floats, MB."""
    further = 64 * max(0, path.stat().st_size - _SMALL_FILE_BYTES)
    samples = min(_MOST_SAMPLES, _MOST_SAMPLES_OF_A_SMALL_FILE + further)
    return limit("memory_mb", samples * _BYTES_OF_A_SAMPLE / 1e6)


def _saturation(values: np.ndarray) -> float | None:
    """The largest count of the sensor behind the file: 12-bit counts often come in 16-bit files."""
    if values.dtype.kind not in "ui":
        return None
    bits = 8 * values.dtype.itemsize
    peak = int(values.max(initial=0))
    if bits == 16 and peak in {2**10 - 1, 2**12 - 1, 2**14 - 1}:
        return float(peak)
    return float(2**bits - 1)
