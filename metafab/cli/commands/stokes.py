"""Full-Stokes imaging: all of polarisation from one frame."""

from __future__ import annotations

from typing import Annotated

import typer

from metafab.cli.app import DesignFile, Json, Output, app, open_job
from metafab.cli.console import open_work, show


@app.command("stokes")
def stokes_command(
    design: DesignFile,
    output: Output = None,
    row_angle_deg: Annotated[
        float | None,
        typer.Option(min=0.5, max=40.0, help="Angle between rows of images, degrees [default: the split angle]."),
    ] = None,
    angles: Annotated[int, typer.Option(min=4, max=64, help="Pillar angles in half a turn, a multiple of 4.")] = 16,
    size_step_nm: Annotated[
        float, typer.Option(min=1.0, help="Step of pillar sizes, nm, rounded up to the library's grid.")
    ] = 10.0,
    json_: Json = False,
) -> None:
    """Simulate full-Stokes imaging with a camera design: turned pillars, six images, Stokes vectors and depth."""
    from metafab import report
    from metafab.core.errors import InputError
    from metafab.steps.stokes import full_stokes

    if angles % 4:
        raise InputError.single("stokes", "--angles", "a multiple of 4, which holds both diagonals", str(angles))
    with open_work() as (work, cost):
        job = open_job(design, output, work)
        row_deg = row_angle_deg or job.design.split_angle_deg
        run = full_stokes(job, row_angle_deg=row_deg, angles=angles, size_step_nm=size_step_nm)
        file = report.stokes_figure(run.frame, run.image, job.folder / "stokes.png")
    show(run.to_json(), json_, seconds=cost.seconds, file=file)
