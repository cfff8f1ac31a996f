"""The whole job, and the design file that it starts from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metafab.cli.app import Cluster, DesignFile, Json, Output, Workers, app
from metafab.cli.console import announce, exit_on_violations, progress_bars, short_of_a_turn, show
from metafab.cli.headlines import headlines


@app.command("new")
def new_command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Of the design; the file is NAME.toml.")] = None,
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="What it is.")] = None,
    library: Annotated[
        Path | None, typer.Option(metavar="UNITCELL.toml", help="Unit cell or built library [default: the paper's].")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where the files go.")] = Path(),
    json_: Json = False,
) -> None:
    """Write a commented design file to start from; without a kind, name the kinds."""
    from metafab.spec import kinds, write_new

    if name is None or kind is None:
        show(kinds(), json_)
        return
    show({"files": write_new(name, kind, output, library)}, json_)


@app.command("run")
def run_command(
    design: DesignFile, output: Output = None, workers: Workers = None, cluster: Cluster = None, json_: Json = False
) -> None:
    """Unit cell to report: every step, skipping what is up to date."""
    from metafab.run import run
    from metafab.spec import load_design

    spec = load_design(design)
    folder = output or Path("runs") / spec.name
    with progress_bars() as progress:
        outcome = run(spec, folder, workers=workers, cluster=cluster, progress=progress, say=announce)
    if built := outcome.summary["library"]:
        announce(short_of_a_turn(built["coverage_rad"]))
    show(outcome.summary if json_ else headlines(outcome.summary, folder), json_)
    exit_on_violations(outcome.violations)
