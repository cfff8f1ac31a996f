"""The import graph that fingerprints stand on: nothing a result depends on is left out, nothing else comes in."""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from pathlib import Path
from types import ModuleType

import pytest

from metafab.core.storage import provenance, source_graph
from metafab.core.storage.source_graph import Import, defining_module, imports_of, sources_of
from metafab.library.library import BUILT_BY, TABLES

PACKAGE = Path(source_graph.__file__).parents[2]


def name_of(path: Path) -> str:
    """metafab/core/files.py -> metafab.core.storage.files."""
    return ".".join([PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts]).removesuffix(".__init__")


def parsed(path: Path) -> set[Import]:
    """The imports of a file by Python's own parser."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == PACKAGE.name:
            found |= {Import(node.module, alias.name, alias.asname or alias.name) for alias in node.names}
        elif isinstance(node, ast.Import):
            names = [alias for alias in node.names if alias.name.split(".")[0] == PACKAGE.name]
            found |= {Import(alias.name, "", alias.asname or alias.name) for alias in names}
    return found


@pytest.fixture(scope="module")
def of_a_library() -> set[str]:
    return {path.relative_to(PACKAGE).as_posix() for path in sources_of(BUILT_BY)}


def test_every_import_of_every_file_is_seen() -> None:
    for path in PACKAGE.rglob("*.py"):
        assert parsed(path) <= set(imports_of(name_of(path))), path


def test_names_lead_to_the_module_that_defines_them() -> None:
    """As Python itself finds them: classes and functions know their module."""
    from metafab import cell, spec

    for package in (cell, spec):
        for name in package.__all__:
            where = getattr(getattr(package, name), "__module__", None)
            if where is not None and where.startswith(PACKAGE.name):
                assert defining_module(Import(package.__name__, name, name)) == where, name
    assert defining_module(Import("metafab.cell", "rcwa", "rcwa")) == "metafab.cell.rcwa"
    assert defining_module(Import("metafab.core.storage", "hdf5", "files")) == "metafab.core.storage.hdf5"


def test_a_library_hangs_on_solver_materials_and_its_own_spec(of_a_library: set[str]) -> None:
    needed = {
        "cell/rcwa/scattering/modes.py",
        "cell/meep_worker.py",
        "core/storage/hdf5.py",
        "library/fit/rational.py",
        "library/fit/certificate.py",
        "materials/record.py",
        "spec/cell.py",
    }
    assert needed <= of_a_library
    assert "materials" in TABLES


def test_a_library_does_not_hang_on_what_comes_after_it(of_a_library: set[str]) -> None:
    rooms = {name.split("/")[0] for name in of_a_library} - {"__init__.py"}
    assert rooms == {"core", "spec", "materials", "cell", "library"}
    others = {
        "spec/design.py",
        "spec/device.py",
        "spec/mask/files.py",
        "spec/scene/scene.py",
        "library/use/check.py",
        "core/storage/pictures.py",
    }
    assert not others & of_a_library


def test_all_that_a_build_loads_is_in_the_graph(of_a_library: set[str]) -> None:
    """Modules whose names a build's modules hold at run time: the graph misses none of them."""
    for name in of_a_library:
        module = sys.modules.get(name_of(PACKAGE / name))
        for value in vars(module).values() if module else ():
            if isinstance(value, ModuleType) and value.__name__.startswith(f"{name_of(PACKAGE / name)}."):
                continue  # Whoever imports a package's module leaves it there.
            where = getattr(value, "__module__", None) or getattr(value, "__name__", None)
            source = getattr(sys.modules.get(where), "__file__", None) if isinstance(where, str) else None
            path = Path(source) if source else None
            if path and path.is_relative_to(PACKAGE) and path.name != "__init__.py":
                assert path.relative_to(PACKAGE).as_posix() in of_a_library, (name, where)


def test_the_hash_follows_the_sources_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of its own: a changed import changes the hash, a changed bystander does not."""
    package = tmp_path / "metafab"
    (package / "room").mkdir(parents=True)
    for name, text in {
        "__init__.py": "",
        "room/__init__.py": "from metafab.room.used import value\nfrom metafab.room.bystander import other\n",
        "room/used.py": "value = 1\n",
        "room/bystander.py": "other = 1\n",
        "room/top.py": "def work():\n    from metafab.room import (\n        value,  # late\n    )\n    return value\n",
    }.items():
        (package / name).write_text(text)
    monkeypatch.setattr(source_graph, "_PACKAGE", package)
    monkeypatch.setattr(provenance, "_PACKAGE", package)

    def digest() -> str:
        for cached in (sources_of, imports_of, provenance.sources_sha256):
            cached.cache_clear()
        return provenance.sources_sha256(("metafab.room.top",), ())

    try:
        first = digest()
        (package / "room" / "bystander.py").write_text("other = 2\n")
        (package / "__init__.py").write_text('__version__ = "9.9"\n')
        (package / "room" / "used.py").write_text('"""Values."""\n\n#: The value.\nvalue = 1  # of old\n')
        assert digest() == first
        (package / "room" / "used.py").write_text("value = 2\n")
        assert digest() != first
        with pytest.raises(ValueError, match="expected one of metafab"):
            sources_of(("metafab.room.nowhere",))
    finally:
        for cached in (sources_of, imports_of, provenance.sources_sha256):
            cached.cache_clear()


def test_code_is_the_source_without_docstrings_and_comments() -> None:
    """By Python's own tokens: nothing that runs is left out, and nothing that does not run counts."""
    tricky = '''r"""Module \\"."""

def f():  # comment
    # Another.
    r"""Text with 'quotes', # and \\"."""
    return {"a": "#", 'b': """#\n\n  # kept\n"""}, "it's", f"#{1:>3}"  # end
'''
    seen = (tokenize.OP, tokenize.NAME, tokenize.NUMBER, tokenize.STRING)

    def tokens(text: str) -> list[tuple[tuple[int, int], str]]:
        every = tokenize.generate_tokens(io.StringIO(text).readline)
        return [(each.start, each.string) for each in every if each.type in seen or "FSTRING" in repr(each)]

    paths = sorted((PACKAGE / "core" / "storage").glob("*.py"))
    for source in (tricky, *(path.read_text(encoding="utf-8") for path in paths)):
        described = (ast.Module, ast.ClassDef, ast.FunctionDef)
        nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, described)]
        docstrings = [node.body[0] for node in nodes if ast.get_docstring(node) is not None]
        places = {(each.lineno, each.col_offset) for each in docstrings}
        code = provenance.code_of(source)
        expected = [text for place, text in tokens(source) if place not in places]
        assert [text for _, text in tokens(code)][1:] == expected  # after the colon before the module
        assert len(code.splitlines()) < len(source.splitlines())
    assert provenance.code_of(tricky).count("#") == 4
