"""Commands ``report``, ``benchmark``, ``keys`` and ``doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metafab.cli.app import Json, app
from metafab.cli.console import progress_bars, show
from metafab.cli.outputs import OutputFolder


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
    output: OutputFolder = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run fewer and smaller cases.")] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="NAME",
            help="Case of `scenes`, part of `expose` or `files`, kind of `certificates` or `faults`, aperture (um) of "
            "`apertures`, job of `cluster`; may be repeated.",
        ),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, metavar="N", help="Seeds of each case of `scenes` [default: 5].")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", min=0, metavar="S", help="Seed of `certificates`, `files` and `faults` [default: 0]."),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples",
            min=1,
            metavar="N",
            help="Answers of `certificates` [default: 300] or `files` [default: 2000], frames of `films` [default: "
            "10000], kills of `faults` [default: 40].",
        ),
    ] = None,
    json_: Json = False,
) -> None:
    """Measure error against time and memory; write a table, plots and JSON."""
    from metafab import report
    from metafab.benchmark import ALL_CASES, rows_of

    with progress_bars() as progress:
        rows = rows_of(room, quick=quick, progress=progress, only=only, seeds=seeds, seed=seed, samples=samples)
    whole = next((dict(row.further) for row in rows if row.name == ALL_CASES), {})
    page = report.benchmark_page(rows, output or Path("runs") / "benchmark" / room)
    show(whole | {"rows": [row.table() for row in rows], "files": page}, json_)


@app.command("keys")
def keys_command(
    place: Annotated[
        str | None, typer.Argument(metavar="KEY", help="Part of a key or table, such as mask.chip [default: all].")
    ] = None,
    json_: Json = False,
) -> None:
    """Explain the keys of design, unit-cell and scene files: type, unit, range, default, meaning."""
    from metafab.spec.keys.search import search

    keys = search(place or "")
    if json_:
        show({"keys": keys}, json_)
        return
    for key in keys:
        notes = [key.kind, key.unit, key.allowed, f"default {key.default}" if key.default else ""]
        print(f"{key.path}  ({'; '.join(note for note in notes if note).replace('default required', 'required')})")
        print(f"    {key.meaning}")


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
