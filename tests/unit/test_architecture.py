"""The architecture as a test: data flows down the list of rooms, no two files import each other, a few packages have
one door each, and rooms stay small enough to be read."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from metafab.core.storage.source_graph import defining_module, imports_of

PACKAGE = Path(__file__).parents[2] / "metafab"

#: The rooms in the order in which data flows; a room may import only rooms before it.
ORDER = [
    *("core", "spec", "materials", "information", "cell", "library", "phase", "layout", "mask", "drc", "exposure"),
    *("optics", "fullwave", "camera", "decode", "comparison", "tolerance", "steps", "benchmark", "report"),
    *("run", "rehearsal", "doctor", "cli", "__main__"),
]

#: module -> the only files that may import it
DOORS = {
    "matplotlib": "report/",
    "klayout": "drc/",
    "meep": "cell/meep_worker.py",
    "typer": "cli/",
    "rich": "cli/",
    "xarray": "core/display.py",
}

#: Most files of a folder ("about a dozen", with its ``__init__``), lines of a file, and names that a face lists.
MOST_FILES, MOST_LINES, MOST_NAMES = 13, 600, 13

FILES = sorted(PACKAGE.rglob("*.py"))


@cache
def _imports(path: Path) -> frozenset[str]:
    """Modules that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [f"metafab.{alias.name}" for alias in node.names]
            found |= {*names} if node.module == "metafab" else {node.module}
    return frozenset(found)


def _name(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def _room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def _module(path: Path) -> str:
    return ".".join([PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts]).removesuffix(".__init__")


def _typing_only(path: Path) -> set[str]:
    """Modules that a file imports for type checking alone."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for inner in ast.walk(node):
                if isinstance(inner, ast.ImportFrom) and inner.module:
                    found.add(inner.module)
                elif isinstance(inner, ast.Import):
                    found |= {alias.name for alias in inner.names}
    return found


def test_imports_point_down_the_list() -> None:
    upwards = []
    for path in FILES:
        before = [*ORDER, "__init__"].index(_room(path)) + 1
        rooms = {module: module.split(".")[1] for module in _imports(path) if module.startswith("metafab.")}
        upwards += [f"{_name(path)} imports {module}" for module, room in rooms.items() if room in ORDER[before:]]
    assert upwards == []


def test_every_room_has_its_place() -> None:
    assert {_room(path) for path in FILES} - {"__init__"} == set(ORDER)


def test_no_two_files_import_each_other() -> None:
    """Directly or through others; names that a package re-exports lead to the file that defines them."""
    modules = {_module(path) for path in FILES}
    graph = {
        module: {name for each in imports_of(module) if (name := defining_module(each)) in modules - {module}}
        for module in modules
    }
    # What imports nothing of what is left cannot be on a circle, and neither can what only imports such files.
    while free := {module for module, needed in graph.items() if not needed & graph.keys()}:
        graph = {module: needed for module, needed in graph.items() if module not in free}
    assert sorted(graph) == []


def test_some_packages_have_one_door() -> None:
    others = []
    for path in FILES:
        doors = {module: DOORS.get(module.split(".")[0], "") for module in _imports(path)}
        beside = {module for module, door in doors.items() if not _name(path).startswith(door)}
        others += [f"{_name(path)} imports {module}" for module in (beside and beside - _typing_only(path))]
    assert others == []


def test_one_file_opens_klayout() -> None:
    users = [p for p in FILES if any(m.split(".")[0] == "klayout" for m in _imports(p))]
    assert len(users) == 1


def test_nobody_imports_the_slowest_package_of_scipy() -> None:
    """Every run would import it for 0.27 s; distributions are in `scipy.special`, too."""
    assert not [p for p in FILES if any(m.startswith("scipy.stats") for m in _imports(p))]


def test_files_stay_readable() -> None:
    lines = {_name(path): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}


def test_folders_hold_about_a_dozen_files() -> None:
    folders = {path.parent for path in FILES}
    counts = {folder.relative_to(PACKAGE).as_posix(): len(list(folder.glob("*.py"))) for folder in folders}
    assert {folder: count for folder, count in counts.items() if count > MOST_FILES} == {}


@pytest.mark.parametrize("face", sorted(PACKAGE.glob("*/__init__.py")), ids=lambda p: p.parent.name)
def test_faces_list_about_ten_names(face: Path) -> None:
    lists = [node for node in ast.parse(face.read_text(encoding="utf-8")).body if isinstance(node, ast.Assign)]
    named = {ast.unparse(node.targets[0]): node.value for node in lists}
    assert len(getattr(named.get("__all__"), "elts", [])) <= MOST_NAMES


def test_nobody_uses_a_private_name_of_another_file() -> None:
    """In the product, the tests and the benchmarks; neither by import nor through the module."""
    root = PACKAGE.parent
    private = []
    for folder in ("metafab", "tests", "benchmarks"):
        for path in sorted((root / folder).rglob("*.py")):
            nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
            ours = [node for node in nodes if isinstance(node, ast.ImportFrom) and _is_ours(node.module)]
            aliases = [alias for node in ours for alias in node.names]
            names = [alias.name for alias in aliases]
            modules = {alias.asname or alias.name for alias in aliases if alias.name.islower()}
            names += [
                node.attr
                for node in nodes
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules
            ]
            private += [f"{path.relative_to(root)}: {name}" for name in names if re.match("_(?!_)", name)]
    assert private == []


def _is_ours(module: str | None) -> bool:
    return (module or "").split(".")[0] == PACKAGE.name


def test_kernels_that_are_compiled_ahead_exist() -> None:
    missing = []
    for module, kernels in tomllib.loads((PACKAGE / "core/numeric/kernels.toml").read_text(encoding="utf-8")).items():
        parsed = ast.parse(PACKAGE.parent.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8"))
        defined = {node.name for node in parsed.body if isinstance(node, ast.FunctionDef)}
        missing += [f"{module}.{name}" for name in kernels if name not in defined]
    assert missing == []


def test_every_public_function_is_documented_and_typed() -> None:
    missing = []
    for path in FILES:
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
