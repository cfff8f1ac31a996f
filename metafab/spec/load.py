"""TOML -> spec with every fault reported at once, and spec -> canonical TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import TypeAdapter, ValidationError

from metafab.core.errors import Fault, InputError
from metafab.spec.cell import UnitCell
from metafab.spec.design import Design
from metafab.spec.scene import Scene

Spec = TypeVar("Spec")


def load_unit_cell(path: Path) -> UnitCell:
    """Read a unit-cell file.

    Raises:
        InputError: the file cannot be read, or holds faults (all of them are reported).
    """
    return validate(UnitCell, _read_toml(path), str(path))


def load_scene(path: Path) -> Scene:
    """Read a scene file (the keys of a design's ``[scene]`` table at top level, or under ``[scene]``)."""
    table = _read_toml(path)
    return validate(Scene, table.get("scene", table), str(path))


def load_design(path: Path) -> Design:
    """Read a design file, with the unit cell and the scene that it names.

    ``library`` is a unit-cell file or a built library, relative to the design; ``scene`` a table or a file.

    Raises:
        InputError: all faults of the design, its unit cell and its scene, each with its path.
    """
    table = _read_toml(path)
    faults: list[Fault] = []
    table["unit_cell"] = _referenced_unit_cell(path, table, faults)
    if isinstance(table.get("scene"), str):
        table["scene"] = _collect(faults, "scene", lambda: load_scene(path.parent / table["scene"]))
    if isinstance(table.get("library"), str):
        table["library"] = str((path.parent / table["library"]).resolve())
    skip = {key for key in ("unit_cell", "scene") if table.get(key) is _FAULTY}
    try:
        design: Design | None = _adapter(Design).validate_python({k: v for k, v in table.items() if k not in skip})
    except ValidationError as error:
        faults += [fault for fault in _faults(error) if fault.field not in skip]
        design = None
    if faults or design is None:
        raise InputError(str(path), faults)
    return design


def canonical_toml(spec: Any) -> str:
    """A spec as TOML with every default written out, in the order of its fields: what a run folder keeps."""
    return tomli_w.dumps(_toml_table(spec))


_FAULTY = object()


def _referenced_unit_cell(path: Path, table: dict[str, Any], faults: list[Fault]) -> Any:
    """The unit cell behind ``library``: a TOML file, or a built library that carries its own."""
    reference = table.get("library")
    if not isinstance(reference, str):
        if reference is not None:
            faults.append(Fault("library", "the path of a unit-cell file or a built library", repr(reference)))
        return _FAULTY
    target = path.parent / reference
    if target.suffix == ".h5":
        from metafab.spec.embedded import unit_cell_of_library

        return _collect(faults, "library", lambda: unit_cell_of_library(target))
    return _collect(faults, "library", lambda: load_unit_cell(target))


def _collect(faults: list[Fault], field: str, load: Callable[[], Any]) -> Any:
    try:
        return load()
    except InputError as error:
        faults += [Fault(f"{field} -> {error.source}: {f.field}", f.expected, f.got, f.remedy) for f in error.faults]
        return _FAULTY


@cache
def _adapter(spec: Any) -> TypeAdapter[Any]:
    return TypeAdapter(spec)


#: Keys whose values are paths, relative to the file that they stand in.
_FILE_KEYS = {"file", "texture_file"}


def _resolved(value: Any, folder: Path, key: str = "") -> Any:
    """The table with every path that it names made absolute; tables of an index (.csv) may stand for a record."""
    if isinstance(value, dict):
        return {name: _resolved(item, folder, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_resolved(item, folder, key) for item in value]
    if isinstance(value, str) and (key in _FILE_KEYS or value.lower().endswith(".csv")):
        return str((folder / value).resolve())
    return value


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        table: dict[str, Any] = _resolved(tomllib.loads(path.read_text(encoding="utf-8")), path.parent)
        return table
    except FileNotFoundError:
        got, remedy = "no file at that path", "check the path"
    except (OSError, UnicodeDecodeError) as error:
        got, remedy = f"an unreadable file ({error})", "is it a text file in UTF-8?"
    except tomllib.TOMLDecodeError as error:
        got, remedy = f"invalid TOML: {error}", "correct the syntax at that place"
    raise InputError.single(str(path), "file", "a TOML file", got, remedy)


def validate(spec: Callable[..., Spec], table: Any, source: str) -> Spec:
    """``table`` as a spec, or an :class:`InputError` with all of its faults."""
    try:
        checked: Spec = _adapter(spec).validate_python(table)
    except ValidationError as error:
        raise InputError(source, _faults(error)) from error
    return checked


def _faults(error: ValidationError) -> list[Fault]:
    """Pydantic's findings in our words."""
    faults = []
    for item in error.errors(include_url=False):
        field = _path(item["loc"])
        kind, message = item["type"], item["msg"]
        if kind in {"extra_forbidden", "unexpected_keyword_argument"}:
            faults.append(Fault(field, "a known key", "an unknown one", "remove it or correct its spelling"))
        elif kind in {"missing", "missing_argument"}:
            faults.append(Fault(field, "a value", "nothing", "add the key"))
        else:
            expected = message.removeprefix("Input should be ").removeprefix("Value error, ")
            got = repr(item["input"])
            faults.append(Fault(field or "file", expected, got if len(got) <= 80 else got[:77] + "..."))
    return faults


def _path(location: tuple[int | str, ...]) -> str:
    """('phase', 0, 'spiral_zones', 'zones') -> 'phase[0].spiral_zones.zones'."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def _toml_table(spec: Any) -> dict[str, Any]:
    table = {}
    for item in fields(spec):
        value = _toml_value(getattr(spec, item.name))
        if value is not None:
            table[item.name] = value
    return table


def _toml_value(value: Any) -> Any:
    if is_dataclass(value):
        return _toml_table(value)
    if isinstance(value, tuple):
        return [_toml_value(item) for item in value]
    if isinstance(value, Path):
        return value.as_posix()
    return value
