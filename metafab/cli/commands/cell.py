"""Unit cell and library."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from metafab.cli.app import Cluster, Json, Output, TargetError, UnitCellFile, Workers, app, library_app
from metafab.cli.console import announce, progress_bars, short_of_a_turn, show
from metafab.core.errors import Fault, InputError

if TYPE_CHECKING:
    from metafab.spec import UnitCell


@app.command("cell")
def cell_command(
    unit_cell: UnitCellFile,
    width_nm: Annotated[float, typer.Option(min=0.0, help="Pillar size along x.")],
    length_nm: Annotated[float, typer.Option(min=0.0, help="Pillar size along y.")],
    wavelength_nm: Annotated[float | None, typer.Option(help="Vacuum wavelength [default: the file's].")] = None,
    angle_deg: Annotated[float, typer.Option(help="Polar angle of incidence, in the incident medium.")] = 0.0,
    azimuth_deg: Annotated[float, typer.Option(min=-360.0, max=360.0, help="Azimuth of incidence from +x.")] = 0.0,
    solver: Annotated[Literal["rcwa", "meep"] | None, typer.Option(help="Solver [default: the file's].")] = None,
    target_error: TargetError = None,
    json_: Json = False,
) -> None:
    """Solve one unit cell."""
    from metafab import cell
    from metafab.cell import rcwa
    from metafab.spec import load_unit_cell

    spec = load_unit_cell(unit_cell)
    name = solver or spec.solver.name
    _require_size(spec, width_nm, length_nm)
    problem = cell.pillar_cell(
        spec, width_nm, length_nm, wavelength_nm=wavelength_nm, angle_deg=angle_deg, azimuth_deg=azimuth_deg
    )
    numerics = cell.CellNumerics(target_error=target_error or spec.sweep.target_error, solver=name)
    answer = cell.solve(problem, numerics)
    diffracts = name == "rcwa" and rcwa.diffracts(problem)
    (t_xx, t_xy), (t_yx, t_yy) = answer.t
    transmittance_x, transmittance_y = answer.transmittance
    show(
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
            **({"diffraction": rcwa.diffraction(problem, numerics)} if diffracts else {}),
        },
        json_,
    )


def _require_size(spec: UnitCell, width_nm: float, length_nm: float) -> None:
    """Refuse what no pillar of this unit cell can be; 0 is none, and anything up to the period may be asked."""
    faults = []
    least_nm = 1e-3 * spec.illumination.wavelength_nm
    for name, size_nm in (("--width-nm", width_nm), ("--length-nm", length_nm)):
        if 0.0 < size_nm < least_nm:
            expected = f"0, or at least {least_nm:g} nm, a thousandth of the wavelength"
            faults.append(Fault(name, expected, f"{size_nm:g} nm", "is it in nanometres?"))
    if spec.cell.shape == "circle" and width_nm != length_nm:
        got = f"{width_nm:g} and {length_nm:g} nm"
        faults.append(Fault("--length-nm", "the width: both are the diameter of a circle", got))
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
    """Sweep width and length until every size is known to the asked error."""
    from metafab import library
    from metafab.core.parallel.executor import default_workers, open_executor
    from metafab.core.parallel.measure import measured
    from metafab.spec import load_unit_cell

    spec = load_unit_cell(unit_cell)
    path = output or unit_cell.with_suffix(".h5")
    if (ahead := library.foresee(spec, library.SOLVER_SHARE * (target_error or spec.sweep.target_error))) is not None:
        least, most = (seconds / (workers or default_workers()) for seconds in ahead.seconds)
        cells = "{} to {} cells".format(*ahead.cells)
        announce([f"{cells} are expected, {least:.2g} to {most:.2g} s" + (" a core" if cluster else "")])
    with progress_bars() as progress, measured() as cost, open_executor(workers, cluster) as executor:
        built = library.build_file(spec, path, target_error=target_error, executor=executor, progress=progress)
    announce(short_of_a_turn(library.coverage_rad(built)))
    show({"file": path, **library.quality(built), **built.details, **built.spent, "seconds": cost.seconds}, json_)


@library_app.command("check")
def library_check(
    file: Annotated[Path, typer.Argument(metavar="LIB.h5")],
    against: Annotated[Literal["rcwa", "meep"], typer.Option(help="meep, or rcwa at a finer error.")] = "rcwa",
    samples: Annotated[int, typer.Option(min=1, max=1_000_000, help="Held-out sizes.")] = 10,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    workers: Workers = None,
    cluster: Cluster = None,
    json_: Json = False,
) -> None:
    """Solve held-out sizes again with the other or a finer solver."""
    from metafab import library
    from metafab.core.parallel.executor import open_executor

    opened = library.load(file)
    with progress_bars() as progress, open_executor(workers, cluster) as executor:
        result = library.check(
            opened, against=against, samples=samples, seed=seed, executor=executor, progress=progress
        )
    show(result, json_)


@library_app.command("show")
def library_show(
    file: Annotated[Path, typer.Argument(metavar="LIB.h5")], output: Output = None, json_: Json = False
) -> None:
    """Draw phase and transmittance against width and length."""
    from metafab import library, report

    path = output or file.with_suffix(".png")
    report.library_figure(library.load(file), path)
    show({"file": path}, json_)
