"""Full-wave checks of a written mask: rows of one local period, and patches."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from metafab.cli.app import DesignOption, Json, LayoutFile, Output, app, open_job, require_positive
from metafab.cli.console import progress_bars, show
from metafab.core.errors import InputError

#: A simulation that takes so many times as long as was foreseen is ended.
_PATIENCE = 20.0

Polarisations = Annotated[Literal["x", "y", "both"], typer.Option(help="Of the incident light.")]


@app.command("coupling")
def coupling_command(
    layout: LayoutFile,
    design: DesignOption,
    at_um: Annotated[list[str], typer.Option(metavar="X,Y", help="Middle of a row; again for more.")],
    axis: Annotated[Literal["x", "y"], typer.Option(help="Along which the rows lie.")] = "x",
    solver: Annotated[Literal["rcwa", "meep", "both"], typer.Option(help="Full-wave solver.")] = "rcwa",
    polarisation: Polarisations = "both",
    pixels_per_period: Annotated[int, typer.Option(min=8, help="Grid of Meep.")] = 16,
    output: Output = None,
    json_: Json = False,
) -> None:
    """Rows of one local period, taken from a written mask: what the local-period approximation misses.

    In a run folder, ``-o DIR/coupling.json`` puts the result into the error budget of its next run.
    """
    from metafab import fullwave, mask, steps
    from metafab.cell.meep import SupercellSettings
    from metafab.core.parallel.measure import measured
    from metafab.core.storage.files import file_sha256

    with progress_bars() as progress, measured() as cost:
        job = open_job(design, None, None, None, progress)
        found = fullwave.measure_coupling(
            mask.read(layout, job.design, progress=progress).pillars,
            steps.open_library(job),
            [_place(text) for text in at_um],
            file_sha256(layout),
            axis=axis,
            solvers=("rcwa", "meep") if solver == "both" else (solver,),
            polarisations=("x", "y") if polarisation == "both" else (polarisation,),
            meep=SupercellSettings(pixels_per_period),
            progress=progress,
        )
    if output is not None:
        fullwave.save_coupling(found, output)
    figures = {"coupling_error": found.coupling_error, "efficiency_ratio": found.efficiency_ratio}
    show({**figures, "rows": found.rows, "seconds": cost.seconds, "file": output}, json_)


@app.command("patch")
def patch_command(
    layout: LayoutFile,
    design: DesignOption,
    at_um: Annotated[tuple[float, float], typer.Option(metavar="X Y", help="Middle of the patch.")],
    size_um: Annotated[float, typer.Option(metavar="S", help="Side of the patch.")],
    polarisation: Annotated[Literal["x", "y"], typer.Option(help="Of the incident light.")] = "x",
    pixels_per_period: Annotated[int, typer.Option(min=8, help="Grid of Meep.")] = 12,
    padding_sites: Annotated[int, typer.Option(min=0, help="Neighbours simulated on each side.")] = 3,
    limit_min: Annotated[float, typer.Option(min=0.0, help="Longer simulations are refused.")] = 30.0,
    limit_mb: Annotated[float, typer.Option(min=0.0, help="Larger simulations are refused.")] = 8000.0,
    force: Annotated[bool, typer.Option("--force", help="Simulate whatever it takes.")] = False,
    output: Output = None,
    json_: Json = False,
) -> None:
    """Simulate a square patch of a written mask by Meep, and compare its field with the library's.

    In a run folder, ``-o DIR/patch.h5`` puts the fields into its report.
    """
    from metafab import fullwave, mask, steps
    from metafab.cell.meep import Pool, SupercellSettings
    from metafab.cell.meep.pool import own_folder
    from metafab.core.storage.files import file_sha256, fingerprint

    require_positive("--size-um", size_um)
    path = output or Path("patch.h5")
    with progress_bars() as progress:
        job = open_job(design, None, None, None, progress)
        opened = steps.open_library(job)
        plan = fullwave.plan_patch(
            mask.read(layout, job.design, progress=progress).pillars,
            opened,
            at_um,
            size_um,
            padding_sites=padding_sites,
            settings=SupercellSettings(pixels_per_period, decay=fullwave.PATCH_DECAY),
        )
        rows, columns = plan.supercell.shape
        cost = f"about {plan.seconds / 60.0:.2g} min and {plan.memory_mb:.2g} MB"
        print(f"metafab: {columns} x {rows} pillars, {plan.pixels:.2g} pixels, {cost}", file=sys.stderr)
        if not force and (plan.seconds > 60.0 * limit_min or plan.memory_mb > limit_mb):
            raise InputError.single(
                "patch", "size_um", f"at most {limit_min:g} min and {limit_mb:g} MB", cost,
                "make it smaller or its grid coarser, raise the limits, or give --force",
            )  # fmt: skip
        with Pool(1, limit_s=max(3600.0, _PATIENCE * plan.seconds), keep=own_folder()) as pool:
            patch = fullwave.solve_patch(plan, opened, polarisation, pool, progress)
    fullwave.save_patch(patch, path, inputs_sha256=fingerprint(file_sha256(layout), at_um, size_um, polarisation))
    show(
        {
            "pillars": patch.full_wave.size,
            **patch.figures(),
            "polarisation": polarisation,
            "decay": patch.decay,
            "seconds": patch.seconds,
            "estimate": {"pixels": plan.pixels, "seconds": plan.seconds, "memory_mb": plan.memory_mb},
            "numerics": {"pixels_per_period": pixels_per_period, "padding_sites": padding_sites},
            "file": path,
        },
        json_,
    )


def _place(text: str) -> tuple[float, float]:
    """``"600,-200"`` as two numbers."""
    try:
        x, y = (float(number) for number in text.split(","))
    except ValueError:
        raise InputError.single("coupling", "--at-um", "two numbers X,Y", text) from None
    return x, y
