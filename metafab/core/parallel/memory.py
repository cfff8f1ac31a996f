"""Freed memory of this process (glibc): kept for the next arrays, or given back to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

#: Bytes by option of glibc's ``mallopt``: free memory beyond which it goes back to the system (M_TRIM_THRESHOLD, -1),
#: and blocks that are mapped separately (M_MMAP_THRESHOLD, -3).
_MALLOC_BYTES = {-1: 1 << 26, -3: 1 << 25}


@cache
def keep_freed_memory() -> None:
    """Let the memory of freed arrays stay with this process, for the next item; no effect with other C libraries.

    Dask starts its workers with ``MALLOC_TRIM_THRESHOLD_`` at 64 kB: every array goes back to the system, and page
    faults take a third of the time of a tile.
    """
    set_option = _of_glibc("mallopt")
    if set_option is not None:
        for option, threshold in _MALLOC_BYTES.items():
            set_option(option, threshold)


def give_back_freed_memory() -> None:
    """Give the memory of freed arrays back to the system; no effect with other C libraries.

    glibc keeps what arrays of up to 32 MB leave behind: 50 to 190 MB after a step of a run.
    """
    trim = _of_glibc("malloc_trim")
    if trim is not None:
        trim(0)


def _of_glibc(name: str) -> Callable[..., Any] | None:
    """A function of the C library; None where it has none of that name."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
