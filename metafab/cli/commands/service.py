"""Commands ``report``, ``benchmark`` and ``doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metafab.cli.app import Json, Output, app
from metafab.cli.console import progress_bars, show


@app.command("report")
def report_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Run folder.")], json_: Json = False
) -> None:
    """Make the HTML page of a run folder again."""
    from metafab import report

    with progress_bars() as progress:
        path = report.write(folder, progress=progress)
    show({"file": path}, json_)


@app.command("benchmark")
def benchmark_command(
    room: Annotated[str, typer.Argument(help="A room, end_to_end, or all.")] = "all",
    output: Output = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run fewer and smaller cases.")] = False,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="Case of `scenes` to run; may be repeated.")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, metavar="N", help="Seeds of each case of `scenes` [default: 5].")
    ] = None,
    json_: Json = False,
) -> None:
    """Measure error against time and memory; write a table, plots and JSON."""
    from metafab import report
    from metafab.benchmark import rows_of

    with progress_bars() as progress:
        rows = rows_of(room, quick=quick, only=only or (), seeds=seeds, progress=progress)
    page = report.benchmark_page(rows, output or Path("runs") / "benchmark" / room)
    show({"rows": [row.table() for row in rows], "files": page}, json_)


@app.command("doctor")
def doctor_command(
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="Also run a small lens from unit cell to depth map: half a minute.")
    ] = False,
    json_: Json = False,
) -> None:
    """Show the installed tools and run a short self-test."""
    from metafab.doctor import examine

    with progress_bars() as progress:
        diagnosis = examine(rehearse=rehearse, progress=progress)
    show(diagnosis, json_)
    if not all(diagnosis.self_test.values()):
        raise typer.Exit(1)
