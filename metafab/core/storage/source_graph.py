"""Import graph of this package, read from its source: the files on which a module's results depend.

A name that a package re-exports (``from metafab.spec import UnitCell``) leads to the module that defines it, not to
the whole package: a new key of the design file does not change a unit cell.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).parents[2]
#: An import statement as the formatter writes it; this pattern is ten times faster than parsing the files.
_STATEMENT = re.compile(
    rf"^[ \t]*(?:from[ \t]+({_PACKAGE.name}[\w.]*)[ \t]+import[ \t]+(?:\(([^)]*)\)|([^\n(]+))"
    rf"|import[ \t]+({_PACKAGE.name}[^\n]*))$",
    re.MULTILINE,
)


@dataclass(frozen=True)
class Import:
    """One imported name; ``name`` is empty for an imported module, ``known_as`` is the local name."""

    module: str
    name: str
    known_as: str


@cache
def sources_of(roots: tuple[str, ...]) -> tuple[Path, ...]:
    """Sorted files of ``roots`` and of all modules of this package that they import, directly or not.

    Imports inside functions and for type checking count. A program that is started by its path has to be named among
    the roots. The file of the package itself, with its version and the names of its rooms, is left out. ValueError if a
    root is no module of this package.
    """
    found: set[str] = set()
    ahead = [*roots]
    while ahead:
        module = ahead.pop()
        if module not in found and module != _PACKAGE.name:
            found.add(module)
            ahead += [defining_module(each) for each in imports_of(module)]
    return tuple(sorted(_file(module) for module in found))


@cache
def imports_of(module: str) -> tuple[Import, ...]:
    """Imports of a module from this package."""
    found = []
    for match in _STATEMENT.finditer(_file(module).read_text(encoding="utf-8")):
        source, many, few, whole = (re.sub(r"#.*", "", part or "") for part in match.groups())
        for part in (many + few + whole).split(","):
            name, _, other = (word.strip() for word in part.partition(" as "))
            if name:
                found.append(Import(source, name, other or name) if source else Import(name, "", other or name))
    return tuple(found)


def defining_module(each: Import) -> str:
    """Module that defines an imported name."""
    if not each.name:
        return each.module
    inner = f"{each.module}.{each.name}"
    if _path(inner) is not None:
        return inner
    if _file(each.module).name == "__init__.py":
        for passed_on in imports_of(each.module):
            if passed_on.known_as == each.name:
                return defining_module(passed_on)
    return each.module


def _file(module: str) -> Path:
    path = _path(module)
    if path is None:
        raise ValueError(f"`module`: expected one of {_PACKAGE.name}, got {module}")
    return path


def _path(module: str) -> Path | None:
    own, *parts = module.split(".")
    place = _PACKAGE.joinpath(*parts)
    choices = (place / "__init__.py", place.with_suffix(".py")) if parts else (place / "__init__.py",)
    return next((path for path in choices if own == _PACKAGE.name and path.is_file()), None)
