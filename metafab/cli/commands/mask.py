"""Commands ``layout`` and ``drc``: write a mask, and check it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from metafab.cli.app import (
    Cluster,
    Copy,
    DesignFile,
    DesignOption,
    Json,
    LayoutFile,
    Workers,
    app,
    faults_of_options,
    open_job,
)
from metafab.cli.console import announce, exit_on_violations, open_work, show
from metafab.cli.outputs import OutputFolder
from metafab.core.errors import InputError

if TYPE_CHECKING:
    from metafab.drc import DrcReport
    from metafab.library import Library
    from metafab.steps.job import Job

#: Places of each violated rule in the text of a check.
_SHOWN_PLACES = 10


@app.command("layout")
def layout_command(
    design: DesignFile,
    output: OutputFolder = None,
    plan: Annotated[bool, typer.Option("--plan", help="Only estimate seconds, bytes and core-hours.")] = False,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Map the target phases to pillars and write the mask files."""
    from metafab import mask
    from metafab.steps import preflight, write_layout
    from metafab.steps.layout import light_targets
    from metafab.steps.preflight import too_steep

    with open_work(workers, cluster) as (work, cost):
        job = open_job(design, output, work)
        preflight(job.design)
        if plan:
            if cluster is not None:
                expected, remedy = "`--workers` with the cluster's cores", "a plan is made on one machine"
                raise InputError.single("--cluster", "plan", expected, repr(cluster), remedy)
            library = _library_for_plan(job)
            show(mask.plan(job.profile, library, job.design, workers, lights=light_targets(job)), json_)
            return
        announce([*too_steep(job), *mask.announcement(job.design)])
        figures = write_layout(job)
    announce(figures.warnings())
    show(figures, json_, seconds=cost.seconds, peak_rss_mb=cost.peak_rss_mb)


def _library_for_plan(job: Job) -> Library:
    """Library of the design; for one light an outdated one serves too, as sizes and bytes are nearly equal."""
    from metafab import library
    from metafab.steps.library import library_is_current, library_path, open_library

    if job.design.light:
        announce(["libraries of its wavelengths that are not current are built first, which is no part of the plan"])
        return open_library(job)
    if not library_is_current(job):
        path = library_path(job)
        with suppress(InputError):
            outdated = library.load(path)
            announce([f"{path} is not current: the plan is made with it as it is"])
            return outdated
        announce([f"no library at {path}: it is built first, which is no part of the plan"])
    return open_library(job)


@app.command("drc")
def drc_command(
    layout: LayoutFile,
    design: DesignOption,
    engine: Annotated[
        Literal["lattice", "rectangles", "polygons"],
        typer.Option(help="Check on the lattice, on the file's rectangles, or with KLayout's polygon engine."),
    ] = "lattice",
    copy: Copy = 1,
    output: OutputFolder = None,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Check the design rules on a written file; exit with 2 if any is violated.

    The text lists the first ten places of each rule; --json, and the files of -o, list the first 1000.
    """
    from metafab import drc, mask
    from metafab.spec import load_design

    spec = load_design(design)
    with open_work(workers, cluster) as (work, _), faults_of_options({"engine": "--engine"}):
        report = drc.check(layout, spec, engine=engine, work=work, copy=copy)
    if output is not None:
        drc.save([report], output, mask.top_name(spec.name))
    announce(report.warnings())
    show(report if json_ else with_first_places(report), json_)
    exit_on_violations(sum(report.violations.values()))


def with_first_places(report: DrcReport) -> DrcReport:
    """The report with ten places of each rule, so that its figures stay on the screen."""
    return replace(report, markers={rule: places[:_SHOWN_PLACES] for rule, places in report.markers.items()})
