"""The command line: one thin function a step, and the only place that draws bars and exits.

Exit codes: 0 done; 1 failed; 2 bad input or rules violated. With ``--json``, stdout holds one JSON object and
nothing else; progress goes to stderr, and only on a terminal.
"""

from __future__ import annotations

import json
import math
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from metafab.core.errors import InputError, MetafabError

if TYPE_CHECKING:
    from types import FrameType

    from metafab.core.progress import Progress
    from metafab.run import Job
    from metafab.spec import Design

HELP = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    help="From unit cell to mask to decoded image.",
    context_settings=HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
library_app = typer.Typer(
    help="Build, check and show phase libraries.", context_settings=HELP, no_args_is_help=True, rich_markup_mode=None
)
app.add_typer(library_app, name="library")

DesignFile = Annotated[Path, typer.Argument(metavar="DESIGN.toml", help="Design file.")]
DesignOption = Annotated[Path, typer.Option("--design", metavar="DESIGN.toml", help="Design file.")]
UnitCellFile = Annotated[Path, typer.Argument(metavar="UNITCELL.toml", help="Unit-cell file.")]
LayoutFile = Annotated[Path, typer.Argument(metavar="LAYOUT", help="Written mask, .gds or .oas.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="PATH", help="Where the result goes.")]
Workers = Annotated[int | None, typer.Option("--workers", min=1, metavar="N", help="Processes [default: the cores].")]
Cluster = Annotated[str | None, typer.Option("--cluster", metavar="ADDRESS", help="Dask scheduler to use instead.")]
TargetError = Annotated[
    float | None,
    typer.Option("--target-error", metavar="E", help="Largest error wanted.", min=1e-12, max=0.999),
]


# --- the whole job ---------------------------------------------------------------------------------------------


@app.command("run")
def run_command(
    design: DesignFile, output: Output = None, workers: Workers = None, cluster: Cluster = None, json_: Json = False
) -> None:
    """Unit cell to report: every step, skipping what is up to date."""
    from metafab.run import run
    from metafab.spec import load_design

    spec = load_design(design)
    with _progress() as progress:
        outcome = run(spec, output or Path("runs") / spec.name, workers=workers, cluster=cluster, progress=progress)
    _show(outcome.summary, json_)
    _exit_on_violations(outcome.violations)


# --- unit cell and library -------------------------------------------------------------------------------------


@app.command("cell")
def cell_command(
    unit_cell: UnitCellFile,
    width_nm: Annotated[float, typer.Option(min=0.0, help="Pillar size along x.")],
    length_nm: Annotated[float, typer.Option(min=0.0, help="Pillar size along y.")],
    wavelength_nm: Annotated[float | None, typer.Option(help="Vacuum wavelength [default: the file's].")] = None,
    angle_deg: Annotated[float, typer.Option(help="Polar angle of incidence, in the incident medium.")] = 0.0,
    azimuth_deg: Annotated[float, typer.Option(help="Azimuth of incidence from +x.")] = 0.0,
    solver: Annotated[Literal["rcwa", "meep"] | None, typer.Option(help="Solver [default: the file's].")] = None,
    target_error: TargetError = None,
    json_: Json = False,
) -> None:
    """Solve one unit cell."""
    from metafab import cell
    from metafab.spec import load_unit_cell

    spec = load_unit_cell(unit_cell)
    name = solver or spec.solver.name
    problem = cell.pillar_cell(
        spec, width_nm, length_nm, wavelength_nm=wavelength_nm, angle_deg=angle_deg, azimuth_deg=azimuth_deg
    )
    numerics = cell.CellNumerics(target_error=target_error or spec.sweep.target_error, solver=name)
    answer = cell.solve(problem, numerics)
    (t_xx, t_xy), (t_yx, t_yy) = answer.t
    transmittance_x, transmittance_y = answer.transmittance
    _show(
        {
            "t_xx": complex(t_xx),
            "t_yy": complex(t_yy),
            "t_xy": complex(t_xy),
            "t_yx": complex(t_yx),
            "r_xx": complex(answer.r[0, 0]),
            "r_yy": complex(answer.r[1, 1]),
            "transmittance_x": transmittance_x,
            "transmittance_y": transmittance_y,
            "error": answer.error,
            "target_error": numerics.target_error,
            "converged": answer.converged,
            "orders" if name == "rcwa" else "resolution": answer.resolution,
            "seconds": answer.seconds,
            "solver": name,
            "details": answer.details,
        },
        json_,
    )


@library_app.command("build")
def library_build(
    unit_cell: UnitCellFile,
    output: Output = None,
    target_error: TargetError = None,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Sweep width and length until every size is known to the asked error."""
    from metafab import library
    from metafab.core.executor import open_executor
    from metafab.core.measure import measured
    from metafab.spec import load_unit_cell

    spec = load_unit_cell(unit_cell)
    path = output or unit_cell.with_suffix(".h5")
    with _progress() as progress, measured() as cost, open_executor(workers, cluster) as executor:
        built = library.build_file(spec, path, target_error=target_error, executor=executor, progress=progress)
    _show({"file": path, **library.quality(built), **built.details, "seconds": cost.seconds}, json_)


@library_app.command("check")
def library_check(
    file: Annotated[Path, typer.Argument(metavar="LIB.h5")],
    against: Annotated[Literal["rcwa", "meep"], typer.Option(help="meep, or rcwa at a finer error.")] = "rcwa",
    samples: Annotated[int, typer.Option(min=1, help="Held-out sizes.")] = 10,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Solve held-out sizes again with the other or a finer solver."""
    from metafab import library
    from metafab.core.executor import open_executor

    opened = library.load(file)
    with _progress() as progress, open_executor(workers, cluster) as executor:
        result = library.check(
            opened, against=against, samples=samples, seed=seed, executor=executor, progress=progress
        )
    _show(result, json_)


@library_app.command("show")
def library_show(
    file: Annotated[Path, typer.Argument(metavar="LIB.h5")], output: Output = None, json_: Json = False
) -> None:
    """Draw phase and transmittance against width and length."""
    from metafab import library, report

    path = output or file.with_suffix(".png")
    report.library_figure(library.load(file), path)
    _show({"file": path}, json_)


# --- mask --------------------------------------------------------------------------------------------------------


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

    with _progress() as progress:
        job = _job(design, output, workers, cluster, progress)
        if plan:
            _show(mask.plan(job.profile, steps.open_library(job), job.design), json_)
            return
        with measured() as cost:
            result = steps.write_layout(job)
    _show({**result, "seconds": cost.seconds, "peak_rss_mb": cost.peak_rss_mb}, json_)


@app.command("drc")
def drc_command(
    layout: LayoutFile,
    design: DesignOption,
    engine: Annotated[
        Literal["lattice", "polygons"], typer.Option(help="On the lattice, or by KLayout's polygon engine.")
    ] = "lattice",
    output: Output = None,
    workers: Workers = None,
    json_: Json = False,
) -> None:
    """Check the design rules on a written file; exits with 2 if any is violated."""
    from metafab import drc, mask
    from metafab.spec import load_design

    spec = load_design(design)
    with _progress() as progress:
        result = drc.check(layout, spec, engine=engine, workers=workers, progress=progress)
    if output is not None:
        drc.save([result], output, mask.top_name(spec.name))
    _show(result, json_)
    _exit_on_violations(sum(result.violations.values()))


# --- light -------------------------------------------------------------------------------------------------------


@app.command("psf")
def psf_command(
    design: DesignOption,
    layout: Annotated[Path | None, typer.Argument(metavar="LAYOUT", help="Written mask, .gds or .oas.")] = None,
    ideal: Annotated[bool, typer.Option("--ideal", help="The target phases, without a mask.")] = False,
    depths_m: Annotated[
        list[float] | None, typer.Option(metavar="Z ...", help="Object depths [default: the design's].")
    ] = None,
    object_mm: Annotated[
        tuple[float, float] | None, typer.Option(metavar="X Y", help="Object's place beside the axis.")
    ] = None,
    pixel_um: Annotated[float | None, typer.Option(metavar="P", help="Sampling step [default: the sensor's].")] = None,
    window_px: Annotated[
        int | None, typer.Option(min=4, max=2048, metavar="N", help="Window [default: the design's].")
    ] = None,
    target_error: TargetError = None,
    output: Output = None,
    json_: Json = False,
) -> None:
    """PSF pair of a written mask over depth."""
    from metafab import steps
    from metafab.core.measure import measured

    if ideal == (layout is not None):
        raise InputError.single("psf", "LAYOUT", "a mask file, or --ideal in its place", "both" if ideal else "neither")
    _require_positive("--depths-m", *(depths_m or ()))
    _require_positive("--pixel-um", *([] if pixel_um is None else [pixel_um]))
    with _progress() as progress, measured() as cost:
        job = _job(design, None, None, None, progress)
        verify = job.design.verify
        result = steps.point_spread(
            job,
            layout,
            depths_m=tuple(sorted(set(depths_m))) if depths_m else verify.depths_m,
            object_mm=object_mm or (0.0, 0.0),
            pixel_um=pixel_um,
            window_px=verify.window_px if window_px is None else window_px,
            target_error=verify.target_error if target_error is None else target_error,
        )
    if output is not None:
        steps.save_psf(job, result, layout, output)
    _show({**steps.psf_figures(result), "seconds": cost.seconds, "file": output}, json_)


@app.command("capture")
def capture_command(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file, or a design with a scene.")],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="PSF pair over depth.")],
    output: Output = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the noise [default: the scene's].")] = None,
    json_: Json = False,
) -> None:
    """Raw frame of a scene."""
    from metafab import steps
    from metafab.core.measure import measured
    from metafab.spec import load_scene

    path = output or Path("raw.h5")
    with _progress() as progress, measured() as cost:
        frame = steps.expose(load_scene(scene), psf, path, seed=seed, progress=progress)
    shape, photons = frame.frame.shape, float(frame.frame.sum())
    _show({"shape": shape, "photons": photons, "seconds": cost.seconds, "file": path}, json_)


@app.command("decode")
def decode_command(
    raw: Annotated[Path, typer.Argument(metavar="RAW", help="Raw frame: .h5, .tif, .png or .npy.")],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="Calibration.")],
    output: Output = None,
    json_: Json = False,
) -> None:
    """4D image of a raw frame: both intensities, contrast and depth."""
    from metafab import steps

    path = output or Path("decoded.h5")
    with _progress() as progress:
        image = steps.restore(raw, psf, path, progress=progress)
    figures = {**image.details, "segments": image.segments, "file": path}
    if image.nmae is not None:
        figures["nmae"] = image.nmae
    _show(figures, json_)


# --- showing -------------------------------------------------------------------------------------------------------


@app.command("report")
def report_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Run folder.")], json_: Json = False
) -> None:
    """Make the HTML page of a run folder again."""
    from metafab import report

    with _progress() as progress:
        path = report.write(folder, progress=progress)
    _show({"file": path}, json_)


@app.command("benchmark")
def benchmark_command(
    room: Annotated[str, typer.Argument(help="cell, library, layout, drc, psf, decode, or all.")] = "all",
    output: Output = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and smaller cases.")] = False,
    json_: Json = False,
) -> None:
    """Error against time and memory: table, plot and JSON."""
    from metafab import report
    from metafab.benchmark import rows_of

    with _progress() as progress:
        rows = rows_of(room, quick=quick, progress=progress)
    page = report.benchmark_page(rows, output or Path("runs") / "benchmark" / room)
    _show({"rows": rows, "files": page}, json_)


@app.command("doctor")
def doctor_command(json_: Json = False) -> None:
    """What is installed, which Meep was found where, and a short self-test."""
    from metafab.doctor import examine

    findings = examine()
    _show(findings, json_)
    if not all(findings["self_test"].values()):
        raise typer.Exit(1)


# --- what all commands share -----------------------------------------------------------------------------------------


def _job(design: Path, folder: Path | None, workers: int | None, cluster: str | None, progress: Progress) -> Job:
    from metafab.run import Job
    from metafab.spec import load_design

    spec: Design = load_design(design)
    return Job(spec, folder or Path("runs") / spec.name, workers, cluster, progress)


def _require_positive(option: str, *values: float) -> None:
    """Refuse zero, negative, NaN and infinite values of an option."""
    for value in values:
        if not 0.0 < value < math.inf:
            raise InputError.single(option, option.removeprefix("--"), "a number above zero", f"{value:g}")


@contextmanager
def _progress() -> Iterator[Progress]:
    """Bars with a time estimate on a terminal's stderr; silence elsewhere."""
    from metafab.core.progress import silent

    if not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, TaskID] = {}

        def show(step: str, done: float, total: float) -> None:
            if step not in tasks:
                tasks[step] = bars.add_task(step, total=total)
            bars.update(tasks[step], completed=done, total=total)

        yield show


