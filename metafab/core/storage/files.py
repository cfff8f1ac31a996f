"""Files that are either whole or absent, and the fingerprints by which steps are skipped."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from metafab.core.errors import InputError

Made = TypeVar("Made")

#: What the names of our HDF5 files end with.
HDF5_SUFFIXES = (".h5", ".hdf5")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write beside, then rename: yields a temporary path that becomes ``path`` only if the block succeeds.

    Anything that interrupts the block, Ctrl-C included, removes the temporary file and leaves an earlier
    ``path`` untouched.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(3)}.part")
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


_PART = re.compile(r"\..+\.(\d+)-[0-9a-f]{6}\.part")


def require_hdf5_name(path: Path) -> None:
    """Refuse a name that no reader would take for an HDF5 file, before anything is computed.

    Raises:
        InputError: neither .h5 nor .hdf5.
    """
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise InputError.single(str(path), "output", "a name ending with .h5", repr(path.suffix))


def clear_parts(folder: Path) -> None:
    """Remove the temporary files that processes of this machine left in ``folder`` when they were killed."""
    for path in folder.glob(".*.part"):
        match = _PART.fullmatch(path.name)
        if match is not None and not _alive(int(match[1])):
            path.unlink(missing_ok=True)


def _alive(pid: int) -> bool:
    """Whether a process of this number runs; of another user's, too."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def untimed(details: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of a result as its file keeps them: without their time, so that equal results have equal bytes."""
    return {name: value for name, value in details.items() if name != "seconds"}


def plain(value: Any) -> Any:
    """``value`` as JSON types: dataclasses become dicts, arrays lists, complex numbers [re, im] pairs."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, float) and not np.isfinite(value):
        return None if np.isnan(value) else ("inf" if value > 0 else "-inf")
    if isinstance(value, Path):
        return value.as_posix()
    return value


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as indented JSON, whole or not at all."""
    with whole_file(path) as part:
        part.write_text(json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_json(path: Path, kind: str, format_version: int, make: Callable[[dict[str, Any]], Made]) -> Made | None:
    """What ``make`` makes of a file of a kind; None where there is none, or one that is not ours or of a newer format.

    Args:
        path: what :func:`write_json` wrote, with ``kind`` and ``format_version`` among its keys.
        kind: which kind of file.
        format_version: the newest that can be read.
        make: takes the other keys; what they lack or hold wrongly makes the file none of ours.
    """
    try:
        table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if table["kind"] != kind or table["format_version"] > format_version:
            return None
        return make({key: value for key, value in table.items() if key not in {"kind", "format_version"}})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def fingerprint(*parts: Any) -> str:
    """Hexadecimal SHA-256 of the canonical JSON of ``parts``: equal inputs, equal text, on every machine."""
    text = json.dumps(plain(parts), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
