"""Loaders of unit-cell, scene, process and design files, with the files that they reference."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from metafab.core.errors import Fault, InputError
from metafab.spec.cell import UnitCell
from metafab.spec.design import Design
from metafab.spec.keys.faults import faults_of
from metafab.spec.mask import Process
from metafab.spec.scene import Scene
from metafab.spec.toml import adapter, read_toml, unit_cell_of_library, validate


def load_unit_cell(path: Path | str) -> UnitCell:
    """Read a unit-cell file; InputError if it cannot be read, or with all of its faults."""
    return validate(UnitCell, _table(Path(path), "a unit-cell file"), str(path))


def load_unit_cell_of(library: Path) -> UnitCell:
    """Read the unit cell of a design's ``library``: a unit-cell file, or a built library that contains one.

    Errors as :func:`load_unit_cell`.
    """
    if library.suffix == ".h5":
        return unit_cell_of_library(library)
    return load_unit_cell(library)


def load_scene(path: Path | str) -> Scene:
    """Read a scene file: the keys of a design's ``[scene]`` table, at top level or under ``[scene]``.

    Errors as :func:`load_unit_cell`.
    """
    table = _table(Path(path), "a scene file")
    return validate(Scene, table.get("scene", table), str(path))


def load_process(path: Path | str) -> Process:
    """Read a process file: the tables of a design's ``[process]``, at top level or under ``[process]``.

    Errors as :func:`load_unit_cell`.
    """
    table = read_toml(Path(path))
    return validate(Process, table.get("process", table), str(path))


def load_design(path: Path | str) -> Design:
    """Read a design file with the unit cell, the scene and the process that it references.

    ``library`` is a unit-cell file or a built library, relative to the design; ``scene`` and ``process`` a table or a
    file each. InputError holds all faults of these files, each with its path.
    """
    path = Path(path)
    table = _table(path, "a design file")
    faults: list[Fault] = []
    table["unit_cell"] = _referenced_unit_cell(path, table, faults)
    if isinstance(table.get("scene"), str):
        table["scene"] = _collect(faults, "scene", lambda: load_scene(path.parent / table["scene"]))
    if isinstance(table.get("process"), str):
        table["process"] = _collect(faults, "process", lambda: load_process(path.parent / table["process"]))
    if isinstance(table.get("library"), str):
        table["library"] = os.path.realpath(path.parent / table["library"])
    skip = {key for key in ("unit_cell", "scene", "process") if table.get(key) is _FAULTY}
    skip |= {fault.field for fault in faults} & {"library"}
    try:
        design: Design | None = adapter(Design).validate_python({k: v for k, v in table.items() if k not in skip})
    except ValidationError as error:
        faults += [fault for fault in faults_of(error, Design) if fault.field not in skip]
        design = None
    if faults or design is None:
        raise InputError(str(path), faults)
    return design


def files_of(path: Path, known: frozenset[Path] = frozenset()) -> frozenset[Path]:
    """A TOML file and all files that its texts name, directly or not, as absolute paths that keep their symbolic links.

    ``known`` files are not read again. ValueError or OSError if a file is no TOML or cannot be read.
    """
    known |= {path.absolute()}
    for text in _texts(tomllib.loads(path.read_text(encoding="utf-8-sig"))):
        each = path.parent.absolute() / text
        if each in known or not _is_file(each):
            continue
        known = files_of(each, known) if each.suffix == ".toml" else known | {each}
    return known


def _is_file(path: Path) -> bool:
    """Whether a path is that of a file; a text too long for a path is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def _texts(value: Any) -> Iterator[str]:
    """All texts of a TOML table."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


_FAULTY = object()

#: Kinds of input file: tables that tell them apart, and the command that takes them.
_KINDS = {
    "a unit-cell file": ({"cell", "materials", "illumination", "sweep"}, "`metafab library build`, `metafab cell`"),
    "a scene file": ({"objects", "field_px", "photons_per_pixel"}, "`metafab capture`, `metafab film`"),
    "a design file": ({"device", "phase", "rules", "sensor", "verify"}, "`metafab run`, `metafab layout`"),
}


def _table(path: Path, expected: str) -> dict[str, Any]:
    """Table of an input file; InputError if the file cannot be read, or is of another kind."""
    table = read_toml(path)
    found = {kind: len(keys & table.keys()) for kind, (keys, _) in _KINDS.items()}
    likeliest = max(found, key=lambda kind: found[kind])
    # A design may be given where a scene is asked for.
    if found[expected] or found[likeliest] < 2 or (expected == "a scene file" and "scene" in table):
        return table
    named = ", ".join(f"[{key}]" for key in table if key in _KINDS[likeliest][0])
    remedy = f"it goes to {_KINDS[likeliest][1]}"
    if likeliest == "a unit-cell file":
        remedy += '; a design names it by `library = "..."` (`metafab new` writes one)'
    raise InputError.single(str(path), "file", expected, f"{likeliest} (with {named})", remedy)


def _referenced_unit_cell(path: Path, table: dict[str, Any], faults: list[Fault]) -> Any:
    """Unit cell of the key ``library``; faults are appended."""
    reference = table.get("library")
    if not isinstance(reference, str):
        if reference is not None:
            faults.append(Fault("library", "the path of a unit-cell file or a built library", repr(reference)))
        return _FAULTY
    return _collect(faults, "library", lambda: load_unit_cell_of(path.parent / reference))


def _collect(faults: list[Fault], field: str, load: Callable[[], Any]) -> Any:
    try:
        return load()
    except InputError as error:
        place = f"{field} -> {error.source}"
        faults += [replace(f, field=f"{place}: {f.field}" if f.field else place) for f in error.faults]
        return _FAULTY
