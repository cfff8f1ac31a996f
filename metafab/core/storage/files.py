"""Atomic file writing, JSON, fingerprints of inputs, and a cache: a file that several steps read is read once."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import secrets
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Generic, TypeVar

import numpy as np

from metafab.core.errors import InputError, noted
from metafab.core.storage.tables import DAMAGED

Made = TypeVar("Made")

#: Accepted suffixes of HDF5 files.
HDF5_SUFFIXES = (".h5", ".hdf5")
Result = TypeVar("Result")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path that is renamed to ``path`` if the block succeeds.

    Any exception, Ctrl-C included, removes the temporary file and leaves an earlier ``path`` untouched.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(3)}.part")
    try:
        with noted(f"writing {path}"):
            yield beside
            beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


_PART = re.compile(r"\..+\.(\d+)-[0-9a-f]{6}\.part")


def require_file(path: Path, expected: str, remedy: str = "check the path") -> None:
    """Check that a file to read exists; InputError for a folder, and where nothing is."""
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no file at that path"
        raise InputError.single(str(path), "file", expected, got, remedy)


def clear_parts(folder: Path) -> None:
    """Remove temporary files of killed processes from ``folder``."""
    for path in folder.glob(".*.part"):
        match = _PART.fullmatch(path.name)
        if match is not None and not _alive(int(match[1])):
            path.unlink(missing_ok=True)


def _alive(pid: int) -> bool:
    """Whether a process with this number is running, under any user."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def untimed(details: Mapping[str, Any]) -> dict[str, Any]:
    """``details`` without the run time, so that equal results give equal files."""
    return {name: value for name, value in details.items() if name != "seconds"}


def plain(value: Any, *, full_paths: bool = True) -> Any:
    """Convert nested values to JSON types: dataclasses to dicts, arrays to lists, complex numbers to [re, im] pairs.

    A field made by :func:`metafab.core.storage.tables.optional` is left out where it is None. Without ``full_paths``,
    paths, and texts that name a table of an index (.csv), lose their folder.
    """
    if type(value) is float:  # the most frequent type comes first
        return value if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0.0 else "-inf"
    convert = partial(plain, full_paths=full_paths)
    if is_dataclass(value) and not isinstance(value, type):
        items = [(item, getattr(value, item.name)) for item in fields(value)]
        return {k.name: convert(v) for k, v in items if not (v is None and "optional" in k.metadata)}
    if isinstance(value, Mapping):
        return {str(key): convert(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [convert(item) for item in value]
    if isinstance(value, np.ndarray):
        is_plain = value.dtype.kind in "biuf" and bool(np.isfinite(value).all())
        return value.tolist() if is_plain else convert(value.tolist())
    if isinstance(value, np.generic):
        return convert(value.item())
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, Path):
        return value.as_posix() if full_paths else value.name
    if isinstance(value, str) and not full_paths and value.lower().endswith(".csv"):
        return Path(value).name
    return value


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as indented JSON, whole or not at all."""
    with whole_file(path) as part:
        part.write_text(json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_json(path: Path, kind: str, format_version: int, make: Callable[[dict[str, Any]], Made]) -> Made | None:
    """Read a JSON file of a kind; return None if it is missing, unreadable, of another kind or of a newer format.

    :func:`write_json` wrote it with ``kind`` and ``format_version`` among its keys; ``make`` builds the result from the
    others. An error that it raises on a damaged table counts as unreadable.
    """
    try:
        table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if table["kind"] != kind or table["format_version"] > format_version:
            return None
        return make({key: value for key, value in table.items() if key not in {"kind", "format_version"}})
    except (OSError, *DAMAGED):
        return None


def unique_keys(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return the table of a JSON object (``object_pairs_hook`` of the reader); ValueError for a key that repeats."""
    table = dict(pairs)
    if len(table) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        raise ValueError(f"key {counts.most_common(1)[0][0]!r} more than once")
    return table


def fingerprint(*parts: Any) -> str:
    """Hexadecimal SHA-256 of the canonical JSON of ``parts``; the same on every machine.

    Of a path only the name counts, so that a design gives one fingerprint in every folder.
    """
    text = json.dumps(plain(parts, full_paths=False), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


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
