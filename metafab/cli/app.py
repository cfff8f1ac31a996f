"""The program, and the options shared by several commands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import BadParameter
from typer.core import TyperCommand, TyperGroup
from typer.models import CommandFunctionType

from metafab.cli.examples import epilog
from metafab.cli.failures import DEBUG_VARIABLE
from metafab.cli.outputs import CHECKS
from metafab.core.errors import InputError, noted
from metafab.core.storage.limits import limited

if TYPE_CHECKING:
    from metafab.core.parallel.work import Work
    from metafab.steps.job import Job

HELP = {"help_option_names": ["-h", "--help"]}


class _Command(TyperCommand):
    """A command that states bad values in our words, and refuses a result over an input or where none can stand."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.help = self.help and self.help.replace("``", "`")  # docstrings mark code with two backticks

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except BadParameter as error:
            if error.__cause__ is not None:
                from pydantic import ValidationError

                from metafab.spec.keys.faults import option_fault

                if isinstance(error.__cause__, ValidationError):
                    error.message = option_fault(error.__cause__, error.message)
            raise

    def invoke(self, ctx: Any) -> Any:
        output = ctx.params.get("output")
        given = [value for name, value in ctx.params.items() if name != "output"]
        lists = [value if isinstance(value, list | tuple) else [value] for value in given]
        read = [value for values in lists for value in values if isinstance(value, Path)]
        if isinstance(output, Path):
            CHECKS[next(each.metavar or "" for each in self.params if each.name == "output")](output, read)
        with noted(f"`{' '.join([_called(ctx), *map(str, read)])}`"):
            return super().invoke(ctx)


class _TwoWords(TyperGroup):
    """A group that finds a command of two words before that of the first: ``psf import`` before ``psf``."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name = " ".join(args[:2])
        if len(args) > 1 and name in self.commands:
            return name, self.commands[name], args[2:]
        return super().resolve_command(ctx, args)


def _called(ctx: Any) -> str:
    """The command with its parents, such as ``metafab library build``."""
    return f"{_called(ctx.parent)} {ctx.info_name}" if ctx.parent else "metafab"


class _Program(typer.Typer):
    """A program, or a group of its commands with the group's name as ``prefix``."""

    prefix = ""

    def command(self, *args: Any, **options: Any) -> Callable[[CommandFunctionType], CommandFunctionType]:
        name = f"{self.prefix} {args[0]}".strip()
        return super().command(*args, **{"cls": _Command, "epilog": epilog(name), **options})


app = _Program(
    cls=_TwoWords,
    help="From unit cell to mask to decoded image.",
    context_settings=HELP,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
library_app = _Program(
    help="Build, check and show phase libraries.", context_settings=HELP, no_args_is_help=True, rich_markup_mode=None
)
library_app.prefix = "library"
app.add_typer(library_app, name=library_app.prefix)


def _show_version(wanted: bool) -> None:
    if wanted:
        from metafab import __version__

        print(f"metafab {__version__}")
        raise typer.Exit


def _state_limits(ctx: typer.Context, values: list[str]) -> list[str]:
    """Apply the limits of ``--limit`` for as long as the command runs."""
    if not values:
        return values
    from metafab.spec.design import Limits
    from metafab.spec.toml import validate

    stated: dict[str, float | str] = {}
    for value in values:
        name, _, number = value.partition("=")
        try:
            stated[name] = int(number) if number.isdecimal() else float(number)
        except ValueError:
            stated[name] = number
    ctx.with_resource(limited(**vars(validate(Limits, stated, "--limit"))))
    return values


@app.callback()
def program_options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Show the version and exit.", callback=_show_version, is_eager=True),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help=f"Show the traceback of a failure (also {DEBUG_VARIABLE}=1).")
    ] = False,
    limit: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=N",
            help="Limit for reading a file: memory_mb, shapes, depth or seconds; may be repeated.",
            callback=_state_limits,
        ),
    ] = [],  # noqa: B006 (typer copies it)
) -> None:
    """Options of all commands."""
    del version, limit  # their callbacks have run
    if debug:
        os.environ[DEBUG_VARIABLE] = "1"


DesignFile = Annotated[Path, typer.Argument(metavar="DESIGN.toml", help="Design file.")]
DesignOption = Annotated[Path, typer.Option("--design", metavar="DESIGN.toml", help="Design file.")]
UnitCellFile = Annotated[Path, typer.Argument(metavar="UNITCELL.toml", help="Unit-cell file.")]
LayoutFile = Annotated[Path, typer.Argument(metavar="LAYOUT", help="Written mask, .gds or .oas.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=4096, metavar="N", help="Processes [default: the cores]."),
]
Cluster = Annotated[str | None, typer.Option("--cluster", metavar="ADDRESS", help="Dask scheduler to use.")]
Copy = Annotated[
    int, typer.Option("--copy", min=1, max=1_000_000, metavar="N", help="Lens of mask.copies, counted from 1.")
]
TargetError = Annotated[
    float | None,
    typer.Option("--target-error", metavar="E", help="Target error.", min=1e-12, max=0.999),
]


def open_job(design: Path, folder: Path | None, work: Work) -> Job:
    """Open the job of a design file, in ``folder`` or in ``runs/NAME``."""
    from metafab.spec import load_design
    from metafab.steps.job import Job, with_targets

    spec = with_targets(load_design(design))
    return Job(spec, folder or Path("runs") / spec.name, work)


def require_finite(option: str, *values: float | None, positive: bool = False) -> None:
    """Check that all values of an option are finite (and above zero), up to the largest number of a file.

    None stands for an option that is not given.
    """
    given = [value for value in values if value is not None]
    if not given:
        return
    from metafab.spec.fields import LARGEST

    if wrong := [f"{value:g}" for value in given if not abs(value) <= LARGEST or (positive and value <= 0.0)]:
        expected = f"a number above zero, at most {LARGEST:g}" if positive else f"a finite number up to {LARGEST:g}"
        raise InputError.single(option, option.removeprefix("--"), expected, ", ".join(wrong))


def require_positive(option: str, *values: float | None) -> None:
    """Check that all values of an option are finite and above zero; None stands for an option that is not given."""
    require_finite(option, *values, positive=True)


@contextmanager
def faults_of_options(options: Mapping[str, str], source: str | None = None) -> Iterator[None]:
    """Name the arguments of faults, and in their remedies, by the ``options`` that gave them.

    The error is named by ``source``, if it is given.
    """
    try:
        yield
    except InputError as error:
        faults = []
        for fault in error.faults:
            remedy = fault.remedy
            for name, option in options.items():
                remedy = remedy.replace(f"`{name}`", f"`{option}`")
            faults.append(replace(fault, field=options.get(fault.field, fault.field), remedy=remedy))
        raise InputError(source or error.source, faults) from error
