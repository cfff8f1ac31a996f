"""The ``keys`` directive: all keys of a kind of input file as tables, read from the specs when the pages are built."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive

from metafab.spec.keys.reference import Key
from metafab.spec.keys.search import files

COLUMNS = {"key": 22, "type and range": 28, "default": 12, "meaning": 50}


class Keys(Directive):
    """``keys`` with the kind of file as its argument: "design" or "unit cell"."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """One section for each table of the file."""
        found: list[nodes.Node] = []
        for name, keys in tables(files()[self.arguments[0]]).items():
            section = nodes.section(ids=[nodes.make_id(f"{self.arguments[0]}-{name}")])
            section += nodes.title(text=f"[{name}]" if name else "Top of the file")
            section += _table(keys)
            found.append(section)
        return found


def tables(keys: tuple[Key, ...]) -> dict[str, list[Key]]:
    """Keys by their table; a material's keys are listed once."""
    groups: dict[str, list[Key]] = {}
    for name, group in groupby(keys, key=lambda key: key.path.rpartition(".")[0]):
        if ".material" not in name and name not in {"materials.substrate", "materials.ambient"}:
            groups.setdefault(name, []).extend(group)
    return groups


def _table(keys: list[Key]) -> nodes.table:
    group = nodes.tgroup(cols=len(COLUMNS))
    group += [nodes.colspec(colwidth=width) for width in COLUMNS.values()]
    head, body = nodes.thead(), nodes.tbody()
    head += _row([nodes.Text(name) for name in COLUMNS])
    for key in keys:
        kind = ", ".join(part for part in (key.kind, key.unit, key.allowed) if part)
        name, default = key.path.rpartition(".")[2], nodes.literal(text=key.default) if key.default else nodes.Text("")
        body += _row([nodes.literal(text=name), nodes.Text(kind), default, nodes.Text(key.meaning.replace("`", ""))])
    group += [head, body]
    table = nodes.table()
    table += group
    return table


def _row(cells: list[Any]) -> nodes.row:
    row = nodes.row()
    for cell in cells:
        row += nodes.entry("", nodes.paragraph("", "", cell))
    return row


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("keys", Keys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
