"""Keys of the input files, read from the specs: their types, units, defaults, ranges and meanings; their spelling."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import re
import types
from collections.abc import Iterable
from dataclasses import MISSING, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic.fields import FieldInfo

#: A field of a class, without the comment beside it.
_FIELD = re.compile(r" {4}(\w+): ")
_PLAIN = {float: "number", int: "whole number", bool: "true or false", str: "text", Path: "path of a file"}

#: Units at the ends of names, the longest first.
_UNITS = {
    "_uc_per_cm2": "uC/cm2",
    "_e_per_s": "electrons/s",
    "_m_per_s": "m/s",
    "_nm": "nm",
    "_um": "um",
    "_mm": "mm",
    "_deg": "degrees",
    "_rad": "rad",
    "_px": "pixels",
    "_na": "nA",
    "_us": "us",
    "_ms": "ms",
    "_e": "electrons",
    "_m": "m",
    "_s": "s",
}


@dataclass(frozen=True)
class Key:
    """One key of an input file."""

    path: str  #: Tables and key, such as ``mask.chip.margin_um``; ``[]`` marks a list of tables.
    kind: str  #: Type of the value in words.
    unit: str  #: Unit of the value; empty for text and pure numbers.
    default: str  #: Value without the key, as TOML; ``required`` if there is none, empty if the key is simply omitted.
    allowed: str  #: Range or choices; empty if every value of the type will do.
    meaning: str  #: One or two sentences.


@cache
def keys_of(spec: type, path: str = "") -> tuple[Key, ...]:
    """Return all keys of a spec's class and of its tables, in the order of the fields, below the tables ``path``.

    A phase term begins with its ``term``, whose meaning is what the term is.
    """
    hints = get_type_hints(spec, include_extras=True)
    found: list[Key] = []
    for item in sorted(dataclasses.fields(spec), key=lambda item: item.name != "term"):
        key = f"{path}.{item.name}" if path else item.name
        tables = _tables(hints[item.name])
        if tables and get_origin(_bare(hints[item.name])) is tuple:
            key += "[]"
        unit = next((unit for ending, unit in _UNITS.items() if item.name.endswith(ending)), "")
        kind, allowed = _kind(hints[item.name]), _allowed(hints[item.name])
        default, meaning = _default(item), _meanings(spec).get(item.name, "")
        if item.name == "term":
            default, meaning = "required", (inspect.getdoc(spec) or "").splitlines()[0]
        found.append(Key(key, kind, unit, default, allowed, meaning.replace("``", "`")))
        for table in tables:
            inner = f"{key}.{_tag(table)}" if len(tables) > 1 else key
            found += keys_of(table, inner)
    return tuple(found)


def names_at(spec: Any, location: Iterable[int | str]) -> tuple[str, ...]:
    """Return the names of the keys of the table at a place of a file; empty if no table stands there.

    The location holds keys, positions in lists, and names of phase terms, from the top of the file of class ``spec``.
    """
    tables = _tables(spec)
    for part in location:
        if isinstance(part, int):
            continue
        named = [table for table in tables if _tag(table) == part]
        within = [get_type_hints(table, include_extras=True).get(part) for table in tables]
        tables = named or [inner for hint in within if hint is not None for inner in _tables(hint)]
    return tuple(dict.fromkeys(item.name for table in tables for item in dataclasses.fields(table)))


def near(name: str, known: Iterable[str], *, likeness: float = 0.6) -> str:
    """Return "did you mean `a` or `b`?" for the known names that resemble ``name``; empty if none does.

    Upper and lower case are alike; ``likeness`` is the least ratio of resemblance, 0 to 1.
    """
    words = {word.lower(): word for word in known}
    close = [words[word] for word in difflib.get_close_matches(name.lower(), words, n=3, cutoff=likeness)]
    return f"did you mean {' or '.join(f'`{word}`' for word in close)}?" if close else ""


@cache
def _meanings(spec: type) -> dict[str, str]:
    """The comments (``#:``) above and beside each field of a spec and of the specs that it extends, on one line."""
    meanings: dict[str, str] = {}
    for base in reversed(spec.__mro__[:-1]):
        texts: list[str] = []
        for line in inspect.getsource(base).splitlines():
            field, _, text = line.partition("#:")
            texts.append(text.strip())
            if name := _FIELD.match(field):
                meanings[name[1]] = " ".join(filter(None, texts))
                texts.clear()
    return meanings


def _default(item: dataclasses.Field[Any]) -> str:
    value = item.default
    if isinstance(value, FieldInfo):
        if value.default_factory is not None:
            return ""
        value = MISSING if value.is_required() else value.default
    if value is MISSING:
        return "required" if item.default_factory is MISSING else ""
    return _toml(value)


def _toml(value: Any) -> str:
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def _kind(hint: Any) -> str:
    hint = _bare(hint)
    if get_origin(hint) is Literal:
        return "text"
    if dataclasses.is_dataclass(hint):
        return "table"
    if get_origin(hint) is tuple:
        inner = get_args(hint)
        if inner[-1] is Ellipsis:
            kind = "table" if _tables(inner[0]) else _kind(inner[0])
            return f"list of {kind}" + ("" if kind.startswith("[") or kind == "text" else "s")
        return f"[{', '.join(map(_kind, inner))}]"
    if _is_union(hint):
        return " or ".join(dict.fromkeys(map(_kind, get_args(hint))))
    return _PLAIN.get(hint, "value")


def _allowed(hint: Any) -> str:
    limits = [str(limit) for limit in _limits(hint)]
    bare = _bare(hint)
    if get_origin(bare) is Literal:
        return ", ".join(f'"{choice}"' for choice in get_args(bare))
    if get_origin(bare) is tuple and not _tables(bare):
        inner = list(dict.fromkeys(_allowed(part) for part in get_args(bare) if part is not Ellipsis))
        limits += inner if len(inner) == 1 and inner[0] else []
    return ", ".join(limits)


def _limits(hint: Any) -> list[str]:
    """Range of a number or of a list's length in words; limits against overflow are left out."""
    words = {"gt": "above {:g}", "ge": "at least {:g}", "lt": "below {:g}", "le": "at most {:g}"}
    lengths = {"min_length": "at least {} of them", "max_length": "at most {} of them"}
    found: list[str] = []
    for info in _infos(hint):
        for rule in info.metadata:
            for name, text in words.items():
                value = getattr(rule, name, None)
                if value is not None and abs(value) < 1e15:
                    found.append(text.format(value))
            for name, text in lengths.items():
                value = getattr(rule, name, None)
                if value is not None and get_origin(_bare(hint)) is tuple:
                    found.append(text.format(value))
    return found


def _infos(hint: Any) -> list[FieldInfo]:
    if get_origin(hint) is Annotated:
        inner, *extras = get_args(hint)
        return [*_infos(inner), *(extra for extra in extras if isinstance(extra, FieldInfo))]
    if _is_union(hint):
        return [info for part in get_args(hint) for info in _infos(part)]
    return []


def _bare(hint: Any) -> Any:
    """The type without annotations and without None."""
    while get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if _is_union(hint):
        parts = [part for part in get_args(hint) if part is not type(None)]
        return _bare(parts[0]) if len(parts) == 1 else Union[tuple(parts)]  # noqa: UP007
    return hint


def _is_union(hint: Any) -> bool:
    return get_origin(hint) in {Union, types.UnionType}


def _tables(hint: Any) -> list[type]:
    """The specs within a type: one for a table, several for a choice of tables."""
    hint = _bare(hint)
    if dataclasses.is_dataclass(hint):
        return [hint] if isinstance(hint, type) else []
    if _is_union(hint) or get_origin(hint) in {tuple, list}:
        return [table for part in get_args(hint) if part is not Ellipsis for table in _tables(part)]
    return []


def _tag(table: type) -> str:
    """Name of a phase term; of other tables, that of their class."""
    return str(getattr(table, "term", table.__name__))
