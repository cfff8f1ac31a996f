"""Commands ``cell``, ``library build``, ``library check``, ``library import`` and ``library show``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from metafab.cli.app import Cluster, Json, TargetError, UnitCellFile, Workers, app, faults_of_options, library_app
from metafab.cli.console import announce, coverage_warning, open_work, pace, show
from metafab.cli.outputs import Hdf5Output, Output, require_file_output
from metafab.core.errors import Fault, InputError
from metafab.core.storage.tables import optional

if TYPE_CHECKING:
    from metafab.library.use.check import LibraryCheck
    from metafab.spec import UnitCell

#: Sizes of a check that its text lists.
_SHOWN_SIZES = 10


@dataclass(frozen=True)
class CellFigures:
    """Response of one unit cell, as ``metafab cell --json`` prints it."""

    t_xx: complex  #: Zero-order transmission from x to x polarisation; ``t_xy``: from y to x; likewise the others.
    t_yy: complex
    t_xy: complex
    t_yx: complex
    r_xx: complex  #: Zero-order reflection from x to x polarisation; likewise ``r_yy``.
    r_yy: complex
    transmittance_x: float  #: Zero-order power transmittance of x polarisation; likewise y.
    transmittance_y: float
    error: float  #: Error of t; ``target_error``: largest error requested; ``converged``: whether it was reached.
    target_error: float
    converged: bool
    seconds: float  #: Time of the solver.
    solver: str  #: Name of the solver: "rcwa", "elements" for curved outlines, or "meep".
    details: Any  #: Further figures of the solver.
    orders: Any = optional()  #: Number of RCWA's orders or of the spectral elements' functions; None for Meep.
    resolution: Any = optional()  #: Pixels per um of Meep; None for the others.
    diffraction: Any = optional()  #: Power of each propagating order; None for a cell with one order.


@app.command("cell")
def cell_command(
    unit_cell: UnitCellFile,
    width_nm: Annotated[float, typer.Option(min=0.0, help="Pillar size along x.")],
    length_nm: Annotated[float | None, typer.Option(min=0.0, help="Pillar size along y [default: the width].")] = None,
    wavelength_nm: Annotated[float | None, typer.Option(help="Vacuum wavelength [default: the file's].")] = None,
    angle_deg: Annotated[float, typer.Option(help="Polar angle of incidence, in the incident medium.")] = 0.0,
    azimuth_deg: Annotated[float, typer.Option(min=-360.0, max=360.0, help="Azimuth of incidence from +x.")] = 0.0,
    solver: Annotated[Literal["rcwa", "meep"] | None, typer.Option(help="Solver [default: the file's].")] = None,
    target_error: TargetError = None,
    json_: Json = False,
) -> None:
    """Solve one unit cell and print its transmission and reflection."""
    from metafab import cell
    from metafab.cell import rcwa
    from metafab.cell.curved.solve import diffraction as curved_diffraction
    from metafab.spec import load_unit_cell

    spec = load_unit_cell(unit_cell)
    name = solver or spec.solver.name
    length_nm = width_nm if length_nm is None else length_nm
    _require_size(spec, width_nm, length_nm)
    problem = cell.pillar_cell(
        spec, width_nm, length_nm, wavelength_nm=wavelength_nm, angle_deg=angle_deg, azimuth_deg=azimuth_deg
    )
    numerics = cell.CellNumerics(target_error=target_error or spec.sweep.target_error, solver=name)
    answer = cell.solve(problem, numerics)
    is_fdtd = name == "meep"
    diffraction = curved_diffraction if answer.numerics.solver == "elements" else rcwa.diffraction
    (t_xx, t_xy), (t_yx, t_yy) = answer.t
    figures = CellFigures(
        t_xx=complex(t_xx),
        t_yy=complex(t_yy),
        t_xy=complex(t_xy),
        t_yx=complex(t_yx),
        r_xx=complex(answer.r[0, 0]),
        r_yy=complex(answer.r[1, 1]),
        transmittance_x=answer.transmittance[0],
        transmittance_y=answer.transmittance[1],
        error=answer.error,
        target_error=numerics.target_error,
        converged=answer.converged,
        seconds=answer.seconds,
        solver=answer.numerics.solver,
        details=answer.details,
        orders=None if is_fdtd else answer.resolution,
        resolution=answer.resolution if is_fdtd else None,
        diffraction=diffraction(problem, numerics) if rcwa.diffracts(problem) and not is_fdtd else None,
    )
    show(figures, json_)


def _require_size(spec: UnitCell, width_nm: float, length_nm: float) -> None:
    """Check the size of a pillar; 0 stands for no pillar."""
    faults = []
    least_nm = 1e-3 * spec.illumination.wavelength_nm
    for name, size_nm in (("--width-nm", width_nm), ("--length-nm", length_nm)):
        if 0.0 < size_nm < least_nm:
            expected = f"0, or at least {least_nm:g} nm, a thousandth of the wavelength"
            faults.append(Fault(name, expected, f"{size_nm:g} nm", "is it in nanometres?"))
    if spec.cell.is_round and width_nm != length_nm:
        got = f"{width_nm:g} and {length_nm:g} nm"
        faults.append(Fault("--length-nm", "the width: both are the diameter of a circle or ring", got))
    if faults:
        raise InputError("cell", faults)


@library_app.command("build")
def library_build(
    unit_cell: UnitCellFile,
    output: Output = None,
    target_error: TargetError = None,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Build a library: sweep width and length until every size is within the target error."""
    from metafab import library
    from metafab.cell.open_orders import open_orders
    from metafab.core.storage.files import plain
    from metafab.library.store import statistics_json
    from metafab.spec import load_unit_cell

    spec = load_unit_cell(unit_cell)
    path = output or unit_cell.with_suffix(".h5")
    require_file_output(path, [unit_cell])
    announce(order.sentence() for order in open_orders(spec))
    few, many = library.expected_cells(spec)
    announce([f"{few} cells are solved" if few == many else f"{few} to {many} cells are expected"])
    if spec.neighbours is not None:
        rows = f"{spec.neighbours.rows} rows of unlike pillars are solved for each direction and light"
        announce([f"{rows}, then a twelfth as many where the model is least sure"])
    # Steps whose total is known in advance; the number of cells of an adaptive sweep depends on resonances.
    known = {"library", "rows of unlike pillars"} if few == many else {"rows of unlike pillars"}
    with open_work(workers, cluster) as (work, cost), work.processes() as executor:
        progress = pace(work.progress, known)
        built = library.build_file(spec, path, target_error=target_error, executor=executor, progress=progress)
    quality = library.quality(built)
    announce(coverage_warning(quality.coverage_rad))
    announce(built.warnings())
    time = {} if built.time is None else plain(built.time)
    figures = plain(quality) | statistics_json(built) | time
    show(figures | {"file": path, "seconds": cost.seconds}, json_)


