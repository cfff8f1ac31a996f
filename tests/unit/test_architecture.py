"""The architecture as a test: data flows down the list of rooms, and a few packages have one door each."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "metafab"

#: The rooms in the order in which data flows; a room may import only rooms before it.
ORDER = [
    "core", "spec", "materials", "information", "cell", "library", "phase", "layout", "mask", "drc",
    "optics", "fullwave", "camera", "decode", "comparison", "tolerance", "steps", "benchmark", "report",
    "run", "rehearsal", "doctor", "cli",
]  # fmt: skip

#: module -> the only files that may import it
DOORS = {
    "matplotlib": "report/",
    "klayout": "drc/",
    "meep": "cell/meep_worker.py",
    "typer": "cli/",
    "rich": "cli/",
}

#: Upward imports that are allowed, each with its reason; the issue of the house empties this set.
EXCEPTIONS: set[tuple[str, str]] = set()


def _files() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            if node.module == "metafab":
                yield from (f"metafab.{alias.name}" for alias in node.names)
            else:
                yield node.module


def _room(path: Path) -> str:
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


@pytest.mark.parametrize("path", _files(), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_imports_point_down_the_list(path: Path) -> None:
    room = _room(path)
    if room == "__init__":
        return
    for module in _imports(path):
        parts = module.split(".")
        if parts[0] != "metafab" or len(parts) < 2 or parts[1] not in ORDER:
            continue
        if (path.relative_to(PACKAGE).as_posix(), parts[1]) in EXCEPTIONS:
            continue
        assert ORDER.index(parts[1]) <= ORDER.index(room), f"{room} imports {module}, which comes after it"


@pytest.mark.parametrize("path", _files(), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_some_packages_have_one_door(path: Path) -> None:
    name = path.relative_to(PACKAGE).as_posix()
    for module in _imports(path):
        door = DOORS.get(module.split(".")[0])
        assert door is None or name.startswith(door), f"{name} imports {module}; only {door} may"


def test_one_file_opens_klayout() -> None:
    users = [p for p in _files() if any(m.split(".")[0] == "klayout" for m in _imports(p))]
    assert len(users) == 1


@pytest.mark.parametrize("path", _files(), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_modules_stay_readable(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 600


def test_every_public_function_is_documented_and_typed() -> None:
    missing = []
    for path in _files():
        for node in _public(ast.parse(path.read_text(encoding="utf-8"))):
            if not ast.get_docstring(node):
                missing.append(f"{path.relative_to(PACKAGE)}: {node.name} has no docstring")
            if isinstance(node, ast.FunctionDef) and node.returns is None:
                missing.append(f"{path.relative_to(PACKAGE)}: {node.name} has no return type")
    assert missing == []


def _public(parent: ast.Module | ast.ClassDef) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    """Public functions, classes and methods; functions inside functions are nobody's interface."""
    for node in parent.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from _public(node)
