"""Docstrings of public functions and dataclasses that take, return or hold arrays state the arrays' shapes."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "metafab"

#: Annotations of arrays.
ARRAY = re.compile(r"\b(\w*Array|NDArray|ArrayLike|np\.ndarray)\b")
#: A stated shape: in words, or as a tuple of axis lengths such as (n_y, n_x) or (2,).
SHAPE = re.compile(
    r"\bshapes?\b|\bscalars?\b|\bbroadcast|\((?:\w+(?: [-+*] \w+)?, ?)+(?:\w+(?: [-+*] \w+)?)?\)", re.IGNORECASE
)


def _public(parent: ast.Module | ast.ClassDef) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    for node in parent.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from _public(node)


def _has_arrays(node: ast.FunctionDef | ast.ClassDef) -> bool:
    if isinstance(node, ast.ClassDef):
        fields = [item for item in node.body if isinstance(item, ast.AnnAssign)]
        shown = [item for item in fields if not ast.unparse(item.target).startswith("_")]
        return any(ARRAY.search(ast.unparse(item.annotation)) for item in shown)
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    annotations = [item.annotation for item in arguments] + [node.returns]
    return any(ARRAY.search(ast.unparse(item)) for item in annotations if item is not None)


def shapeless(path: Path) -> list[str]:
    """Public functions and classes of a file that have arrays and state no shape."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        f"{path.relative_to(PACKAGE.parent)}:{node.lineno} {node.name}"
        for node in _public(tree)
        if _has_arrays(node) and not SHAPE.search(ast.get_docstring(node) or "")
    ]


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_arrays_have_stated_shapes(path: Path) -> None:
    assert shapeless(path) == []


def test_a_docstring_without_shapes_is_found(tmp_path: Path) -> None:
    source = tmp_path / "metafab" / "module.py"
    source.parent.mkdir()
    source.write_text('def good(a: FloatArray) -> float:\n    """Mean of ``a``, shape (n,)."""\n')
    tree = ast.parse(source.read_text() + 'def bad(a: FloatArray) -> float:\n    """Mean of ``a``."""\n')
    assert [SHAPE.search(ast.get_docstring(node) or "") is None for node in _public(tree)] == [False, True]