def _show(result: Any, as_json: bool) -> None:
    from metafab.core.files import plain

    table = plain(result)
    if as_json:
        print(json.dumps(table, ensure_ascii=False))
        return
    for line in _lines(table):
        print(line)


def _lines(value: Any, indent: int = 0) -> Iterator[str]:
    """A nested table as readable text."""
    pad = "  " * indent
    for key, item in value.items():
        if isinstance(item, dict) and item:
            yield f"{pad}{key}"
            yield from _lines(item, indent + 1)
        elif isinstance(item, list) and item and isinstance(item[0], dict):
            yield f"{pad}{key}"
            for row in item:
                yield f"{pad}  " + "  ".join(f"{k}={_text(v)}" for k, v in row.items())
        else:
            yield f"{pad}{key:<24} {_text(item)}"


def _text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    if isinstance(value, dict):
        return ", ".join(f"{k}: {_text(v)}" for k, v in value.items()) or "none"
    return str(value)


def _exit_on_violations(count: int) -> None:
    if count:
        print(f"metafab: design rules violated at {count} places", file=sys.stderr)
        raise typer.Exit(2)


class _InterruptedError(BaseException):
    """Ctrl-C or SIGTERM: unwinds everything, so that half-written files are removed; nobody swallows it."""


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise _InterruptedError


def _spread_depths(arguments: list[str]) -> list[str]:
    """``--depths-m 0.25 0.3`` and ``--depths-m 0.25,0.3`` as one option a depth."""
    spread: list[str] = []
    taking = False
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if name == "--depths-m":
            taking = not equals
            argument = value  # noqa: PLW2901
            if not equals:
                continue
        numbers = argument.split(",")
        if (taking or name == "--depths-m") and all(_is_number(number) for number in numbers):
            for number in numbers:
                spread += ["--depths-m", number]
            continue
        taking = False
        spread.append(argument)
    return spread


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def main() -> None:
    """Run the command line and translate errors into one clear message and an exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        app(_spread_depths(sys.argv[1:]))
    except MetafabError as error:
        print(f"metafab: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except _InterruptedError:
        print("metafab: interrupted; nothing half-written was left behind", file=sys.stderr)
        sys.exit(1)
    except (OSError, MemoryError) as error:
        print(f"metafab: {type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
