"""Commands ``psf``, ``psf import`` and ``tolerance``: point-spread functions of a written mask, or measured ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from metafab.cli.app import (
    Cluster,
    Copy,
    DesignOption,
    Json,
    LayoutFile,
    TargetError,
    Workers,
    app,
    faults_of_options,
    open_job,
    require_finite,
    require_positive,
)
from metafab.cli.console import announce, open_work, show
from metafab.cli.outputs import Hdf5Output, NamedHdf5Output, Output, require_file_output
from metafab.core.errors import InputError

if TYPE_CHECKING:
    from metafab.core.conventions import FloatArray
    from metafab.optics import Psf
    from metafab.steps.exposure import Printed
    from metafab.steps.job import Job
    from metafab.steps.optics import WrittenLens


#: Options of ``psf import`` by the arguments that its faults name.
_OPTIONS = {
    "names": "--dataset",
    "depths": "--depths",
    "centring": "--centre",
    "zero_m": "--zero-m",
    "split_um": "--split-um",
    "split_lens": "--split-lens",
    "distance_mm": "--distance-mm",
}


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
    wavelength_nm: Annotated[
        float | None,
        typer.Option(
            metavar="L", help="One of the wavelengths in the design's [[light]] tables [default: the unit cell's]."
        ),
    ] = None,
    angle_deg: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="X Y",
            help="Direction of one of the [[light]] tables, in the medium of incidence [default: along the axis].",
        ),
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
    output: Hdf5Output = None,
    json_: Json = False,
) -> None:
    """Compute the PSF pair of a written mask over depth."""
    from metafab.spec import load_scene
    from metafab.steps import optics
    from metafab.steps.images import of_scene_file
    from metafab.steps.job import light_tangent

    lens = _lens(layout, copy, printed, sizes, ideal=ideal)
    whole = {"--calibration": calibration or None, "--scene": scene}
    single = {
        "--depths-m": depths_m,
        "--object-mm": object_mm,
        "--angle-deg": angle_deg,
        "--centre-um": centre_um,
        "--pixel-um": pixel_um,
        "--window-px": window_px,
        "--target-error": target_error,
        "--sizes": sizes,
    }
    _require_compatible(single, whole)
    require_positive("--depths-m", *(depth for depth in depths_m or () if depth != math.inf))
    require_positive("--pixel-um", pixel_um)
    require_positive("--wavelength-nm", wavelength_nm)
    require_finite("--object-mm", *(object_mm or ()))
    require_finite("--centre-um", *(centre_um or ()))
    light_at_um = None
    with open_work(workers, cluster) as (work, cost):
        job = _at_light(open_job(design, None, work), wavelength_nm, angle_deg)
        if calibration:
            pair = optics.calibration(job, lens)
        elif scene is not None:
            photographed = load_scene(scene)
            with of_scene_file(scene, photographed):
                pair = optics.scene_pair(job, lens, photographed)
        else:
            options = {name.removeprefix("--").replace("-", "_"): name for name in single if single[name] is not None}
            with faults_of_options(options):
                pair, light_at_um = optics.point_spread(
                    job,
                    lens,
                    depths_m=tuple(sorted(set(depths_m))) if depths_m else None,
                    object_mm=object_mm or (0.0, 0.0),
                    pixel_um=pixel_um,
                    window_px=window_px,
                    target_error=target_error,
                    centre_um=centre_um,
                    tangent=None if job.light is None or angle_deg is None else light_tangent(job.design, job.light),
                )
    if output is not None:
        optics.save_psf(job, pair, lens, output)
    figures = optics.pair_figures(job, pair, light_at_um, lens)
    announce(figures.warnings())
    show(figures, json_, **neighbour_figures(job, pair), seconds=cost.seconds, file=output)


def _lens(
    layout: Path | None, copy: int, printed: Printed | None, sizes: Path | None, *, ideal: bool
) -> WrittenLens | None:
    """The lens that the options name; None for the target phases."""
    from metafab.steps.optics import WrittenLens

    if ideal == (layout is not None):
        raise InputError.single("psf", "LAYOUT", "a mask file, or --ideal in its place", "both" if ideal else "neither")
    if printed is not None and ideal:
        raise InputError.single("psf", "--printed", "a mask file", "--ideal", "name the mask")
    if sizes is not None and (ideal or printed is not None):
        given = "--ideal" if ideal else "--printed"
        raise InputError.single("psf", "--sizes", "a mask file, and no other sizes", given, f"leave {given} out")
    return None if layout is None else WrittenLens(layout, copy, printed, sizes)


def _require_compatible(single: Mapping[str, object], whole: Mapping[str, object]) -> None:
    """Check that options for one place of the object are given alone, or one for a whole scene; None is not given."""
    given, wholes = ([name for name, value in each.items() if value is not None] for each in (single, whole))
    if wholes and len(given) + len(wholes) > 1:
        expected = "none of the options that it sets itself"
        raise InputError.single("psf", wholes[-1], expected, ", ".join(given + wholes))
    if {"--object-mm", "--angle-deg"} <= {*given}:
        raise InputError.single("psf", "--object-mm", "the place of the object, or --angle-deg", "both")


def neighbour_figures(job: Job, pair: Psf) -> dict[str, Any]:
    """Whether the model of neighbours gave the light of the pillars, and its error, which ``error`` does not hold."""
    from metafab.steps import open_library

    known = None if pair.neighbours is None else open_library(job).neighbours
    if known is None:
        return {"with_neighbours": False}
    return {"with_neighbours": True, "neighbour_error": known.overall.error_alike}


def _at_light(job: Job, wavelength_nm: float | None, angle_deg: tuple[float, float] | None) -> Job:
    """The job in one of the lights that its design serves; unchanged where neither option is given."""
    from metafab.spec.light import light_label

    if wavelength_nm is None and angle_deg is None:
        return job
    own_nm = job.design.unit_cell.illumination.wavelength_nm
    key = (own_nm if wavelength_nm is None else wavelength_nm, *(angle_deg or (0.0, 0.0)))
    for light in job.design.light:
        if light.key == key:
            return job.at_light(light)
    option = "--wavelength-nm" if angle_deg is None else "--angle-deg"
    listed = "; ".join(light.label for light in job.design.light)
    expected = f"one of the design's `light` tables ({listed or 'it has none'})"
    raise InputError.single("psf", option, expected, light_label(*key), "add a [[light]] to the design")


@app.command("psf import")
def import_command(
    stack: Annotated[Path, typer.Argument(metavar="STACK", help="Pictures of a point: .mat, .h5, .npy or .tif.")],
    depths: Annotated[
        list[str], typer.Option("--depths", metavar="Z ...", help="Depths in m, or a .csv or .npy file of them.")
    ],
    pixel_um: Annotated[float, typer.Option("--pixel-um", metavar="P", help="Pixel pitch of the pictures.")],
    split_um: Annotated[
        tuple[float, float] | None,
        typer.Option("--split-um", metavar="X Y", help="From the x to the y image on the sensor [default: assumed]."),
    ] = None,
    distance_mm: Annotated[
        float | None, typer.Option("--distance-mm", metavar="D", help="From the lens to the sensor [default: assumed].")
    ] = None,
    zero_m: Annotated[
        float | None,
        typer.Option("--zero-m", metavar="Z", help="Distance from the lens of depth 0 [default: 0, or assumed]."),
    ] = None,
    channels: Annotated[
        int | None, typer.Option(min=1, max=2, metavar="N", help="Channels to expect [default: the file's].")
    ] = None,
    datasets: Annotated[
        list[str] | None,
        typer.Option("--dataset", metavar="NAME", help="Name of the array in a .mat or .h5; one for each channel."),
    ] = None,
    centring: Annotated[
        Literal["auto", "mass", "brightest", "turn", "none"],
        typer.Option("--centre", help="Centre: of mass, main lobe, the circle on which it turns, or the picture."),
    ] = "auto",
    sampled: Annotated[
        bool, typer.Option("--sampled", help="Values are samples at pixel centres, not integrals over pixels.")
    ] = False,
    split_lens: Annotated[
        bool, typer.Option("--split-lens", help="Images of a lens that splits by a grating along x: with distortion.")
    ] = False,
    first_row: Annotated[
        Literal["top", "bottom"], typer.Option("--first-row", help="Side of the pictures' first row.")
    ] = "top",
    output: NamedHdf5Output = Path("psf.h5"),
    json_: Json = False,
) -> None:
    """Make a PSF pair for the decoder from pictures of a point at known depths."""
    from metafab import optics
    from metafab.core.storage.files import file_sha256, fingerprint, plain
    from metafab.optics.measured_stack import psf_of_stack
    from metafab.optics.stack_files import lowest_row_first, read_stack

    require_file_output(output, map(Path, depths))
    require_positive("--pixel-um", pixel_um)
    require_positive("--distance-mm", distance_mm)
    require_finite("--split-um", *(split_um or ()))
    require_finite("--zero-m", zero_m)
    depth_m = _depths_m(depths)
    with faults_of_options(_OPTIONS, str(stack)):
        values = read_stack(stack, len(depth_m), datasets or ())
        if channels is not None and channels != len(values):
            remedy = "name them with --dataset"
            raise InputError.single(str(stack), "--channels", f"{channels}", f"{len(values)}", remedy)
        psf, figures = psf_of_stack(
            lowest_row_first(values) if first_row == "top" else values,
            depth_m,
            pixel_um,
            split_um=split_um,
            distance_mm=distance_mm,
            zero_m=zero_m,
            centring=centring,
            integrated=not sampled,
            split_lens=split_lens,
        )
    optics.save(psf, output, inputs_sha256=fingerprint(file_sha256(stack), plain(figures)))
    announce([*(f"made: {sentence}" for sentence in figures.made), *figures.warnings])
    show(figures, json_, file=output)


def _depths_m(words: list[str]) -> FloatArray:
    """Depths of ``--depths``: numbers, or the name of one file."""
    import numpy as np

    from metafab.optics.stack_files import read_depths

    try:
        return np.array([float(word) for word in words])
    except ValueError:
        if len(words) > 1:
            expected, got = "numbers, or one file of them", ", ".join(words[:4])
            raise InputError.single("--depths", "depths", expected, got) from None
        return read_depths(Path(words[0]))


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
    folder, the report of the next `metafab run` shows the table.
    """
    from metafab import tolerance
    from metafab.core.storage.files import file_sha256
    from metafab.steps.tolerance import tolerances

    with open_work(workers, cluster) as (work, cost):
        table = tolerances(open_job(design, None, work), layout, copy=copy)
    if output is not None:
        tolerance.save_tolerance(table, output, mask_sha256=file_sha256(layout))
    show(table, json_, seconds=cost.seconds, file=output)
