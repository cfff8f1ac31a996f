"""The shapes of arrays that a public function takes or returns, or a dataclass holds, are stated.

Those of a function stand in its docstring, those of a field beside the field (``#:``) or in the docstring of its class.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

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


def _stated(node: ast.FunctionDef | ast.ClassDef, source: str) -> str:
    """Docstring of a function or class; of a class also the comments of its fields."""
    text = ast.get_docstring(node) or ""
    if isinstance(node, ast.FunctionDef):
        return text
    fields = [item.end_lineno or 0 for item in node.body if isinstance(item, ast.AnnAssign)]
    lines = source.splitlines()[node.lineno : max(fields, default=0)]
    return "\n".join([text, *(line.partition("#:")[2] for line in lines)])


def shapeless(source: str) -> list[str]:
    """Names of the public functions and classes of a source that have arrays and state no shape."""
    nodes = [node for node in _public(ast.parse(source)) if _has_arrays(node)]
    return [node.name for node in nodes if not SHAPE.search(_stated(node, source))]


def test_arrays_have_stated_shapes() -> None:
    missing = []
    for path in sorted(PACKAGE.rglob("*.py")):
        names = shapeless(path.read_text(encoding="utf-8"))
        missing += [f"{path.relative_to(PACKAGE)}: {name}" for name in names]
    assert missing == []


def test_missing_shapes_are_found() -> None:
    stated = '    """Mean of ``a``, shape (n,)."""\n'
    source = f'def good(a: FloatArray) -> float:\n{stated}def bad(a: FloatArray) -> float:\n    """Mean of ``a``."""\n'
    source += 'class Good:\n    """Means."""\n\n    mean: FloatArray  #: Shape (n,).\n'
    source += 'class Bad:\n    """Means."""\n\n    mean: FloatArray  #: Of each row.\n'
    assert shapeless(source) == ["bad", "Bad"]
