"""The latest result of a kind, for whoever asks for the same again: files that several steps read are read once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from threading import Lock
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Latest(Generic[Result]):
    """Holds one result, so that memory is bounded by the largest of its kind. Results are shared: never change them."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._held: tuple[Hashable, Result] | None = None

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The held result if it was made for an equal ``key``, else a new one, which takes its place."""
        with self._lock:
            if self._held is None or self._held[0] != key:
                self._held = None
                self._held = (key, make())
            return self._held[1]


def file_mark(path: Path) -> tuple[str, int, int]:
    """A file's place, size in bytes and time of its last change in ns: another mark, another content.

    Raises:
        OSError: there is no such file.
    """
    found = path.resolve().stat()
    return str(path.resolve()), found.st_size, found.st_mtime_ns
