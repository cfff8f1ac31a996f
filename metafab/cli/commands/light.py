"""Commands ``psf`` and ``tolerance``: point-spread functions of a written mask."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

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
from metafab.cli.console import open_work, show
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
    pixel_um: Annotated[float | None, typer.Option(metavar="P", help="Sampling step [default: the sensor's].")] = None,
    window_px: Annotated[
        int | None, typer.Option(min=4, max=2048, metavar="N", help="Side of the window [default: the design's].")
    ] = None,
    target_error: TargetError = None,
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
    options = {
        "--depths-m": depths_m,
        "--object-mm": object_mm,
        "--pixel-um": pixel_um,
        "--window-px": window_px,
        "--target-error": target_error,
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
    with open_work(workers, cluster) as work, measured() as cost:
        job = open_job(design, None, work)
        verify = job.design.verify
        if calibration:
            pair = optics.calibration(job, layout, copy=copy)
        elif scene is not None:
            pair = optics.scene_pair(job, layout, load_scene(scene), copy=copy)
        else:
            pair = optics.point_spread(
                job,
                layout,
                depths_m=tuple(sorted(set(depths_m))) if depths_m else verify.depths_m,
                object_mm=object_mm or (0.0, 0.0),
                pixel_um=pixel_um,
                window_px=verify.window_px if window_px is None else window_px,
                target_error=verify.target_error if target_error is None else target_error,
                copy=copy,
            )
    if output is not None:
        optics.save_psf(job, pair, layout, output, copy)
    show(optics.PairFigures.of(pair), json_, seconds=cost.seconds, file=output)


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
    from metafab.steps.tolerance import ToleranceFigures, tolerances

    with open_work(workers, cluster) as work, measured() as cost:
        table = tolerances(open_job(design, None, work), layout, copy=copy)
    if output is not None:
        tolerance.save_tolerance(table, output, mask_sha256=file_sha256(layout))
<<<<<<< HEAD
    show(ToleranceFigures.of(table), json_, seconds=cost.seconds, file=output)
=======
    show({**tolerance.tolerance_figures(table), "seconds": cost.seconds, "file": output}, json_)


@app.command("capture")
def capture_command(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file, or a design with a scene.")],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="PSF pair over depth.")],
    output: Output = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the noise [default: the scene's].")] = None,
    frames: Annotated[int, typer.Option(min=1, metavar="N", help="A film: as many files, numbered from 1.")] = 1,
    black: Annotated[
        int, typer.Option(min=0, max=32767, metavar="COUNTS", help="Of a pixel without light [.tif, .png and .npy].")
    ] = 0,
    json_: Json = False,
) -> None:
    """Raw frame of a scene, or the frames of a film: a .h5 with the truth, or counts in a .tif, .png or .npy."""
    from metafab import steps
    from metafab.core.parallel.measure import measured
    from metafab.core.storage.files import HDF5_SUFFIXES
    from metafab.spec import load_scene

    path = output or Path("raw.h5")
    if black and path.suffix.lower() in HDF5_SUFFIXES:
        expected = "a .tif, .png or .npy file, whose counts have a black level"
        raise InputError.single("capture", "--black", expected, f"{path.name}, in electrons", "leave it out")
    counted: dict[str, float | None] = {}
    shape: tuple[int, ...] = ()
    photons: list[float] = []
    files: list[Path] = []
    with progress_bars() as progress, measured() as cost:
        for frame, file in steps.expose_film(
            load_scene(scene), psf, path, frames, seed=seed, black=black, progress=progress
        ):
            counted = _as_counted(frame, file, black)
            shape = frame.frame.shape
            photons.append(float(frame.frame.sum()))
            files.append(file)
    figures = {"photons": photons[0], "file": files[0]} if frames == 1 else {"photons": photons, "files": files}
    show({"shape": shape, **figures, **counted, "seconds": cost.seconds}, json_)


@app.command("film")
def film_command(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file, or a design with a scene.")],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="PSF pair over depth.")],
    output: Output = None,
    frames: Annotated[int | None, typer.Option(min=1, metavar="N", help="How many [default: the scene's].")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the noise [default: the scene's].")] = None,
    json_: Json = False,
) -> None:
    """Film of a moving scene, photographed, decoded frame by frame and drawn: a .gif, or .mp4 with ffmpeg."""
    from metafab import report, steps
    from metafab.core.parallel.measure import measured
    from metafab.spec import load_scene

    path = output or Path("film.gif")
    report.require_film_name(path)
    shown = load_scene(scene)
    seen = []
    with progress_bars() as progress, measured() as cost:
        for pair in steps.decoded_film(shown, psf, frames, seed=seed, progress=progress):
            seen.append(pair)
        report.write_film(seen, path, frame_interval_s=shown.frame_interval_s)
    show({**steps.film_figures(seen), "seconds": cost.seconds, "file": path}, json_)


@app.command("decode")
def decode_command(
    raw: Annotated[Path, typer.Argument(metavar="RAW", help="Raw frame: .h5, .tif, .png or .npy.")],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="Calibration.")],
    output: Output = None,
    black: Black = 0.0,
    electrons_per_count: Gain = 1.0,
    read_noise_e: ReadNoise = 0.0,
    white: White = None,
    json_: Json = False,
) -> None:
    """4D image of a raw frame: both intensities, contrast and depth."""
    from metafab import steps
    from metafab.core.storage.files import require_hdf5_name

    path = output or Path("decoded.h5")
    require_hdf5_name(path)
    with progress_bars() as progress:
        counts = _counts(black, electrons_per_count, read_noise_e, white)
        image = steps.restore(raw, psf, path, counts=counts, progress=progress)
    if image.figures.reason is not None:
        announce([f"{raw}: {image.figures.reason}; the image is empty"])
    if image.figures.warning is not None:
        announce([f"{raw}: {image.figures.warning}"])
    figures = {**image.figures.known(), "segments": image.segments, "file": path}
    if image.nmae is not None:
        figures["nmae"] = image.nmae
    show(figures, json_)


@app.command("calibrate")
def calibrate_command(
    frames: Annotated[
        list[Path], typer.Argument(metavar="FRAMES...", help="A point on the axis: .h5, .tif, .png, .npy.")
    ],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="Prediction from the mask.")],
    depths: Annotated[Path, typer.Option("--depths", metavar="DEPTHS.csv", help="Lines `frame, depth in m`.")],
    output: Output = None,
    black: Black = 0.0,
    electrons_per_count: Gain = 1.0,
    read_noise_e: ReadNoise = 0.0,
    white: White = None,
    json_: Json = False,
) -> None:
    """Calibration of a camera from photographs of a point at known depths."""
    from dataclasses import asdict

    from metafab import decode, steps
    from metafab.core.storage.files import require_hdf5_name

    path = output or Path("calibrated.h5")
    require_hdf5_name(path)
    fit = steps.calibrate(frames, depths, psf, path, counts=_counts(black, electrons_per_count, read_noise_e, white))
    announce([f"not told apart: {decode.NOT_SEPARATED}"])
    show({**asdict(fit), "not_separated": decode.NOT_SEPARATED, "frames": len(frames), "file": path}, json_)
>>>>>>> 699f181 (wip decode)
