"""TOML -> spec, reporting all faults of a file; spec -> canonical TOML, also within a library file."""

from __future__ import annotations

import os
import re
import stat
import tomllib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import TypeAdapter, ValidationError

from metafab.core.errors import InputError
from metafab.core.storage.limits import beyond, limit
from metafab.spec.cell import UnitCell
from metafab.spec.keys.faults import faults_of

Spec = TypeVar("Spec")

LIBRARY_KIND = "metafab library"
LIBRARY_FORMAT = 1

#: Keys whose values are paths relative to their file.
_FILE_KEYS = {"file", "texture_file", "amplitude_file", "table_file", "image_file", "depth_file", "contrast_file"}

#: Largest accepted file (MB), unless the limit ``memory_mb`` is stated; an outline of 100 000 vertices is smaller.
_LARGEST_MB = 4.0

#: One part of a dotted key, bare or quoted.
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+"""
#: A key of more than 32 dotted parts, whose parsing takes time quadratic in their number; a design has 5. A key
#: begins behind no backslash: without that, each escaped quote of a text would be tried to the end of its line.
_LONG_KEY = re.compile(rf"(?<![\w\\-])(?:{_PART}\.[ \t]*+){{32}}")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file and make its paths absolute.

    A file that is missing, unreadable, no plain file, larger than any design, or no TOML raises InputError.
    """
    try:
        return parse_toml(_text(path), path.parent)
    except FileNotFoundError:
        got, remedy = "no file at that path", "check the path"
    except UnicodeDecodeError:
        got = "a file that is no text in UTF-8"
        remedy = "give the .toml; a mask (.oas, .gds) goes to `metafab psf` or `metafab drc`, with `--design`"
    except OSError as error:
        got, remedy = f"an unreadable file ({error})", "is it a text file in UTF-8?"
    except RecursionError:
        got, remedy = "tables or lists that are nested too deeply", "remove the inner ones"
    except ValueError as error:  # TOML's own error, or that of a number with thousands of digits
        got, remedy = f"invalid TOML: {error}", "correct the syntax at that place"
    raise InputError.single(str(path), "file", "a TOML file", got, remedy)


def parse_toml(text: str, folder: Path) -> dict[str, Any]:
    """Parse TOML and make its paths, relative to ``folder``, absolute; ValueError or RecursionError if it is none."""
    if _LONG_KEY.search(text):
        raise ValueError("a key of more than 32 dotted parts")
    table: dict[str, Any] = _resolved(tomllib.loads(text), folder)
    return table


def _text(path: Path) -> str:
    """Text of a regular file of limited size; pipes and devices, which may never end, are refused."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise InputError.single(str(path), "file", "a TOML file", "a folder, pipe or device", "check the path")
    most_mb = limit("memory_mb", _LARGEST_MB)
    if (size := path.stat().st_size) > 1e6 * most_mb:
        with path.open("rb") as file:
            if b"\0" in (start := file.read(4096)):
                raise UnicodeDecodeError("utf-8", start, 0, 1, "a binary file")
        expected = f"a TOML file of at most {most_mb:g} MB"
        raise beyond(str(path), "file", "memory_mb", expected, f"{size} bytes", by_design=False)
    return path.read_text(encoding="utf-8-sig")  # Editors on Windows write a byte-order mark.


def validate(spec: Callable[..., Spec], table: Any, source: str) -> Spec:
    """Convert ``table`` to a spec; InputError with all faults of the table."""
    try:
        checked: Spec = adapter(spec).validate_python(table)
    except ValidationError as error:
        raise InputError(source, faults_of(error, spec)) from error
    return checked


def unit_cell_of_library(path: Path) -> UnitCell:
    """The unit-cell spec stored in a built library (attribute ``unit_cell_toml``).

    A file that is missing, truncated, foreign or newer raises InputError.
    """
    from metafab.core.storage import hdf5  # Loaded late: designs alone do not need HDF5.

    remedy = "build it with `metafab library build UNITCELL.toml`"
    with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=remedy) as file:
        return embedded_unit_cell(str(file.attrs["unit_cell_toml"]), Path(path))


def embedded_unit_cell(text: str, path: Path) -> UnitCell:
    """The unit-cell spec of a library file ``path``; tables that it names are relative to the file's folder.

    ``text`` is the attribute ``unit_cell_toml``, as :func:`canonical_toml` wrote it for that folder. Errors as
    :func:`validate` and :func:`parse_toml`.
    """
    return validate(UnitCell, parse_toml(text, path.parent), str(path))


def canonical_toml(spec: Any, folder: Path | None = None) -> str:
    """A spec as TOML text with every default written out, in the order of its fields.

    Absolute paths become relative to ``folder``; None keeps them.
    """
    return tomli_w.dumps(_toml_table(spec, folder))


@cache
def adapter(spec: Any) -> TypeAdapter[Any]:
    """Validator of a spec, built once."""
    return TypeAdapter(spec)


def _resolved(value: Any, folder: Path, key: str = "") -> Any:
    """Copy of a table with absolute paths; a material may name a table of its index (.csv) in place of a record."""
    if isinstance(value, dict):
        return {name: _resolved(item, folder, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_resolved(item, folder, key) for item in value]
    if isinstance(value, str) and "\0" in value:
        raise ValueError(f"a character \\u0000 in the value of `{key}`")
    if isinstance(value, str) and (key in _FILE_KEYS or value.lower().endswith(".csv")):
        return os.path.realpath(folder / value)  # a link to itself stays; no reader opens it
    return value


def _toml_table(spec: Any, folder: Path | None) -> dict[str, Any]:
    table = {}
    for item in fields(spec):
        value = _toml_value(getattr(spec, item.name), folder)
        if value is not None:
            table[item.name] = value
    return table


def _toml_value(value: Any, folder: Path | None) -> Any:
    if is_dataclass(value):
        return _toml_table(value, folder)
    if isinstance(value, tuple):
        return [_toml_value(item, folder) for item in value]
    if isinstance(value, Path) or (isinstance(value, str) and value.lower().endswith(".csv")):
        path = Path(value)
        if folder is not None and path.is_absolute():
            path = Path(os.path.relpath(path, folder.resolve()))
        return path.as_posix() if isinstance(value, Path) or folder is not None else value
    return value
