"""Dataclasses as JSON tables: optional fields, and the way back from a table to the dataclass."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, fields, is_dataclass
from hashlib import sha256
from numbers import Integral
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

Figures = TypeVar("Figures")

#: Exceptions of reading a damaged table: no JSON or nested too deeply, missing keys, other types.
DAMAGED = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)


def table_sha256(table: Any) -> str:
    """Hexadecimal SHA-256 of a table as JSON holds it, in whatever order its keys stand."""
    return sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def optional() -> Any:
    """Return a dataclass field with default None, which :func:`metafab.core.storage.files.plain` omits when None."""
    return field(default=None, metadata={"optional": True})


def applicable(figures: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are not None, by name."""
    return {name: value for name, value in vars(figures).items() if value is not None}


def typed(kind: type[Figures], table: Mapping[str, Any]) -> Figures:
    """Make a dataclass from a table written by :func:`metafab.core.storage.files.plain`; unknown keys are ignored.

    Its fields are numbers, text, arrays, dataclasses, and tuples or dicts of these; null stands for NaN, "inf" for
    infinity. ValueError, TypeError or ArithmeticError if a field is missing or does not fit its type.
    """
    if not isinstance(table, Mapping):
        raise TypeError(f"expected a table of {kind.__name__}, got {type(table).__name__}")
    hints = get_type_hints(kind)
    values: dict[str, Any] = {}
    for item in fields(kind):  # type: ignore[arg-type]
        if item.name not in table:
            continue
        value = table[item.name]
        # An optional field that is None has no entry: null stands for NaN.
        missing = value is None and "optional" in item.metadata
        values[item.name] = math.nan if missing else _value(hints[item.name], value)
    return kind(**values)


def _value(hint: Any, value: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        return _first_fit([kind for kind in arguments if kind is not NoneType], value)
    if origin is tuple:
        if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
            raise TypeError(f"expected a list, got {type(value).__name__}")
        items = list(value)
        kinds = arguments[:1] * len(items) if arguments[-1] is Ellipsis else arguments
        return tuple(_value(kind, item) for kind, item in zip(kinds, items, strict=True))
    if origin is dict:
        if not isinstance(value, Mapping):
            raise TypeError(f"expected a table, got {type(value).__name__}")
        return {key: _value(arguments[1], item) for key, item in value.items()}
    if getattr(origin, "__name__", "") == "ndarray":
        from numpy import array  # The command line sets the threads of linear algebra before NumPy is loaded.

        return array(value, dtype="float64")
    if is_dataclass(hint) and isinstance(hint, type):
        return value if isinstance(value, hint) else typed(hint, value)
    if hint is float:
        return math.nan if value is None else float(value)
    if hint is int and isinstance(value, float) and value.is_integer():
        return int(value)  # Older versions wrote some counts as 3.0.
    if (hint is int and not isinstance(value, Integral)) or (hint is str and not isinstance(value, str)):
        raise TypeError(f"expected {hint.__name__}, got {type(value).__name__}")
    if isinstance(value, str):
        value.encode()  # Half of a surrogate pair could not be written again.
    return value


def _first_fit(kinds: Sequence[Any], value: Any) -> Any:
    """The value as the first of several types that it fits."""
    for kind in kinds[:-1]:
        with suppress(*DAMAGED):
            return _value(kind, value)
    return _value(kinds[-1], value)
