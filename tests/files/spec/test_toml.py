"""Hostile TOML is refused in words and at once; a byte-order mark is accepted."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import load_design, load_unit_cell
from tests.main_job import UNIT_CELL

HOSTILE = {
    "nested lists": "a = " + "[" * 20_000 + "]" * 20_000,
    "nested tables": "a = " + "{a = " * 20_000 + "1" + "}" * 20_000,
    "nested a little": "a = " + "[" * 150 + "]" * 150,
    "integer of 5000 digits": "name = " + "9" * 5000,
    "integer of 4000 digits": "[device]\naperture_um = " + "9" * 4000,
    "NUL in a path": 'library = "a\\u0000b.toml"',
    "NUL in a scene's path": 'scene = "a\\u0000b.toml"',
    "NUL in an index table": '[pillar]\nmaterial = "a\\u0000.csv"',
    "dotted key": "a" + ".a" * 50_000 + " = 1",
    "dotted key with quotes": '"a" . ' + "'b'." * 50_000 + "c = 1",
    "dotted header": "[a" + ".a" * 50_000 + "]",
    "dotted key of an inline table": "x = {a" + ".a" * 50_000 + " = 1}",
    "escaped quotes": 'a = "' + '\\"' * 1_900_000 + '"',
    "unknown keys": "".join(f"a{number} = 1\n" for number in range(280_000)),
    "one word": "a" * 3_900_000,
    "dots": "a = 1" + "." * 3_900_000,
    "larger than any design": "a = 1\n" + "#" * 10_000_000,
}


@pytest.mark.parametrize("load", [load_design, load_unit_cell])
@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_toml_is_refused_at_once(content: str, load: object, tmp_path: Path) -> None:
    path = tmp_path / "hostile.toml"
    path.write_text(content, encoding="utf-8")
    start = time.process_time()
    with pytest.raises(InputError):
        load(path)  # type: ignore[operator]
    assert time.process_time() - start < 5.0


def test_a_byte_order_mark_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(b"\xef\xbb\xbf" + UNIT_CELL.read_bytes())
    assert load_unit_cell(path) == load_unit_cell(UNIT_CELL)
