"""A cache of one entry: a file that several steps read is read once."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Generic, TypeVar

Result = TypeVar("Result")

#: Longest step of the clock that stamps files; a change within it may leave the time of the last change as it was.
_TICK_NS = 20_000_000
_fresh = count(1)


class Latest(Generic[Result]):
    """Thread-safe cache of the latest result. Callers share the result and must not change it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._held: tuple[Hashable, Result] | None = None

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Return the cached result for ``key``, or make, cache and return a new one."""
        with self._lock:
            if self._held is None or self._held[0] != key:
                self._held = None
                self._held = (key, make())
            return self._held[1]


def file_mark(path: Path) -> tuple[str, int, int, int]:
    """Absolute path, size in bytes and modification time in ns of a file, and a number, as a cache key.

    The number is 0, or a new one for a file so fresh that a further change could keep its time and size. OSError if
    there is no such file.
    """
    found = path.resolve().stat()
    is_settled = abs(time.time_ns() - found.st_mtime_ns) > _TICK_NS
    return str(path.resolve()), found.st_size, found.st_mtime_ns, 0 if is_settled else next(_fresh)
