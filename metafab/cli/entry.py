"""Entry point of the command line: errors and interrupts become one clear message and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
from collections import deque
from copy import copy
from typing import NoReturn

from typer import Typer
from typer.models import CommandInfo

from metafab.cli.app import HELP, app
from metafab.cli.failures import FAILURES, is_debugging, message_of
from metafab.core.errors import InputError, MetafabError
from metafab.core.parallel.interrupts import InterruptedRunError, raised_interrupts

# Each import registers its commands, in the order of --help.
# isort: off
from metafab.cli.commands import run  # noqa: F401
from metafab.cli.commands import study  # noqa: F401
from metafab.cli.commands import cell  # noqa: F401
from metafab.cli.commands import mask  # noqa: F401
from metafab.cli.commands import expose  # noqa: F401
from metafab.cli.commands import fullwave  # noqa: F401
from metafab.cli.commands import light  # noqa: F401
from metafab.cli.commands import images  # noqa: F401
from metafab.cli.commands import service  # noqa: F401

# isort: on

#: Variables that set the number of threads of the linear-algebra libraries.
_ALGEBRA_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_HELP = HELP["help_option_names"]
#: Options with a list of depths; the second may be followed by a file's name instead.
_DEPTHS = ("--depths-m", "--depths")


def main() -> None:
    """Run the command line; turn errors into one clear message and an exit code."""
    for name in _ALGEBRA_THREADS:
        # The matrices are small and the processes many: further threads would only wait for each other.
        os.environ.setdefault(name, "1")
    try:
        with raised_interrupts():
            arguments = spread_depths(hoisted(sys.argv[1:]))
            program(arguments)(arguments)
    except MetafabError as error:
        _end(error, str(error), error.exit_code)
    except InterruptedRunError as error:
        text = "interrupted; nothing half-written was left behind; run it again to go on from here"
        _end(error, text, 128 + error.number)
    except FAILURES as error:
        _end(error, message_of(error), 1)


def program(arguments: list[str]) -> Typer:
    """The program with the commands that ``arguments`` may mean.

    Typer examines the options of all commands before it runs one, for 70 ms of processor time. The list of commands
    needs none of them; a name that no command has gets the whole program, which proposes others.
    """
    if any(name.endswith("_COMPLETE") for name in os.environ):
        return app
    rest = iter(arguments)
    words = (next(rest, "") and None if each == "--limit" else each for each in rest)
    # `--help` before the command asks for the list.
    word = next((each for each in words if each and (each in _HELP or not each.startswith("-"))), None)
    part = copy(app)
    if word is None or word in _HELP:
        part.registered_commands = [_listed(each) for each in app.registered_commands]
        return part
    part.registered_commands = [each for each in app.registered_commands if (each.name or "").split()[:1] == [word]]
    part.registered_groups = [each for each in app.registered_groups if each.name == word]
    return part if part.registered_commands or part.registered_groups else app


def _listed(command: CommandInfo) -> CommandInfo:
    """A command without its options, for the list of commands."""

    def described() -> None: ...

    described.__doc__ = getattr(command.callback, "__doc__", None)
    listed = copy(command)
    listed.callback = described
    return listed


def _end(error: BaseException, message: str, exit_code: int) -> NoReturn:
    """Print a message, with ``--debug`` after the traceback, and exit."""
    if is_debugging():
        traceback.print_exception(error)
    print(f"metafab: {message}", file=sys.stderr)
    sys.exit(exit_code)


def hoisted(arguments: list[str]) -> list[str]:
    """Move ``--limit NAME=N`` and ``--limit=NAME=N``, which belong to the program, before the command."""
    first: list[str] = []
    others: list[str] = []
    rest = deque(arguments)
    while rest:
        argument = rest.popleft()
        if argument == "--limit" and rest:
            first += [argument, rest.popleft()]
        else:
            (first if argument.startswith("--limit=") else others).append(argument)
    return first + others


def spread_depths(arguments: list[str]) -> list[str]:
    """Turn ``--depths-m 0.25 0.3`` and ``--depths-m 0.25,0.3`` into one option for each depth, likewise ``--depths``.

    InputError if no number follows ``--depths-m``.
    """
    spread: list[str] = []
    rest = deque(arguments)
    while rest:
        argument = rest.popleft()
        name, equals, value = argument.partition("=")
        following = value if equals else rest[0] if rest else ""
        if name not in _DEPTHS or (name == "--depths" and not _are_numbers(following)):
            spread.append(argument)
            continue
        if equals:
            rest.appendleft(value)
        if not (rest and _are_numbers(rest[0])):
            raise InputError.single(name, "depths.m", "one or more depths", repr(rest[0]) if rest else "nothing")
        while rest and _are_numbers(rest[0]):
            # With "=", a minus sign does not begin an option.
            spread += [f"{name}={number}" for number in rest.popleft().split(",")]
    return spread


def _are_numbers(text: str) -> bool:
    try:
        for number in text.split(","):
            float(number)
    except ValueError:
        return False
    return True
