"""``metafab run`` where nothing has changed: the previous run's answer again, without the imports of the program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from metafab.cli.console import announce, exit_code, show_table
from metafab.core.storage.rerun import code_mark, find_rerun


def answer_again(arguments: Sequence[str]) -> int | None:
    """Print the answer of an unchanged run and return its exit code; None if the program has to run.

    It understands ``run DESIGN.toml`` with ``-o DIR`` and ``--json``; other arguments are left to the program.
    """
    if not arguments or arguments[0] != "run":
        return None
    design, output, as_json = None, None, False
    rest = iter(arguments[1:])
    for argument in rest:
        if argument == "--json":
            as_json = True
        elif argument in {"-o", "--output"} and (following := next(rest, None)) is not None:
            output = Path(following)
        elif argument.startswith("-") or design is not None:
            return None
        else:
            design = Path(argument)
    found = None if design is None else find_rerun(design, output, code_mark())
    if found is None:
        return None
    known, folder = found
    announce(known.announcements)
    show_table(known.summary if as_json else known.headlines | pages(folder), as_json)
    return exit_code(known.violations)


def pages(folder: Path) -> dict[str, str]:
    """Paths of a run's summary and report, as text by label."""
    return {"all figures": str(folder / "summary.json"), "report": str(folder / "report.html")}
