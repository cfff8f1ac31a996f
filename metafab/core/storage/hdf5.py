"""HDF5 files of metafab: every dataset with units and a description, every file with its provenance and a checksum.

The checksum follows the last byte of the HDF5 image. The HDF5 library trusts a file's content and may hang on a damaged
one, so the checksum is tested before the file is opened. Programs that modify the file through HDF5 drop the checksum;
files without one are opened without the test.
"""

from __future__ import annotations

import errno
import math
import mmap
import os
import shutil
import zlib
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from metafab import __version__
from metafab.core.errors import InputError
from metafab.core.storage.files import require_file, whole_file
from metafab.core.storage.limits import beyond, limit


@contextmanager
def create(
    path: Path | str, *, kind: str, format_version: int, inputs_sha256: str, streamed: bool = False
) -> Iterator[h5py.File]:
    """Create an HDF5 file that appears under ``path`` only if the block succeeds.

    Readers of another ``kind``, such as ``"metafab library"``, refuse it. ``format_version`` is of this kind's layout,
    ``inputs_sha256`` the fingerprint of all inputs of the content. If ``streamed``, the file is built on the disk and
    not in memory; test :func:`require_space` before each write.
    """
    # In memory by default: on a full disk the HDF5 library aborts the process, Python's own write raises.
    with whole_file(Path(path)) as part:
        # Without tracked times, the same content gives the same bytes.
        options: dict[str, Any] = {"libver": ("v110", "v110"), "track_order": True}
        if not streamed:
            options |= {"driver": "core", "backing_store": False}
        with h5py.File(part, "w", **options) as file:
            file.attrs["kind"] = kind
            file.attrs["format_version"] = format_version
            file.attrs["inputs_sha256"] = inputs_sha256
            file.attrs["metafab_version"] = __version__
            yield file
            file.flush()
            image = b"" if streamed else file.id.get_file_image()
        with part.open("r+b" if streamed else "wb") as stream:
            stream.write(image)
            checksum = _checksum(stream, part.stat().st_size) if streamed else zlib.crc32(image)
            stream.write(_seal(checksum))


def require_space(path: Path, nbytes: int) -> None:
    """Raise the error of a full disk if the folder of ``path`` has less than ``nbytes`` left."""
    if shutil.disk_usage(path.parent).free < nbytes:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def put(
    group: h5py.Group,
    name: str,
    data: ArrayLike,
    *,
    units: str,
    description: str,
    dims: Sequence[str] = (),
    compress: bool = False,
) -> h5py.Dataset:
    """Store an array with its units ("1" for pure numbers), a one-line description and its dimension scales.

    Text is stored as bytes. ``dims`` names the axes: a dataset of ``group``, or else of the next group above, with such
    a name becomes the scale of that axis; ``dims=(name,)`` makes the dataset itself a scale. xarray requires scales on
    all axes or none.
    """
    array = np.asarray(data)
    if array.dtype.kind == "U":
        array = array.astype("S")
    options: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if compress else {}
    dataset = group.create_dataset(name, data=array, track_times=False, **options)
    _describe(dataset, units, description)
    if tuple(dims) == (name,):
        dataset.make_scale(name)
    else:
        _scale(dataset, group, dims)
    return dataset


def reserve(
    group: h5py.Group,
    name: str,
    shape: tuple[int, ...],
    dtype: DTypeLike,
    *,
    units: str,
    description: str,
    dims: Sequence[str],
) -> h5py.Dataset:
    """Make room for an array that is written one entry of its first axis at a time; see :func:`put`."""
    dataset = group.create_dataset(
        name, shape, dtype, chunks=(1, *shape[1:]), compression="gzip", compression_opts=1, shuffle=True,
        track_times=False,
    )  # fmt: skip
    _describe(dataset, units, description)
    _scale(dataset, group, dims)
    return dataset


def _describe(dataset: h5py.Dataset, units: str, description: str) -> None:
    dataset.attrs["units"] = units
    dataset.attrs["description"] = description


def _scale(dataset: h5py.Dataset, group: h5py.Group, dims: Sequence[str]) -> None:
    """Name the axes of a dataset, and attach the scales of these names in its group or the next one above."""
    for axis, dimension in enumerate(dims):
        dataset.dims[axis].label = dimension
        place = group
        while dimension not in place and place.name != "/":
            place = place.parent
        if dimension in place:
            dataset.dims[axis].attach_scale(place[dimension])


