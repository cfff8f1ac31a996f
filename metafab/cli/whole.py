"""The whole job."""

from __future__ import annotations

from pathlib import Path

from metafab.cli.app import Cluster, DesignFile, Json, Output, Workers, app
from metafab.cli.console import exit_on_violations, progress_bars, show


@app.command("run")
def run_command(
    design: DesignFile, output: Output = None, workers: Workers = None, cluster: Cluster = None, json_: Json = False
) -> None:
    """Unit cell to report: every step, skipping what is up to date."""
    from metafab.run import run
    from metafab.spec import load_design

    spec = load_design(design)
    with progress_bars() as progress:
        outcome = run(spec, output or Path("runs") / spec.name, workers=workers, cluster=cluster, progress=progress)
    show(outcome.summary, json_)
    exit_on_violations(outcome.violations)
