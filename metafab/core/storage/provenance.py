"""Fingerprints of source code and of the files that a spec names.

Docstrings, comments and blank lines do not count: hours of solved rows survive a better sentence.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from metafab import __version__
from metafab.core.storage.files import file_sha256
from metafab.core.storage.source_graph import sources_of

_PACKAGE = Path(__file__).parents[2]
_LONG_STRING = r'"""(?:[^"\\]++|\\.|"(?!""))*+"""'
_STRING = rf"""{_LONG_STRING}|'''(?:[^'\\]++|\\.|'(?!''))*+'''|"(?:[^"\\\n]++|\\.)*+"|'(?:[^'\\\n]++|\\.)*+'"""
#: Strings, colons before docstrings, ends of lines before blank ones, and comments, in code as the formatter writes it;
#: the group that matches is kept. A library's modules take 0.03 s, a tenth of a parse by Python.
_WORDS = re.compile(
    rf"({_STRING})|(:)(?:  \#[^\n]*+)?\n(?:\s|\#[^\n]*+\n)*+[rR]?{_LONG_STRING}(?=\n)"
    r"|(\n)(?:[ \t]*+(?:\#[^\n]*+)?\n)*+|  \#[^\n]*+()",
    re.DOTALL,
)


@cache
def code_sha256(rooms: tuple[str, ...]) -> str:
    """Hash of the source of the packages ``rooms``, of ``core`` and of ``steps``; a change makes results stale."""
    digest = sha256(__version__.encode())
    for room in ("core", "steps", *rooms):
        digest.update(_room_sha256(room))
    return digest.hexdigest()


@cache
def sources_sha256(modules: tuple[str, ...], rooms: tuple[str, ...]) -> str:
    """Hash of the source of ``modules``, of every module of metafab that they import, and of the packages ``rooms``.

    The version of metafab does not count: all code that makes the result does.
    """
    digest = sha256(_files_sha256(sources_of(modules)))
    for room in rooms:
        digest.update(_room_sha256(room))
    return digest.hexdigest()


@cache
def _room_sha256(room: str) -> bytes:
    sources = (_PACKAGE / room).rglob("*.*")
    return _files_sha256(sorted(path for path in sources if path.suffix in {".py", ".csv", ".html", ".css", ".js"}))


def _files_sha256(paths: Iterable[Path]) -> bytes:
    digest = sha256()
    for path in paths:
        digest.update(path.relative_to(_PACKAGE).as_posix().encode())
        digest.update(code_of(path.read_text(encoding="utf-8")).encode() if path.suffix == ".py" else path.read_bytes())
    return digest.digest()


def code_of(source: str) -> str:
    """Python source without docstrings, comments and blank lines."""
    # A docstring follows a colon; that of the module gets one.
    return _WORDS.sub(lambda word: str(word[word.lastindex or 0]), ":\n" + source)


def contents_sha256(spec: Any) -> list[str]:
    """Hashes of the files that a spec names (phase arrays, pictures, index tables), in the order of its fields.

    Only the content counts; a missing file gives "missing".
    """
    return [file_sha256(path) if path.is_file() else "missing" for path in named_files(spec)]


def named_files(value: Any) -> Iterator[Path]:
    """Files that a spec, or a part of one, names by a path or as a table of an index (.csv)."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, str) and value.lower().endswith(".csv"):
        yield Path(value)
    elif is_dataclass(value) and not isinstance(value, type):
        for item in fields(value):
            yield from named_files(getattr(value, item.name))
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from named_files(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from named_files(item)