@contextmanager
def open_kind(path: Path | str, *, kind: str, format_version: int, remedy: str) -> Iterator[h5py.File]:
    """Open an existing file of a kind for reading.

    InputError if it is missing, truncated, not HDF5, of another kind, of a newer format, or refused by
    :func:`require_modest`.
    """
    path, expected = Path(path), f"a {kind} file (HDF5, format {format_version} or older)"
    require_file(path, expected, remedy)
    try:
        if _damaged(path):
            got = "a damaged file (its bytes are not those that were written)"
            raise InputError.single(str(path), "file", expected, got, remedy)
        file = open_file(path)
    except (OSError, RuntimeError) as error:
        reason = "a truncated or foreign file" if path.stat().st_size else "an empty file"
        raise InputError.single(str(path), "file", expected, f"{reason} ({error})", remedy) from error
    with file:
        try:
            require_modest(file, path)
            found = file.attrs.get("kind")
            if not isinstance(found, str) or found != kind:
                got = f"an HDF5 file of kind {found!r}" if found else "an HDF5 file that metafab did not write"
                raise InputError.single(str(path), "kind", expected, got, remedy)
            version = int(file.attrs.get("format_version", 0))
            if version > format_version:
                raise InputError.single(
                    str(path), "format_version", expected, f"format {version}", "update metafab to read this file"
                )
            yield file
        except _UNREADABLE as error:
            raise InputError.single(
                str(path), "content", expected, f"unreadable or missing content ({error})", remedy
            ) from error


def open_file(path: Path) -> h5py.File:
    """Open any HDF5 file for reading.

    OSError if it is none, or if the HDF5 library would never return from its attributes; see :func:`require_modest` for
    its arrays.
    """
    file = h5py.File(path, "r")
    _, size_bytes = file.id.get_create_plist().get_sizes()
    if _has_endless_heap(path, size_bytes):
        file.close()
        raise OSError("a damaged heap of texts")
    return file


