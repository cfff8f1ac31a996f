"""Commands ``fullwave``, ``coupling`` and ``patch``: full-wave solutions of supercells and of parts of a mask."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from metafab.cli.app import (
    DesignOption,
    Json,
    LayoutFile,
    TargetError,
    Workers,
    app,
    open_job,
    require_positive,
)
from metafab.cli.console import announce, open_work, show
from metafab.cli.outputs import NamedOutput, Output
from metafab.core.errors import InputError

if TYPE_CHECKING:
    from metafab.cell.supercell import IntArray, SupercellOrders
    from metafab.core.conventions import ComplexArray

#: Most blocks that a warning names.
_MOST_NAMED = 5
#: A simulation is stopped when it takes this many times the estimated time.
_PATIENCE = 20.0


@dataclass(frozen=True)
class BlockAnswer:
    """Transmitted orders of one supercell, as ``metafab fullwave --json`` prints them."""

    orders: IntArray  #: Shape (n, 2), [m_x, m_y] of every order that propagates behind the pillars.
    t_xx: ComplexArray  #: Shape (n,), amplitude of each order, E_x for incident x polarisation.
    t_xy: ComplexArray  #: Shape (n,), E_x for incident y polarisation.
    t_yx: ComplexArray  #: Shape (n,), E_y for incident x polarisation.
    t_yy: ComplexArray  #: Shape (n,), E_y for incident y polarisation.
    error: float  #: Relative rms error over orders and polarisations.
    seconds: float  #: Time of the solver.


Polarisations = Annotated[Literal["x", "y", "both"], typer.Option(help="Polarisation of the incident light.")]


@app.command("coupling")
def coupling_command(
    layout: LayoutFile,
    design: DesignOption,
    at_um: Annotated[list[str], typer.Option(metavar="X,Y", help="Centre of a row; repeat for more rows.")],
    axis: Annotated[Literal["x", "y"], typer.Option(help="Direction of the rows.")] = "x",
    solver: Annotated[Literal["rcwa", "meep", "both"], typer.Option(help="Full-wave solver.")] = "rcwa",
    polarisation: Polarisations = "both",
    pixels_per_period: Annotated[int, typer.Option(min=8, help="Pixels of Meep per period.")] = 16,
    output: Output = None,
    json_: Json = False,
) -> None:
    """Measure the error of the local-period approximation on rows of a written mask.

    With ``-o DIR/coupling.json`` in a run folder, the next run adds the result to its error budget.
    """
    from metafab import fullwave
    from metafab.cell.meep import SupercellSettings
    from metafab.core.storage.files import file_sha256
    from metafab.steps import mask_source, open_library

    with open_work() as (work, cost):
        job = open_job(design, None, work)
        coupling = fullwave.measure_coupling(
            mask_source(job, layout).pillars,
            open_library(job),
            [_place(text) for text in at_um],
            file_sha256(layout),
            axis=axis,
            polarisations=("x", "y") if polarisation == "both" else (polarisation,),
            numerics=fullwave.CouplingNumerics(
                solvers=("rcwa", "meep") if solver == "both" else (solver,), meep=SupercellSettings(pixels_per_period)
            ),
            progress=work.progress,
        )
    if output is not None:
        fullwave.save_coupling(coupling, output)
    figures = {name: getattr(coupling, name) for name in ("coupling_error", "efficiency_ratio", "rows")}
    show(figures, json_, seconds=cost.seconds, file=output)


@app.command("patch")
def patch_command(
    layout: LayoutFile,
    design: DesignOption,
    at_um: Annotated[tuple[float, float], typer.Option(metavar="X Y", help="Centre of the patch.")],
    size_um: Annotated[float, typer.Option(metavar="S", help="Side of the patch.")],
    polarisation: Annotated[Literal["x", "y"], typer.Option(help="Polarisation of the incident light.")] = "x",
    pixels_per_period: Annotated[int, typer.Option(min=8, help="Pixels of Meep per period.")] = 12,
    padding_sites: Annotated[int, typer.Option(min=0, help="Neighbours simulated on each side of the patch.")] = 3,
    limit_min: Annotated[float, typer.Option(min=0.0, help="Longest simulation, minutes.")] = 30.0,
    limit_mb: Annotated[float, typer.Option(min=0.0, help="Largest memory, MB.")] = 8000.0,
    force: Annotated[bool, typer.Option("--force", help="Ignore these limits.")] = False,
    output: NamedOutput = Path("patch.h5"),
    json_: Json = False,
) -> None:
    """Simulate a square patch of a written mask with Meep and compare its field with that of the library.

    With ``-o DIR/patch.h5`` in a run folder, the next report shows the fields.
    """
    from metafab import fullwave
    from metafab.cell.meep import Pool, SupercellSettings
    from metafab.cell.meep.pool import own_folder
    from metafab.core.storage.files import file_sha256, fingerprint
    from metafab.fullwave.patch import PATCH_DECAY
    from metafab.steps import mask_source, open_library

    require_positive("--size-um", size_um)
    with open_work() as (work, _):
        job = open_job(design, None, work)
        opened = open_library(job)
        plan = fullwave.plan_patch(
            mask_source(job, layout).pillars,
            opened,
            at_um,
            size_um,
            padding_sites=padding_sites,
            settings=SupercellSettings(pixels_per_period, decay=PATCH_DECAY),
        )
        rows, columns = plan.supercell.shape
        memory_mb = plan.cost.bytes / 2**20
        cost = f"about {plan.cost.seconds / 60.0:.2g} min and {memory_mb:.2g} MB"
        print(f"metafab: {columns} x {rows} pillars, {plan.cost.pixels:.2g} pixels, {cost}", file=sys.stderr)
        if not force and (plan.cost.seconds > 60.0 * limit_min or memory_mb > limit_mb):
            raise InputError.single(
                "patch", "size_um", f"at most {limit_min:g} min and {limit_mb:g} MB", cost,
                "make it smaller or its grid coarser, raise the limits, or give --force",
            )  # fmt: skip
        with Pool(1, limit_s=max(3600.0, _PATIENCE * plan.cost.seconds), keep=own_folder()) as pool:
            patch = fullwave.solve_patch(plan, opened, polarisation, pool, work.progress)
    fullwave.save_patch(patch, output, inputs_sha256=fingerprint(file_sha256(layout), at_um, size_um, polarisation))
    differences = asdict(patch.against_library)
    for name, difference in (("coupling", patch.coupling), ("grid", patch.grid), ("model", patch.model)):
        if difference is not None:
            differences |= {f"{name}_{figure}": value for figure, value in asdict(difference).items()}
    show(
        differences,
        json_,
        pillars=patch.full_wave.size,
        polarisation=polarisation,
        decay=patch.decay,
        seconds=patch.seconds,
        estimate={"pixels": plan.cost.pixels, "seconds": plan.cost.seconds, "memory_mb": memory_mb},
        numerics={"pixels_per_period": pixels_per_period, "padding_sites": padding_sites},
        file=output,
    )


@app.command("fullwave")
def fullwave_command(
    blocks: Annotated[Path, typer.Argument(metavar="BLOCKS.json", help="Pillar sizes of one or more supercells.")],
    library: Annotated[Path, typer.Option("--library", metavar="LIB.h5", help="Library with the unit cell.")],
    solver: Annotated[Literal["model", "rcwa", "meep", "lone"], typer.Option(help="Solver.")] = "rcwa",
    target_error: TargetError = 5e-3,
    pixels_per_period: Annotated[
        list[int] | None, typer.Option(min=8, help="Grid of Meep; give two or more, ascending [default: 16, 24].")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", "--out", metavar="FILE", help="JSON file.")] = None,
    workers: Workers = None,
    json_: Json = False,
) -> None:
    """Compute the transmitted orders of supercells by one of four solvers.

    ``model`` is the library's model of unlike neighbours, ``lone`` the local-period approximation: each pillar as in a
    lattice of equal pillars. Blocks that are solved when the command fails or is stopped are kept beside FILE, or
    beside BLOCKS.json, and the same command goes on with them.
    """
    from metafab.cell.elements.solve import ElementNumerics
    from metafab.core.storage.files import write_json
    from metafab.fullwave.blocks import BlockNumerics, inputs_of_answers, read_blocks, solve_blocks
    from metafab.fullwave.record import kept_blocks
    from metafab.library import load

    opened = load(library)
    rcwa = ElementNumerics() if target_error is None else ElementNumerics(target_error)
    numerics = BlockNumerics(rcwa, tuple(pixels_per_period or BlockNumerics().pixels_per_period))
    supercells = read_blocks(blocks, opened, solver, numerics)
    with kept_blocks(output or blocks, inputs_of_answers(library, solver, numerics), announce) as record:
        with open_work(workers) as (work, cost), work.processes() as executor:
            found = solve_blocks(
                supercells, opened, solver, numerics, record=record, executor=executor, progress=work.progress
            )
        if solver == "rcwa":
            _announce_missed([orders.error for orders in found], numerics.rcwa.target_error)
        result = {"solver": solver, "blocks": [_answer(orders) for orders in found]}
        if output is not None:
            write_json(output, result)
        show(result, json_, seconds=cost.seconds, file=output)


def _announce_missed(errors: Sequence[float], target_error: float) -> None:
    """Warn of blocks, from the first one on, whose finest feasible elements have a larger error than asked for."""
    missed = [(number, error) for number, error in enumerate(errors, 1) if not error <= target_error]
    if missed:
        blocks = ", ".join(f"{number} ({error:.2g})" for number, error in missed[:_MOST_NAMED])
        more = f" and {len(missed) - _MOST_NAMED} more" if len(missed) > _MOST_NAMED else ""
        reached = f"`--target-error` {target_error:g} is not reached by the finest elements in blocks {blocks}{more}"
        announce([f"{reached}; `error` of each block holds"])


def _answer(orders: SupercellOrders) -> BlockAnswer:
    (t_xx, t_xy), (t_yx, t_yy) = orders.t.transpose(1, 2, 0)
    return BlockAnswer(orders.order, t_xx, t_xy, t_yx, t_yy, orders.error, orders.seconds)


def _place(text: str) -> tuple[float, float]:
    """``"600,-200"`` as two numbers."""
    try:
        x, y = (float(number) for number in text.split(","))
    except ValueError:
        raise InputError.single("coupling", "--at-um", "two numbers X,Y", text) from None
    return x, y
