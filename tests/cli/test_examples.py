"""Each command's help ends with an example that the command itself accepts."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from metafab.cli.entry import app, spread_depths
from metafab.cli.examples import EXAMPLES


def _leaves(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
        return
    for name, leaf in inner.items():
        yield from _leaves(leaf, (*words, *name.split()))


COMMANDS = dict(_leaves(typer.main.get_command(app)))


def test_every_command_has_an_example_and_every_example_a_command() -> None:
    assert {" ".join(words) for words in COMMANDS} == EXAMPLES.keys()


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_an_example_is_accepted_by_its_command(words: tuple[str, ...]) -> None:
    program, *rest = shlex.split(EXAMPLES[" ".join(words)])
    assert (program, tuple(rest[: len(words)])) == ("metafab", words)
    context = COMMANDS[words].make_context(" ".join(words), spread_depths(rest[len(words) :]))
    assert EXAMPLES[" ".join(words)] in COMMANDS[words].get_help(context)
