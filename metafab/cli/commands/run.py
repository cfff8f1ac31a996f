"""Commands ``new``, ``run`` and ``stokes``: the design file, the whole pipeline, and its full-Stokes sibling."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metafab.cli.app import Cluster, DesignFile, Json, Workers, app, faults_of_options, open_job
from metafab.cli.console import announce, coverage_warning, exit_on_violations, open_work, show
from metafab.cli.headlines import headlines
from metafab.cli.outputs import OutputFolder
from metafab.core.errors import InputError

if TYPE_CHECKING:
    from metafab.core.storage.rerun import Marks
    from metafab.spec import Design
    from metafab.steps import RunSummary


#: Options of ``new`` by the arguments that its faults name.
_NEW_OPTIONS = {"numerical_aperture": "--na", "aperture_um": "--aperture-um", "lens": "--na, --aperture-um"}


@app.command("new")
def new_command(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Name of the design; the file is NAME.toml.")
    ] = None,
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="Kind of device.")] = None,
    library: Annotated[
        Path | None, typer.Option(metavar="UNITCELL.toml", help="Unit cell or built library [default: the paper's].")
    ] = None,
    na: Annotated[float | None, typer.Option("--na", help="Numerical aperture of a metalens.")] = None,
    aperture_um: Annotated[float | None, typer.Option(help="Diameter of a metalens.")] = None,
    wavelength_nm: Annotated[float | None, typer.Option(help="Wavelength of a new unit cell.")] = None,
    material: Annotated[
        str | None, typer.Option(help="Pillar material: TiO2, Si, a-Si, SiN, a record, a CSV file or an index.")
    ] = None,
    substrate: Annotated[str | None, typer.Option(help="Substrate material [default: SiO2].")] = None,
    shape: Annotated[str | None, typer.Option(help="Pillar shape: rectangle, circle, ellipse, cross or ring.")] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the files.")] = Path(),
    json_: Json = False,
) -> None:
    """Write a commented design file to start from; without a kind, list the kinds.

    With --wavelength-nm and --material, a unit cell NAME_cell.toml that fits them is written, too.
    """
    from metafab.cell.starting import starting_cell
    from metafab.core.storage.files import whole_file
    from metafab.spec import kinds, write_new
    from metafab.spec.new import NewLens

    if name is None or kind is None:
        show(kinds(), json_)
        return
    files: list[Path] = []
    given = {"numerical_aperture": na, "aperture_um": aperture_um}
    stated = {key: value for key, value in given.items() if value is not None}
    lens = NewLens(**stated) if stated else None
    if any(given is not None for given in (wavelength_nm, material, substrate, shape)):
        if wavelength_nm is None or material is None or library is not None:
            expected = "--wavelength-nm and --material together for a new unit cell, or --library for one of your own"
            got = "--library beside them" if library is not None else "one of them"
            raise InputError.single("new", "unit cell", expected, got)
        library = output / f"{name}_cell.toml"
        if library.exists():
            raise InputError.single(str(library), "file", "a name that is free", "a file", "choose another name")
        cell = starting_cell(
            wavelength_nm,
            material,
            substrate=substrate or "SiO2",
            shape=shape or "rectangle",
            numerical_aperture=0.0 if lens is None else lens.numerical_aperture,
            folder=output,
        )
        with whole_file(library) as part:
            part.write_text(cell.text, encoding="utf-8")
        files = [library]
        announce(coverage_warning(cell.reach_rad))
    try:
        with faults_of_options(_NEW_OPTIONS):
            written = write_new(name, kind, output, library, lens)
    except InputError:
        for path in files:
            path.unlink()
        raise
    show({"files": [*written, *files]}, json_)


@app.command("run")
def run_command(
    design: DesignFile,
    output: OutputFolder = None,
    workers: Workers = None,
    cluster: Cluster = None,
    skip: Annotated[
        bool,
        typer.Option(
            "--skip/--no-skip", help="Leave out work that the target errors do not need; the report lists it."
        ),
    ] = True,
    json_: Json = False,
) -> None:
    """Run the whole pipeline, from unit cell to report; steps that are up to date are skipped."""
    from metafab.core.storage.limits import limited
    from metafab.core.storage.rerun import code_mark
    from metafab.run import run
    from metafab.spec import load_design

    began_ns, code = time.time_ns(), code_mark()
    spec = load_design(design)
    inputs = _input_marks(design, spec) if skip and code else None
    folder = output or Path("runs") / (spec.name if skip else f"{spec.name}_no_skip")
    with limited(**spec.stated_limits), open_work(workers, cluster) as (work, _):
        summary = run(spec, folder, work=work, skips=skip, say=announce)
    announcements = [] if summary.library is None else coverage_warning(summary.library.coverage_rad)
    for figures in (summary.layout, summary.psf, summary.lights):
        announcements += [] if figures is None else figures.warnings()
    announce(announcements)
    if inputs is not None:
        _keep_answer(design, folder, summary, announcements, code, began_ns, inputs)
    show(summary.table() if json_ else headlines(summary, folder), json_)
    exit_on_violations(summary.violations)


def _input_marks(path: Path, design: Design) -> Marks | None:
    """Marks of the input files of a design; None if one cannot be read."""
    from metafab.core.storage.provenance import named_files
    from metafab.core.storage.rerun import marks
    from metafab.spec.load import files_of

    try:
        return marks(sorted({str(each) for each in (*files_of(path), *named_files(design))}))
    except (OSError, ValueError):
        return None


def _keep_answer(
    path: Path,
    folder: Path,
    summary: RunSummary,
    announcements: list[str],
    code: str,
    began_ns: int,
    inputs: Marks,
) -> None:
    """Keep what the next run prints if nothing changes, unless a file changed during this one.

    ``inputs`` were marked before the steps, so that a change is seen even if the clock is set back.
    """
    from metafab.core.storage.rerun import Rerun, all_older, folder_marks, marks
    from metafab.run import STEPS, skipping_all

    again, place = skipping_all(summary), folder.resolve()
    try:
        made = {str((place / name).resolve()): time_ns for name, time_ns in summary.modified_ns.items()}
        read = {str(each) for step in STEPS for name in step.reads if (each := place / name).is_file()}
        files, outside = folder_marks(folder), marks(sorted(inputs.keys() | made.keys()))
        is_unchanged = all(outside[name][1] == time_ns for name, time_ns in made.items())
        is_unchanged = is_unchanged and all(outside[name] == inputs[name] for name in inputs.keys() - made.keys())
        if not is_unchanged or not all_older((inputs.keys() | read) - made.keys(), began_ns):
            return
        kept = {name: mark for name, mark in outside.items() if not name.startswith(f"{place}{os.sep}")}
        Rerun(
            name=summary.name,
            design=str(path.absolute()),
            folder=str(place),
            code=code,
            inputs=kept,
            files=files,
            summary=again.table(),
            headlines=headlines(again, folder),
            announcements=tuple(announcements),
            violations=again.violations,
        ).keep(folder)
    except (OSError, ValueError):
        return  # A file is gone, or the folder is read-only: the next run checks every step.


@app.command("stokes")
def stokes_command(
    design: DesignFile,
    output: OutputFolder = None,
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
    from metafab.steps.stokes import full_stokes

    if angles % 4:
        raise InputError.single("stokes", "--angles", "a multiple of 4, which holds both diagonals", str(angles))
    with open_work() as (work, cost):
        job = open_job(design, output, work)
        row_deg = row_angle_deg or job.design.split_angle_deg
        run = full_stokes(job, row_angle_deg=row_deg, angles=angles, size_step_nm=size_step_nm)
        file = report.stokes_figure(run.frame, run.image, job.folder / "stokes.png")
    show(run.to_json(), json_, seconds=cost.seconds, file=file)
