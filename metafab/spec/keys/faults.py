"""Faults of an input file in our words, from the errors of the validation library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from metafab.core.errors import Fault
from metafab.spec.keys.reference import names_at, near

#: Largest number of faults that are reported one by one; each costs up to a millisecond, and kilobytes with its input.
_MOST_FAULTS = 500
_UNKNOWN = {"extra_forbidden", "unexpected_keyword_argument"}
#: Parts of names that users give the phase of turned pillars; no term makes it.
_GEOMETRIC = ("geometric", "berry", "pb", "rotat")
_MISSING = {"missing", "missing_argument"}
_TYPES = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text in quotes",
    "tuple_type": "a list, in square brackets",
    "list_type": "a list, in square brackets",
    "dataclass_type": "a table",
    "path_type": "the path of a file, as text in quotes",
}
_LENGTHS: dict[str, Callable[[dict[str, Any]], str]] = {
    "too_short": lambda limits: f"a list of at least {limits['min_length']}",
    "too_long": lambda limits: f"a list of at most {limits['max_length']}",
    "string_too_short": lambda limits: f"a text of at least {limits['min_length']} characters",
    "string_too_long": lambda limits: f"a text of at most {limits['max_length']} characters",
    "string_pattern_mismatch": lambda _: "letters, digits, `_`, `-` and `.`, a letter or digit first",
}


def faults_of(error: ValidationError, spec: Any) -> list[Fault]:
    """Return one fault for each error that the validation library found; the keys of ``spec`` are suggested."""
    if (count := error.error_count()) > _MOST_FAULTS:
        return [Fault("", f"{count} faults, too many to list one by one; is it another program's file?", "")]
    items = error.errors(include_url=False)
    # Each missing item of a list is an error; the last one says how many there must be.
    last = {item["loc"][:-1]: item["loc"] for item in items if _is_missing_item(item)}
    # A list whose items have faults of their own is also called too short.
    return [
        _fault(item, spec)
        for item in items
        if (item["type"] != "too_short" or len(item["input"]) < int(item["ctx"]["min_length"]))
        and (not _is_missing_item(item) or last[item["loc"][:-1]] == item["loc"])
    ]


def _is_missing_item(item: Any) -> bool:
    return item["type"] in _MISSING and isinstance(item["loc"][-1], int)


def option_fault(error: ValidationError, otherwise: str) -> str:
    """Return what is wrong with a number on the command line; ``otherwise`` for errors of other kinds."""
    item = error.errors(include_url=False)[0]
    if item["type"] not in _TYPES and not item["type"].startswith(("greater", "less")):
        return otherwise.removeprefix("Value error, ")
    return f"expected {_expected(item['type'], item['msg'], item.get('ctx', {}))}, got {item['input']}"


def _fault(item: Any, spec: Any) -> Fault:
    place, kind, limits = item["loc"], item["type"], item.get("ctx", {})
    field = _path(place)
    if kind in _UNKNOWN:
        names = names_at(spec, place[:-1])
        hint = near(str(place[-1]), names) or f"known keys: {', '.join(names)}"
        return Fault(field, "a known key", "an unknown one", hint)
    if kind in _MISSING:
        if _is_missing_item(item):
            return Fault(_path(place[:-1]), f"a list of at least {place[-1] + 1}", f"a list of {len(item['input'])}")
        return Fault(field, "a value", "nothing", "add the key")
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        choices = limits.get("expected_tags", "the name of a phase term")
        return _unknown_choice(f"{field}.term".lstrip("."), choices, limits.get("tag", ""))
    if kind == "literal_error":
        return _unknown_choice(field, limits["expected"], item["input"])
    if kind == "value_error" and not isinstance(item["input"], str | int | float | list | tuple):
        return Fault(field, item["msg"].removeprefix("Value error, "), "")
    if kind == "tuple_type" and isinstance(item["input"], dict):
        return Fault(field, f"a list of tables, each headed [[{field}]]", "one table")
    return Fault(field or "file", _expected(kind, item["msg"], limits), _got(item["input"]))


def _unknown_choice(field: str, choices: str, got: Any) -> Fault:
    known = [word.strip(" '") for word in choices.replace(" or ", ",").split(",")]
    remedy = near(got, known) if isinstance(got, str) else ""
    if field.endswith(".term") and any(word in str(got).lower() for word in _GEOMETRIC):
        remedy = "pillars stand upright and give x and y polarisation their phases; `metafab stokes` turns pillars"
    if field.endswith(".shape") and "hex" in str(got).lower():
        remedy = '`cell.lattice = "hexagonal"` sets pillars, round ones for instance, on a hexagonal lattice'
    return Fault(field, choices, _got(got) if got != "" else "nothing", remedy)


def _expected(kind: str, message: str, limits: dict[str, Any]) -> str:
    if kind in _LENGTHS:
        return _LENGTHS[kind](limits)
    expected = message.removeprefix("Input should be ").removeprefix("Value error, must be ")
    return _TYPES.get(kind) or (f"a number {expected}" if kind.startswith(("greater", "less")) else expected)


def _got(value: Any) -> str:
    text = "a table" if isinstance(value, dict) else str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _path(location: tuple[int | str, ...]) -> str:
    """('phase', 0, 'spiral_zones', 'zones') -> 'phase[0].spiral_zones.zones'."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text
