"""Mask: write it, check it."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from metafab.cli.app import Cluster, Copy, DesignFile, DesignOption, Json, LayoutFile, Output, Workers, app, open_job
from metafab.cli.console import announce, exit_on_violations, progress_bars, show
from metafab.core.errors import InputError

if TYPE_CHECKING:
    from metafab.library import Library
    from metafab.steps.job import Job


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
    from metafab.core.parallel.measure import measured

    with progress_bars() as progress:
        job = open_job(design, output, workers, cluster, progress)
        steps.preflight(job.design)
        if plan:
            if cluster is not None:
                expected, remedy = "`--workers` with the cluster's cores", "a plan is made on one machine"
                raise InputError.single("--cluster", "plan", expected, repr(cluster), remedy)
            show(mask.plan(job.profile, _library_for_a_plan(job), job.design, workers), json_)
            return
        announce(mask.announcement(job.design))
        with measured() as cost:
            result = steps.write_layout(job)
    show({**result, "seconds": cost.seconds, "peak_rss_mb": cost.peak_rss_mb}, json_)


def _library_for_a_plan(job: Job) -> Library:
    """The design's library; one of an earlier version will do, for sizes and bytes are nearly the same."""
    from metafab import library, steps

    if not steps.library_stands(job):
        path = steps.library_path(job)
        with suppress(InputError):
            found = library.load(path)
            announce([f"{path} is not current: the plan is made with it as it is"])
            return found
        announce([f"no library at {path}: it is built first, which is no part of the plan"])
    return steps.open_library(job)


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
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Check the design rules on a written file; exits with 2 if any is violated."""
    from metafab import drc, mask
    from metafab.spec import load_design

    spec = load_design(design)
    with progress_bars() as progress:
        result = drc.check(layout, spec, engine=engine, workers=workers, cluster=cluster, progress=progress, copy=copy)
    if output is not None:
        drc.save([result], output, mask.top_name(spec.name))
    show(result, json_)
    exit_on_violations(sum(result.violations.values()))
