"""What a command shows: bars and messages on stderr, its result on stdout."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from metafab.core.parallel.progress import Progress


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Bars with a time estimate on a terminal's stderr; silence elsewhere."""
    from metafab.core.parallel.progress import silent

    if not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, TaskID] = {}

        def advance(step: str, done: float, total: float) -> None:
            if step not in tasks:
                tasks[step] = bars.add_task(step, total=total)
            bars.update(tasks[step], completed=done, total=total)

        yield advance


def show(result: Any, as_json: bool) -> None:
    """Print a result as text, or as one JSON object."""
    from metafab.core.storage.files import plain

    table = plain(result)
    if as_json:
        print(json.dumps(table, ensure_ascii=False))
        return
    for line in _lines(table):
        print(line)


def announce(sentences: Iterable[str]) -> None:
    """Say on stderr what is worth knowing before the work begins."""
    for sentence in sentences:
        print(f"metafab: {sentence}", file=sys.stderr)


def short_of_a_turn(coverage_rad: float) -> list[str]:
    """What to say of a library whose sizes reach much less than a turn of phase: nothing if they do not."""
    if coverage_rad >= 0.6 * 2.0 * math.pi:
        return []
    text = f"the library reaches {coverage_rad:.3g} rad of phase, far less than a turn (6.28 rad)"
    return [f"{text}: are height, sizes and wavelength as they should be?"]


def exit_on_violations(count: int) -> None:
    """Exit with 2 if there are any."""
    if count:
        print(f"metafab: design rules violated at {count} places", file=sys.stderr)
        raise typer.Exit(2)


def _lines(value: Any, indent: int = 0) -> Iterator[str]:
    """A nested table as readable text."""
    pad = "  " * indent
    for key, item in value.items():
        if isinstance(item, dict) and item:
            yield f"{pad}{key}"
            yield from _lines(item, indent + 1)
        elif isinstance(item, list) and item and isinstance(item[0], dict):
            yield f"{pad}{key}"
            for row in item:
                yield f"{pad}  " + "  ".join(f"{k}={_text(v)}" for k, v in row.items())
        else:
            yield f"{pad}{key:<24} {_text(item)}"


def _text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    if isinstance(value, dict):
        return ", ".join(f"{k}: {_text(v)}" for k, v in value.items()) or "none"
    return str(value)
