"""Arguments of a wrong type, refused in words: a result in place of its part, two exchanged, one for several."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from metafab.core.errors import Fault, InputError


def require_types(function: str, **arguments: tuple[Any, type]) -> None:
    """Refuse arguments of a function that a user calls from Python and that are not of their types.

    Args:
        function: name of the function, for the error.
        arguments: value and type by the argument's name.

    Raises:
        InputError: one fault for each wrong argument; if a field of the value has the type, the remedy names it.
    """
    faults = [
        Fault(name, kind.__name__, type(value).__name__, _remedy(value, kind))
        for name, (value, kind) in arguments.items()
        if not isinstance(value, kind)
    ]
    if faults:
        raise InputError(function, faults)


def is_several(value: Any) -> bool:
    """Whether a value holds several: any iterable but a text, a mapping and an array without axes."""
    return isinstance(value, Iterable) and not isinstance(value, str | Mapping) and getattr(value, "ndim", 1) > 0


def _remedy(value: Any, kind: type) -> str:
    """Advice on how to get an argument of a type from the value that was given."""
    names = [item.name for item in fields(value)] if is_dataclass(value) else []
    if name := next((name for name in names if isinstance(getattr(value, name, None), kind)), None):
        return f"give its `{name}`"
    return (
        f"`{kind.__name__}.of` makes one of a design"
        if type(value).__name__ == "Design" and hasattr(kind, "of")
        else ""
    )
