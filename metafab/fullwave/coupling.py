"""Rows of one local period of the lens: the error of the local-period approximation, measured.

Where a lens bends light by an angle, its pillars repeat (nearly) after one turn of the phase. Such a row, taken from
the written mask and continued periodically, is a grating that full-wave solvers can treat: its wanted order carries
the light that focuses, all others are lost or stray.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from metafab.cell.meep import Pool, SupercellSettings, solve_supercell
from metafab.cell.rcwa.row import RowNumerics, solve_row
from metafab.cell.supercell import Supercell, SupercellResponse
from metafab.core.conventions import POLARISATIONS, Polarisation
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import read_json, write_json
from metafab.fullwave.written import Axis, line_at, local_period_sites, supercell_at
from metafab.layout import PillarMap
from metafab.library import Library

Solver = Literal["rcwa", "meep"]
KIND = "metafab coupling"
FORMAT = 1


@dataclass(frozen=True)
class CouplingRow:
    """One local period by one solver and polarisation.

    Attributes:
        x_um: of its middle; likewise ``y_um``.
        y_um: see ``x_um``.
        axis: along which the row lies.
        polarisation: of the light.
        solver: full-wave solver; its lone pillars give the approximation, too.
        sites: pillars in the row.
        order: wanted order, +1 or -1.
        angle_deg: at which that order leaves.
        efficiency: into the wanted order, of the incident power.
        local_period_efficiency: the same by the local-period approximation.
        wanted_error: |difference| of the wanted order's amplitude.
        coupling_error: root of the summed squared differences of all orders, over the same of the approximation.
        solver_error: estimate of the largest error of an amplitude by the solver itself.
        seconds: time in the solver.
    """

    x_um: float
    y_um: float
    axis: Axis
    polarisation: Polarisation
    solver: Solver
    sites: int
    order: int
    angle_deg: float
    efficiency: float
    local_period_efficiency: float
    wanted_error: float
    coupling_error: float
    solver_error: float
    seconds: float


@dataclass(frozen=True)
class Coupling:
    """Rows of one mask.

    Attributes:
        mask_sha256: of the written file.
        rows: one a place, polarisation and solver.
    """

    mask_sha256: str
    rows: tuple[CouplingRow, ...]

    @property
    def coupling_error(self) -> float:
        """Rms over the rows: the part of the field that the local-period approximation misses."""
        return math.sqrt(sum(row.coupling_error**2 for row in self.rows) / len(self.rows))

    @property
    def efficiency_ratio(self) -> float:
        """Mean efficiency into the wanted order over what the approximation promises."""
        return sum(row.efficiency for row in self.rows) / sum(row.local_period_efficiency for row in self.rows)


def measure_coupling(
    pillars: PillarMap,
    library: Library,
    places_um: Sequence[tuple[float, float]],
    mask_sha256: str,
    *,
    axis: Axis = "x",
    solvers: Sequence[Solver] = ("rcwa",),
    polarisations: Sequence[Polarisation] = POLARISATIONS,
    rcwa: RowNumerics = RowNumerics(),  # noqa: B008 (frozen)
    meep: SupercellSettings = SupercellSettings(),  # noqa: B008 (frozen)
    pool: Pool | None = None,
    progress: Progress = silent,
) -> Coupling:
    """Solve one local period at each place.

    Args:
        pillars: read from the mask.
        library: what the mask was made with; its responses tell the local period.
        places_um: (x, y) of the middles of the rows.
        mask_sha256: of the written file, kept in the result.
        axis: along which the rows lie.
        solvers: full-wave solvers.
        polarisations: of the light; each has a local period of its own.
        rcwa: truncations.
        meep: grid and decay.
        pool: Meep's workers; by default one that lives as long as this process.
        progress: called after each row.

    Raises:
        InputError: a place is off the lens, or its local period is too long.
        MissingToolError: Meep is asked for and not installed.
        SolverError: Meep failed.
    """
    todo = [(place, solver, light) for place in places_um for light in polarisations for solver in solvers]
    rows = []
    for done, ((x, y), solver, light) in enumerate(todo, start=1):
        line = line_at(pillars, library, x, y, axis)[POLARISATIONS.index(light)]
        sites, order = local_period_sites(line)
        shape = (1, sites) if axis == "x" else (sites, 1)
        supercell = supercell_at(pillars, library, x, y, shape)[0]
        answer = _along(axis, supercell, light, solver, rcwa, meep, pool, progress)
        rows.append(_row((x, y), axis, light, solver, order, answer))
        progress("local periods", done, len(todo))
    return Coupling(mask_sha256, tuple(rows))


def save_coupling(coupling: Coupling, path: Path) -> None:
    """Write ``coupling.json``: the rows and what they come to."""
    write_json(
        path,
        {
            "kind": KIND,
            "format_version": FORMAT,
            "mask_sha256": coupling.mask_sha256,
            "coupling_error": coupling.coupling_error,
            "efficiency_ratio": coupling.efficiency_ratio,
            "rows": coupling.rows,
        },
    )


def load_coupling(path: Path) -> Coupling | None:
    """Read ``coupling.json``; None where there is none, or one that is not ours."""
    return read_json(path, KIND, FORMAT, _coupling)


def _coupling(table: dict[str, Any]) -> Coupling | None:
    rows = tuple(CouplingRow(**row) for row in table["rows"])
    return Coupling(table["mask_sha256"], rows) if rows else None


def _along(
    axis: Axis,
    supercell: Supercell,
    light: Polarisation,
    solver: Solver,
    rcwa: RowNumerics,
    meep: SupercellSettings,
    pool: Pool | None,
    progress: Progress,
) -> SupercellResponse:
    """The response of a row; RCWA takes rows along y with x and y exchanged."""
    if solver == "meep":
        return solve_supercell(supercell, light, meep, pool, progress)
    if axis == "x":
        return solve_row(supercell, light, rcwa)
    other: Polarisation = "y" if light == "x" else "x"
    turned = solve_row(supercell.exchanged(), other, rcwa)
    return replace(
        turned,
        supercell=supercell,
        polarisation=light,
        order=turned.order[:, ::-1],
        amplitude=turned.amplitude[:, ::-1],
        responses=turned.responses.T,
    )


def _row(
    place: tuple[float, float],
    axis: Axis,
    light: Polarisation,
    solver: Solver,
    order: int,
    answer: SupercellResponse,
) -> CouplingRow:
    wanted = (order, 0) if axis == "x" else (0, order)
    index = int(np.flatnonzero(np.all(answer.order == wanted, axis=1))[0])
    sine = np.linalg.norm(answer.supercell.across_per_um(answer.order[index])) / (
        2.0 * math.pi / (answer.supercell.cell.wavelength_nm * 1e-3)
    )
    return CouplingRow(
        x_um=place[0],
        y_um=place[1],
        axis=axis,
        polarisation=light,
        solver=solver,
        sites=max(answer.supercell.shape),
        order=order,
        angle_deg=math.degrees(math.asin(min(1.0, float(sine)))),
        efficiency=float(answer.efficiency[index]),
        local_period_efficiency=float(answer.local_period_efficiency[index]),
        wanted_error=float(abs(answer.co_polarised[index] - answer.local_period[index])),
        coupling_error=answer.coupling_error / float(np.linalg.norm(answer.local_period)),
        solver_error=answer.error,
        seconds=answer.seconds,
    )
