"""Mask: write it, check it."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from metafab.cli.app import Cluster, Copy, DesignFile, DesignOption, Json, LayoutFile, Output, Workers, app, open_job
from metafab.cli.console import announce, exit_on_violations, progress_bars, show


@app.command("layout")
def layout_command(
    design: DesignFile,
    output: Output = None,
    plan: Annotated[bool, typer.Option("--plan", help="Only estimate seconds, bytes and core-hours.")] = False,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Target phases to pillars to mask files."""
    from metafab import mask, steps
    from metafab.core.measure import measured

    with progress_bars() as progress:
        job = open_job(design, output, workers, cluster, progress)
        if plan:
            if not steps.library_stands(job):
                announce([f"no current library of {design}: it is built first, which is no part of the plan"])
            show(mask.plan(job.profile, steps.open_library(job), job.design), json_)
            return
        announce(mask.announcement(job.design))
        with measured() as cost:
            result = steps.write_layout(job)
    show({**result, "seconds": cost.seconds, "peak_rss_mb": cost.peak_rss_mb}, json_)


@app.command("drc")
def drc_command(
    layout: LayoutFile,
    design: DesignOption,
    engine: Annotated[
        Literal["lattice", "rectangles", "polygons"],
        typer.Option(help="On the lattice, on the file's rectangles, or by KLayout's polygon engine."),
    ] = "lattice",
    copy: Copy = 1,
    output: Output = None,
    workers: Workers = None,
    json_: Json = False,
) -> None:
    """Check the design rules on a written file; exits with 2 if any is violated."""
    from metafab import drc, mask
    from metafab.spec import load_design

    spec = load_design(design)
    with progress_bars() as progress:
        result = drc.check(layout, spec, engine=engine, workers=workers, progress=progress, copy=copy)
    if output is not None:
        drc.save([result], output, mask.top_name(spec.name))
    show(result, json_)
    exit_on_violations(sum(result.violations.values()))