def _has_endless_heap(path: Path, size_bytes: int) -> bool:
    """Whether a global heap holds free space of size 0, on which the HDF5 library (1.14) steps in place forever.

    Also true where overlapping heaps hold more than ``_MOST_HEAP_OBJECTS`` together.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as image:

        def number(place: int, length: int) -> int:
            return int.from_bytes(image[place : place + length], "little")

        head = 8 + size_bytes  # of a heap and of each object in it
        objects = 0
        start = image.find(_HEAP)
        while start >= 0:
            end = min(start + number(start + 8, size_bytes), len(image))
            place = start + head
            while place + head <= end:
                is_free, content = number(place, 2) == 0, number(place + 8, size_bytes)
                objects += 1
                if (is_free and content == 0) or objects > _MOST_HEAP_OBJECTS:
                    return True
                place += content if is_free else head + -(-content // 8) * 8
            start = image.find(_HEAP, start + len(_HEAP))
    return False


def require_modest(file: h5py.File, path: Path, *, names: Collection[str] | None = None) -> None:
    """Check links, types and sizes of a file, or of the datasets of these absolute names, before any array is read.

    A small file can claim large arrays that were never written or that deflate to almost nothing. A file of up to 10 MB
    may hold 768 MiB of arrays, a larger file 64 more bytes for each of its own, unless the limit ``memory_mb`` is
    stated. The largest array counts together with its reader's copy as floats and the buffers from which a chunk is
    inflated.

    InputError for a link or dataset whose content lies outside the file or is computed, a type other than numbers and
    bytes, more bytes than the budget, or hostile chunks.
    """
    file_bytes = path.stat().st_size
    most = limit("memory_mb", (_BUDGET_BYTES + _EXPANSION * max(0, file_bytes - _SMALL_FILE_BYTES)) / 1e6)
    most_chunks = _MOST_CHUNKS + file_bytes // 1024
    arrays = besides = 0
    for name, item in _datasets(file, path):
        if names is not None and name not in names:
            continue
        _require_plain(name, item, path)
        chunk = item.chunks or (1,) * item.ndim
        chunks = math.prod(-(-side // part) for side, part in zip(item.shape, chunk, strict=True))
        if item.chunks and chunks > most_chunks:
            raise _distrusted(path, name, f"at most {most_chunks} chunks", f"{chunks} chunks of shape {chunk}")
        item_bytes = max(item.dtype.itemsize, 1)
        arrays += max(item.size, math.prod(chunk)) * item_bytes
        buffers = _BUFFERS_OF_A_CHUNK * math.prod(chunk) * item_bytes if item.compression else 0
        besides = max(besides, item.size * max(item_bytes, _BYTES_OF_A_FLOAT) + buffers)
        if arrays + besides > most * 1e6:
            expected = f"at most {most:.0f} MB of arrays and their copies in a file of {file_bytes / 1e6:.3g} MB"
            raise beyond(str(path), name, "memory_mb", expected, f"shape {item.shape} in chunks of {item.chunks}")


def _datasets(file: h5py.File, path: Path) -> Iterator[tuple[str, h5py.Dataset]]:
    """Absolute names of all datasets, each once; InputError for links to elsewhere, and too many objects."""
    objects = 0
    visited, waiting = set[int](), [file["/"]]
    while waiting:
        group = waiting.pop()
        for key in group:
            name = f"{group.name.rstrip('/')}/{key}"
            objects += 1
            if objects > _MOST_OBJECTS:
                raise _distrusted(path, name, f"at most {_MOST_OBJECTS} groups and datasets", "more")
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                raise _distrusted(path, name, "content of the file itself", "a soft or external link")
            item = group[key]
            address = h5py.h5o.get_info(item.id).addr
            if address in visited:
                continue
            visited.add(address)
            if isinstance(item, h5py.Group):
                waiting.append(item)
            elif isinstance(item, h5py.Dataset):
                yield name, item


def _require_plain(name: str, item: h5py.Dataset, path: Path) -> None:
    """Check that a dataset holds numbers or bytes, in the file itself."""
    if item.external or item.is_virtual:
        raise _distrusted(path, name, "content of the file itself", "an external or virtual dataset")
    parts = [kind for kind, *_ in (item.dtype.fields or {}).values()]
    is_complex = len(parts) == 2 and all(part.kind == "f" and not part.subdtype for part in parts)
    if (item.dtype.kind not in "biufcS" and not is_complex) or item.shape is None:
        raise _distrusted(path, name, "an array of numbers or bytes", f"{item.dtype} of shape {item.shape}")


def _distrusted(path: Path, name: str, expected: str, got: str) -> InputError:
    return InputError.single(str(path), name, expected, got, "is the file from a source that you trust?")


#: Bytes of all arrays in a file of up to ``_SMALL_FILE_BYTES``, and bytes more for each byte of a larger file.
_BUDGET_BYTES = 768 << 20
_SMALL_FILE_BYTES = 10 * 10**6
_EXPANSION = 64
_BYTES_OF_A_FLOAT = 8
#: Memory for inflating a chunk over its size: a buffer doubles until it holds the chunk.
_BUFFERS_OF_A_CHUNK = 2
#: Chunks of one array, besides one for each KiB of the file; each costs a search of a microsecond.
_MOST_CHUNKS = 1 << 17
#: Groups and datasets of a file; metafab writes fewer than a hundred.
_MOST_OBJECTS = 4096
#: Texts of all heaps of a file; each costs half a microsecond.
_MOST_HEAP_OBJECTS = 1 << 20
#: Exceptions of h5py, NumPy and JSON on malformed content.
_UNREADABLE = (LookupError, OSError, ValueError, TypeError, AttributeError, RuntimeError, MemoryError)
#: First bytes of a global heap of version 1, the only one, in which HDF5 keeps texts of attributes.
_HEAP = b"GCOL\x01\x00\x00\x00"
_SEAL = b"\nmetafab crc32 "
#: Bytes of the checksum at the end of a file.
SEAL_BYTES = len(_SEAL) + 9


def _seal(checksum: int) -> bytes:
    """The checksum as it stands at the end of a file."""
    return _SEAL + f"{checksum:08x}\n".encode()


def _damaged(path: Path) -> bool:
    """Whether a file carries a checksum that is not its own."""
    content = path.stat().st_size - SEAL_BYTES
    if content < 0:
        return False
    with path.open("rb") as stream:
        stream.seek(content)
        found = stream.read()
        return found.startswith(_SEAL) and found != _seal(_checksum(stream, content))


def _checksum(stream: BinaryIO, left: int) -> int:
    """CRC-32 of the first ``left`` bytes of a file, after which the stream stands."""
    checksum = 0
    stream.seek(0)
    while left > 0 and (chunk := stream.read(min(left, 1 << 20))):
        checksum, left = zlib.crc32(chunk, checksum), left - len(chunk)
    return checksum
