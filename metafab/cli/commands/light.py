"""Commands ``psf`` and ``tolerance``: point-spread functions of a written mask."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from metafab.cli.app import (
    Cluster,
    Copy,
    DesignOption,
    Json,
    LayoutFile,
    Output,
    TargetError,
    Workers,
    app,
    open_job,
    require_finite,
    require_positive,
)
from metafab.cli.console import announce, open_work, show
from metafab.core.errors import InputError


@app.command("psf")
def psf_command(
    design: DesignOption,
    layout: Annotated[Path | None, typer.Argument(metavar="LAYOUT", help="Written mask, .gds or .oas.")] = None,
    ideal: Annotated[bool, typer.Option("--ideal", help="Use the target phases, without a mask.")] = False,
    depths_m: Annotated[
        list[float] | None,
        typer.Option(metavar="Z ...", help="Object depths, `inf` for far away [default: the design's]."),
    ] = None,
    calibration: Annotated[
        bool, typer.Option("--calibration", help="All depths and directions of the design's scene, for a decoder.")
    ] = False,
    scene: Annotated[
        Path | None,
        typer.Option("--scene", metavar="SCENE.toml", help="Exact depths and directions of this scene, for capture."),
    ] = None,
    object_mm: Annotated[
        tuple[float, float] | None, typer.Option(metavar="X Y", help="Object position from the axis.")
    ] = None,
    centre_um: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Centre of the window on the sensor, from the axis [default: image point]."),
    ] = None,
    pixel_um: Annotated[float | None, typer.Option(metavar="P", help="Sampling step [default: the sensor's].")] = None,
    window_px: Annotated[
        int | None, typer.Option(min=4, max=2048, metavar="N", help="Side of the window [default: the design's].")
    ] = None,
    target_error: TargetError = None,
    printed: Annotated[
        Literal["plain", "corrected"] | None,
        typer.Option("--printed", help="Pillars as the design's [process] makes them, with one or corrected doses."),
    ] = None,
    sizes: Annotated[
        Path | None, typer.Option("--sizes", metavar="SEM.csv", help="Measured sizes: x_um, y_um, width_nm, length_nm.")
    ] = None,
    copy: Copy = 1,
    workers: Workers = None,
    cluster: Cluster = None,
    output: Output = None,
    json_: Json = False,
) -> None:
    """Compute the PSF pair of a written mask over depth."""
    from metafab.core.parallel.measure import measured
    from metafab.core.storage.files import require_hdf5_name
    from metafab.spec import load_scene
    from metafab.steps import optics

    if output is not None:
        require_hdf5_name(output)
    if ideal == (layout is not None):
        raise InputError.single("psf", "LAYOUT", "a mask file, or --ideal in its place", "both" if ideal else "neither")
    if printed is not None and ideal:
        raise InputError.single("psf", "--printed", "a mask file", "--ideal", "name the mask")
    if sizes is not None and (ideal or printed is not None):
        given = "--ideal" if ideal else "--printed"
        raise InputError.single("psf", "--sizes", "a mask file, and no other sizes", given, f"leave {given} out")
    options = {
        "--depths-m": depths_m,
        "--object-mm": object_mm,
        "--centre-um": centre_um,
        "--pixel-um": pixel_um,
        "--window-px": window_px,
        "--target-error": target_error,
        "--sizes": sizes,
        "--calibration": calibration or None,
        "--scene": scene,
    }
    present = [name for name, value in options.items() if value is not None]
    if len(present) > 1 and (calibration or scene is not None):
        whole = "--scene" if scene is not None else "--calibration"
        raise InputError.single("psf", whole, "no option that it answers itself", ", ".join(present))
    require_positive("--depths-m", *(depth for depth in depths_m or () if depth != math.inf))
    require_positive("--pixel-um", *([] if pixel_um is None else [pixel_um]))
    require_finite("--object-mm", *(object_mm or ()))
    require_finite("--centre-um", *(centre_um or ()))
    with open_work(workers, cluster) as work, measured() as cost:
        job = open_job(design, None, work)
        verify, light_at_um = job.design.verify, None
        if calibration:
            pair = optics.calibration(job, layout, copy=copy, printed=printed)
        elif scene is not None:
            pair = optics.scene_pair(job, layout, load_scene(scene), copy=copy, printed=printed)
        else:
            pair, light_at_um = optics.point_spread(
                job,
                layout,
                depths_m=tuple(sorted(set(depths_m))) if depths_m else verify.depths_m,
                object_mm=object_mm or (0.0, 0.0),
                pixel_um=pixel_um,
                window_px=verify.window_px if window_px is None else window_px,
                target_error=verify.target_error if target_error is None else target_error,
                copy=copy,
                centre_um=centre_um,
                printed=printed,
                sizes=sizes,
            )
    if output is not None:
        optics.save_psf(job, pair, layout, output, copy, printed, sizes)
    figures = optics.PairFigures.of(pair, light_at_um)
    announce(figures.warnings())
    show(figures, json_, seconds=cost.seconds, file=output)


@app.command("tolerance")
def tolerance_command(
    layout: LayoutFile,
    design: DesignOption,
    copy: Copy = 1,
    output: Output = None,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Compute the effect of fabrication errors on a written mask's PSFs, efficiency and depth.

    The design's [tolerance] sets the errors; defaults apply without it. With ``-o DIR/tolerance.json`` in a run
    folder, the next report shows the table.
    """
    from metafab import tolerance
    from metafab.core.parallel.measure import measured
    from metafab.core.storage.files import file_sha256
    from metafab.steps.tolerance import tolerances

    with open_work(workers, cluster) as work, measured() as cost:
        table = tolerances(open_job(design, None, work), layout, copy=copy)
    if output is not None:
        tolerance.save_tolerance(table, output, mask_sha256=file_sha256(layout))
    show(table, json_, seconds=cost.seconds, file=output)
