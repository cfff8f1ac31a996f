"""Every numeric option of every command that needs no earlier result, with values that no option takes."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from metafab.cli.entry import app, main
from tests.main_job import SMALL, UNIT_CELL

#: Arguments with which each command would work; nothing of it is done, so none of them takes long.
VALID: dict[str, list[Any]] = {
    "cell": [UNIT_CELL, "--width-nm", "150", "--length-nm", "200"],
    "library build": [UNIT_CELL, "-o", "library.h5"],
    "propose": ["--range-m", "0.25", "0.34", "--aperture-um", "200"],
    "psf": ["--ideal", "--design", SMALL, "-o", "psf.h5"],
    "layout": [SMALL, "-o", "layout"],
    "run": [SMALL, "-o", "run"],
}
NO_NUMBERS = ["nan", "inf", "-inf", "abc", "", "1,5", "0x10"]
#: Options whose numbers may have any sign; a lens has copies from 1.
SIGNED = {"--azimuth-deg", "--object-mm", "--centre-um"}


def _numeric_options(name: str) -> Iterator[tuple[str, int, bool]]:
    """Name, values and whether they are whole numbers, as the command declares them."""
    command: Any = typer.main.get_command(app)
    for word in name.split():
        command = command.commands[word]
    for parameter in command.params:
        annotation = str(parameter.type_descriptor.annotation)
        if parameter.param_type_name == "option" and re.search(r"\b(float|int)\b", annotation):
            yield parameter.opts[0], parameter.nargs, "float" not in annotation


def _cases() -> Iterator[tuple[str, str, str, int]]:
    for name in VALID:
        for option, count, whole in _numeric_options(name):
            values = [*NO_NUMBERS, *([] if option in SIGNED else ["-1"]), *(["1e30", str(10**30)] if whole else [])]
            for value in values:
                if not (option == "--depths-m" and value in {"1,5", "inf"}):  # two depths, and parallel light
                    yield name, option, value, count


def test_the_table_is_not_empty() -> None:
    assert len({(name, option) for name, option, _, _ in _cases()}) >= 20


@pytest.mark.parametrize(("name", "option", "value", "count"), list(_cases()))
def test_a_number_that_is_none_is_refused_by_name(
    name: str, option: str, value: str, count: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    arguments = [str(argument) for argument in VALID[name]]
    if option in arguments:
        place = arguments.index(option)
        del arguments[place : place + 1 + count]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["metafab", *name.split(), *arguments, option, *[value] * count, "--json"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert ended.value.code == 2, said.err
    assert said.out == ""
    assert "Traceback" not in said.err
    words = option.removeprefix("--").replace("-", ".")
    assert re.search(words, said.err), "the message names the option"
    assert list(tmp_path.iterdir()) == []