@library_app.command("check")
def library_check(
    file: Annotated[Path, typer.Argument(metavar="LIB.h5", help="Library.")],
    against: Annotated[Literal["rcwa", "meep"], typer.Option(help="Solver: meep, or a finer rcwa.")] = "rcwa",
    samples: Annotated[int, typer.Option(min=1, max=1_000_000, help="Number of held-out sizes.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random sizes.")] = 1,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Validate a library: solve held-out sizes again with the other solver or a finer one.

    The text lists the ten sizes with the largest errors, --json all of them.
    """
    from metafab import library

    opened = library.load(file)
    with open_work(workers, cluster) as (work, _), work.processes() as executor:
        result = library.check(
            opened, against=against, samples=samples, seed=seed, executor=executor, progress=work.progress
        )
    announce(result.warnings())
    show(result if json_ else with_worst_sizes(result), json_)


def with_worst_sizes(result: LibraryCheck) -> LibraryCheck:
    """The check with its ten sizes of the largest error alone, worst first, so that its figures stay on the screen."""
    worst = sorted(result.sizes, key=lambda size: -size.abs_error)
    return replace(result, sizes=tuple(worst[:_SHOWN_SIZES]))


@library_app.command("import")
def library_import(
    sweep: Annotated[Path, typer.Argument(metavar="SWEEP", help="Sweep of another program: .csv, .npz or .h5.")],
    unit_cell: Annotated[Path, typer.Option("--unit-cell", metavar="CELL.toml", help="Unit cell of the sweep.")],
    quantity: Annotated[
        Literal["field", "power", "s21"],
        typer.Option(help="The amplitudes: ratio of fields, power with phase, or power-normalised S parameter."),
    ],
    time_sign: Annotated[
        Literal["minus", "plus"],
        typer.Option(help="The program's time dependence: exp(-i omega t) or exp(+i omega t)."),
    ] = "minus",
    output: Hdf5Output = None,
    json_: Json = False,
) -> None:
    """Make a library of a sweep that another program solved; its error is that of cross-validation."""
    from metafab import library
    from metafab.core.storage.files import plain
    from metafab.library.foreign.imported import import_sweep
    from metafab.library.store import statistics_json
    from metafab.spec import load_unit_cell

    path = output or sweep.with_suffix(".library.h5")
    require_file_output(path, [sweep, unit_cell])
    with faults_of_options({"quantity": "--quantity"}):
        made = import_sweep(sweep, load_unit_cell(unit_cell), quantity=quantity, time_sign=time_sign)
    library.save(made, path)
    quality = library.quality(made)
    announce(coverage_warning(quality.coverage_rad))
    announce(made.warnings())
    if left_out := made.statistics.points_left_out:
        announce([f"{left_out} rows of {sweep} hold no finite amplitude and are left out"])
    show(plain(quality) | statistics_json(made) | {"file": path}, json_)


@library_app.command("show")
def library_show(
    file: Annotated[Path, typer.Argument(metavar="LIB.h5", help="Library.")], output: Output = None, json_: Json = False
) -> None:
    """Draw phase and transmittance over width and length."""
    from metafab import library, report

    path = output or file.with_suffix(".png")
    opened = library.load(file)
    report.library_figure(opened, path)
    show({"file": path} | opened.key_figures(), json_)
