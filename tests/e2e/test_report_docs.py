"""The documentation holds: it builds without a warning, its commands parse, its TOML and Python are ours."""

from __future__ import annotations

import importlib
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import tomli_w
import typer

from metafab.cli.entry import app
from metafab.core.errors import InputError
from metafab.spec import Scene, UnitCell, kinds, load_design, load_unit_cell
from metafab.spec.toml import validate

ROOT = Path(__file__).parents[2]
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
DESIGN = (ROOT / "layouts" / "helix_small.toml").read_text(encoding="utf-8")
UNIT_CELL = (ROOT / "unitcell_lib" / "sos_800nm.toml").read_text(encoding="utf-8")


def _blocks(language: str) -> list[Any]:
    """Every fenced block of a language, with its page and number as the test's name."""
    found = []
    for page in [*PAGES, ROOT / "README.md"]:
        text = page.read_text(encoding="utf-8")
        for number, match in enumerate(re.finditer(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)):
            found.append(pytest.param(match[1], id=f"{page.stem}-{number}"))
    return found


def _commands() -> list[Any]:
    """Every metafab command line of a console block."""
    found = []
    for block in _blocks("console"):
        for line in str(block.values[0]).splitlines():
            words = shlex.split(line.removeprefix("$ ").removesuffix("&"))
            if line.startswith("$ ") and Path(words[0]).name == "metafab":
                found.append(pytest.param(words[1:], id=" ".join(words[1:4])))
    return found


@pytest.mark.parametrize("words", _commands())
def test_commands_parse(words: list[str]) -> None:
    """Every option exists and takes what the page gives it; parsing does not run the command."""
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        assert words[0] in command.commands, f"no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    command.make_context("metafab", words)


def _holds_tables_alone(value: Any) -> bool:
    items = value.values() if isinstance(value, dict) else [None]
    return all(
        isinstance(item, dict) or (isinstance(item, list) and item and isinstance(item[0], dict)) for item in items
    )


@pytest.mark.parametrize("block", _blocks("toml"))
def test_toml_is_accepted(block: str, tmp_path: Path) -> None:
    """A table of a page takes the place of the same table in the small design, or in its unit cell.

    A table inside a table (``[sweep.axes]``) is added to the outer one. The keys of a scene file are a whole scene.
    """
    tables = tomllib.loads(block)
    if set(tables) <= {item.name for item in fields(Scene)}:
        validate(Scene, tables, "scene file of the page")
        return
    known_to_cell = set(tables) <= {item.name for item in fields(UnitCell)}
    base = tomllib.loads(UNIT_CELL if known_to_cell else DESIGN)
    merged = {
        name: {**base[name], **table} if name in base and _holds_tables_alone(table) else table
        for name, table in {**base, **tables}.items()
    }
    if not known_to_cell:
        merged["library"] = str(ROOT / "unitcell_lib" / "sos_800nm.toml")
    path = tmp_path / "from_page.toml"
    path.write_text(tomli_w.dumps(merged), encoding="utf-8")
    try:
        (load_unit_cell if known_to_cell else load_design)(path)
    except InputError as error:
        pytest.fail(str(error))


@pytest.mark.parametrize("block", _blocks("python"))
def test_python_compiles(block: str) -> None:
    """Those that can be run are run by test_documented_commands.py."""
    compile(block, "documentation", "exec")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_line_is_lost_as_a_comment(page: Path) -> None:
    """MyST takes a line that begins with a per cent sign for a comment, and leaves it out."""
    lines = page.read_text(encoding="utf-8").splitlines()
    assert not [number for number, line in enumerate(lines, 1) if line.lstrip().startswith("%")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_formula_is_broken_by_a_line_that_begins_a_list(page: Path) -> None:
    """A line that begins with a minus ends its paragraph, and the formula in it: from there on text is mathematics."""
    text = re.sub(r"```.*?```|`[^`]*`|\$\$.*?\$\$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    blocks = re.split(r"\n\s*\n|\n(?=\s*[-*+] )", text)
    assert not [block for block in blocks if block.count("$") % 2]


def test_a_formula_that_cannot_be_drawn_stands_as_it_was_written(monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = pytest.importorskip("docutils.nodes")
    monkeypatch.syspath_prepend(ROOT / "docs")
    native_math = importlib.import_module("native_math")
    assert "<mo>&lt;</mo>" in native_math._mathml(nodes.math("", "a < b"), as_block=False)
    assert native_math._mathml(nodes.math("", r"\mystery{a} < b"), as_block=False) == r"<code>\mystery{a} &lt; b</code>"


def test_every_page_is_reached() -> None:
    """No page stands outside the table of contents."""
    listed = set()
    for page in PAGES:
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            for line in tree.splitlines():
                if line and not line.startswith(":"):
                    listed.add((page.parent / f"{line.strip()}.md").resolve())
    assert set(PAGES) - listed == {ROOT / "docs" / "index.md"}


def test_the_gallery_shows_every_kind_of_device() -> None:
    text = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^```\{device\} (\w+)$", text, re.MULTILINE)) == sorted(kinds())


@pytest.mark.slow
@pytest.mark.skipif(find_spec("sphinx") is None or find_spec("myst_nb") is None, reason="the docs extra is missing")
def test_documentation_builds_without_a_warning(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-b",
        "html",
        "-W",
        "--keep-going",
        "-q",
        "-D",
        "nb_execution_mode=off",
        "docs",
        str(tmp_path / "out"),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "theory" / "conventions.html").is_file()
    gallery = (tmp_path / "out" / "gallery.html").read_text(encoding="utf-8")
    assert gallery.count("psf_pair") == gallery.count("mask_close") == len(kinds())
    assert gallery.count(" 0 rules broken") == len(kinds())
