"""A cache of one entry: a file that several steps read is read once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from threading import Lock
from typing import Generic, TypeVar

Result = TypeVar("Result")


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


def file_mark(path: Path) -> tuple[str, int, int]:
    """Absolute path, size in bytes and modification time in ns of a file, as a cache key.

    OSError if there is no such file.
    """
    found = path.resolve().stat()
    return str(path.resolve()), found.st_size, found.st_mtime_ns
