"""Arrays in files instead of memory: scratch arrays that may be larger than memory, and release of pages once used."""

from __future__ import annotations

import mmap
import os
import tempfile
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from metafab.core.errors import noted

#: Largest scratch array that is held in memory, bytes. Pages of a file are given back after each pass; the sites of the
#: paper's lens, 65 MB, take no longer so.
IN_MEMORY_BYTES = 1 << 25


def scratch(shape: tuple[int, ...], dtype: DTypeLike, in_memory_bytes: int | None = None) -> NDArray[Any]:
    """Return zeros of a shape; more than ``in_memory_bytes`` are in an unnamed file of the temporary folder.

    ``in_memory_bytes`` are :data:`IN_MEMORY_BYTES` by default. The file vanishes with the array. Its space is reserved
    now: OSError with a note of the folder if the disk is too full.
    """
    byte_count = int(np.prod(shape, dtype=object)) * np.dtype(dtype).itemsize
    if byte_count <= (IN_MEMORY_BYTES if in_memory_bytes is None else in_memory_bytes):
        return np.zeros(shape, dtype)
    note = f"{1e-9 * byte_count:.2g} GB of scratch in {tempfile.gettempdir()}; `TMPDIR` names another folder"
    with noted(note), tempfile.TemporaryFile() as stream:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), 0, byte_count)
        else:
            stream.truncate(byte_count)
        return np.frombuffer(mmap.mmap(stream.fileno(), byte_count), dtype).reshape(shape)


def release(array: NDArray[Any]) -> None:
    """Give the memory of a mapped file back, wherever ``array`` is a view of one; the content stays in the file.

    Pages that are used again are mapped again. The array has any shape; one in memory is left alone.
    """
    base: Any = array
    while isinstance(base, np.ndarray | memoryview):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    if isinstance(base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)
