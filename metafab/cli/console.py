"""Output of the commands: bars and messages on stderr, the result on stdout."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metafab.core.parallel.measure import Cost
    from metafab.core.parallel.progress import Progress
    from metafab.core.parallel.work import Work

#: Least time between two drawings of the bars (s).
_REDRAW_S = 0.1
#: Fewest units of work and seconds from which the pace of a step is estimated: three rows of each of eight kinds, or
#: six chunks of four cells.
_PACE_UNITS, _PACE_S = 24, 2.0


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Show progress bars with a time estimate on stderr if it is a terminal."""
    from metafab.core.parallel.progress import silent

    if not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    # A thread that draws the bars would keep this process from forking its workers.
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), auto_refresh=False) as bars:
        tasks: dict[str, TaskID] = {}
        drawn_s = -math.inf

        def advance(step: str, done: float, total: float) -> None:
            nonlocal drawn_s
            if step not in tasks:
                tasks[step] = bars.add_task(step, total=total)
            bars.update(tasks[step], completed=done, total=total)
            if done >= total or time.monotonic() - drawn_s > _REDRAW_S:
                bars.refresh()
                drawn_s = time.monotonic()

        yield advance


@contextmanager
def open_work(workers: int | None = None, cluster: str | None = None) -> Iterator[tuple[Work, Cost]]:
    """Open the resources of a command, with progress bars; its cost is filled in when the block ends."""
    from metafab.core.parallel.measure import measured
    from metafab.core.parallel.work import Work

    with progress_bars() as progress, measured() as cost:
        yield Work(workers, cluster, progress), cost


def pace(progress: Progress, known: Container[str]) -> Progress:
    """Announce the time of each step's first units once, and that of the rest for the ``known`` steps.

    The other steps learn their number of units as they go.
    """
    began: dict[str, tuple[float, float]] = {}
    announced: set[str] = set()

    def advance(step: str, done: float, total: float) -> None:
        progress(step, done, total)
        now_s = time.monotonic()
        began_s, before = began.setdefault(step, (now_s, done))
        units, spent_s = done - before, now_s - began_s
        if step in announced or done >= total or units < _PACE_UNITS or spent_s < _PACE_S:
            return
        announced.add(step)
        left = f"; the other {total - done:g} take about {(total - done) * spent_s / units:.2g} s" * (step in known)
        announce([f"{step}: the first {units:g} took {spent_s / units:.2g} s each{left}"])

    return advance


def show(result: Any, as_json: bool, **further: Any) -> None:
    """Print a result (a dataclass or a table) and ``further`` figures of the command, as text or as one JSON object."""
    from metafab.core.storage.files import plain

    show_table(plain(result) | plain(further), as_json)


def show_table(table: dict[str, Any], as_json: bool) -> None:
    """Print a table of JSON types as text or as one JSON object."""
    if as_json:
        print(json.dumps(table, ensure_ascii=False))
        return
    for line in _lines(table):
        print(line)


def announce(sentences: Iterable[str]) -> None:
    """Print announcements on stderr."""
    for sentence in sentences:
        print(f"metafab: {sentence}", file=sys.stderr)


def coverage_warning(coverage_rad: float) -> list[str]:
    """Return a warning if the sizes of a library cover much less than one turn of phase."""
    if coverage_rad >= 0.6 * 2.0 * math.pi:
        return []
    sizes = "the sizes that transmit at least half of the light"
    text = f"{sizes} reach {coverage_rad:.3g} rad of phase" if coverage_rad else f"no size is among {sizes}"
    return [f"{text}; a turn is 6.28 rad: are height, sizes and wavelength as they should be?"]


def exit_code(violations: int) -> int:
    """Exit code of a mask: 2, with a message on stderr, if design rules are violated."""
    if violations:
        announce([f"design rules violated at {violations} places"])
    return 2 if violations else 0


def exit_on_violations(count: int) -> None:
    """Exit with code 2 if design rules are violated."""
    from typer import Exit  # An unchanged run is answered without it.

    if code := exit_code(count):
        raise Exit(code)


def _lines(value: Any, indent: int = 0) -> Iterator[str]:
    """Lines of text of a nested table."""
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
