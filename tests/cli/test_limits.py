"""``--limit`` of commands that read files."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from metafab.cli.entry import app, hoisted
from metafab.core.errors import InputError
from metafab.core.storage.limits import limit

DESIGN = Path(__file__).parents[2] / "layouts" / "helix_small.toml"


def refusal(*arguments: str) -> str:
    answer = CliRunner().invoke(app, hoisted(list(arguments)))
    assert isinstance(answer.exception, InputError)
    return str(answer.exception)


def test_a_limit_holds_for_the_command_alone() -> None:
    text = refusal("layout", str(DESIGN), "--limit", "memory_mb=0.0001")
    assert "at most 0.0001 MB" in text and "--limit memory_mb=N" in text
    assert limit("memory_mb", 3.0) == 3.0


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("memory_mb=-1", "memory_mb"),
        ("memory_mb=much", "memory_mb"),
        ("shapes=1.5", "shapes"),
        ("depth=9999", "depth"),
        ("bytes=5", "bytes"),
        ("seconds", "seconds"),
    ],
)
def test_bad_limits_are_refused_by_name(value: str, words: str) -> None:
    text = refusal("drc", "mask.oas", "--design", str(DESIGN), "--limit", value)
    assert text.startswith("--limit:") and words in text


def test_the_option_may_stand_behind_the_command() -> None:
    assert hoisted(["drc", "m.oas", "--limit", "depth=5", "--json", "--limit=shapes=9"]) == [
        "--limit", "depth=5", "--limit=shapes=9", "drc", "m.oas", "--json",
    ]  # fmt: skip
    assert "--limit NAME=N" in " ".join(CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).stdout.split())
