"""Error of the local-period approximation, measured on rows of one local period of the lens.

Where a lens bends light by an angle, its pillars repeat (nearly) after one turn of the phase. Such a row, cut from the
written mask and continued periodically, is a grating that full-wave solvers can treat. Its wanted order carries the
light that reaches the focus; all other orders are lost or stray light.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from metafab.cell.curved.supercell import count_functions
from metafab.cell.elements import solve as spectral_elements
from metafab.cell.elements.solve import ElementNumerics
from metafab.cell.meep import Pool, SupercellSettings, solve_supercell
from metafab.cell.supercell import SupercellResponse
from metafab.core.conventions import POLARISATIONS, Polarisation
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import file_sha256, read_json, write_json
from metafab.fullwave.written import Axis, line_at, local_period_sites, supercell_at
from metafab.layout import PillarMap
from metafab.library import Library

Solver = Literal["rcwa", "meep"]
#: Rings of a steep lens, each measured on one row; target error of the rows' amplitudes. Couplings there are 0.2 to
#: 0.5.
_RINGS, _RINGS_TARGET = 3, 0.02
#: Most functions of a row with curved outlines, some ten seconds of processor time.
_MOST_FUNCTIONS = 1500
KIND = "metafab coupling"
FORMAT = 1


@dataclass(frozen=True)
class CouplingNumerics:
    """Full-wave solvers of the rows."""

    solvers: tuple[Solver, ...] = ("rcwa",)  #: One or both solvers.
    rcwa: ElementNumerics = field(default_factory=ElementNumerics)  #: Target error and resolutions of RCWA.
    meep: SupercellSettings = field(default_factory=SupercellSettings)  #: Grid and decay of Meep.


@dataclass(frozen=True)
class CouplingRow:
    """One local period by one solver and polarisation."""

    x_um: float  #: Middle of the row.
    y_um: float  #: Middle of the row.
    axis: Axis  #: Direction of the row.
    polarisation: Polarisation  #: Polarisation of the light.
    solver: Solver  #: Full-wave solver; it also solves the equal pillars of the approximation.
    sites: int  #: Pillars in the row.
    order: int  #: Wanted order, +1 or -1.
    angle_deg: float  #: Angle of the wanted order behind the mask.
    efficiency: float  #: Power in the wanted order over incident power.
    local_period_efficiency: float  #: This efficiency by the local-period approximation.
    wanted_error: float  #: |difference| of the wanted order's amplitude from the approximation.
    coupling_error: float  #: l2 norm of the differences of all orders, over the norm of the approximation.
    solver_error: float  #: Error estimate of the solver, largest over the amplitudes.
    seconds: float  #: Time in the solver.


@dataclass(frozen=True)
class Coupling:
    """Rows of one mask."""

    mask_sha256: str  #: Hash of the written file.
    rows: tuple[CouplingRow, ...]  #: One for each place, polarisation and solver.

    @property
    def coupling_error(self) -> float:
        """Rms coupling error of the rows: the relative error of the field by the local-period approximation."""
        return math.sqrt(sum(row.coupling_error**2 for row in self.rows) / len(self.rows))

    @property
    def efficiency_ratio(self) -> float:
        """Mean efficiency into the wanted order over its mean by the local-period approximation."""
        return sum(row.efficiency for row in self.rows) / sum(row.local_period_efficiency for row in self.rows)


def measure_coupling(
    pillars: PillarMap,
    library: Library,
    places_um: Sequence[tuple[float, float]],
    mask_sha256: str,
    *,
    axis: Axis = "x",
    polarisations: Sequence[Polarisation] = POLARISATIONS,
    numerics: CouplingNumerics = CouplingNumerics(),
    pool: Pool | None = None,
    progress: Progress = silent,
) -> Coupling:
    """Solve one local period, by the phases of the mask's library, for each polarisation at each place.

    ``places_um`` are (x, y) of the middle of each row; ``mask_sha256`` is the hash of the written file, kept in the
    result. ``pool`` holds the workers of Meep; by default it lives as long as this process.

    Raises:
        InputError: a place is off the lens, or its local period is too long, or too short for its order to propagate.
        MissingToolError: Meep is requested but not installed.
        SolverError: Meep failed.
    """
    todo = [(place, solver, light) for place in places_um for light in polarisations for solver in numerics.solvers]
    rows = []
    for done, ((x, y), solver, light) in enumerate(todo, start=1):
        line = line_at(pillars, library, x, y, axis)[POLARISATIONS.index(light)]
        sites, order = local_period_sites(line)
        shape = (1, sites) if axis == "x" else (sites, 1)
        supercell = supercell_at(pillars, library, x, y, shape)[0]
        wanted = (order, 0) if axis == "x" else (0, order)
        if not np.any(np.all(supercell.propagating_orders(light) == wanted, axis=1)):
            # The local period lies between two whole numbers of sites; with the smaller one, the order is evanescent.
            expected, got = "a row longer than a wavelength behind the pillars", f"{sites} sites"
            raise InputError.single("coupling", "place", expected, got, "choose a point nearer to the axis")
        if solver == "meep":
            answer = solve_supercell(supercell, light, numerics.meep, pool, progress)
        else:
            answer = spectral_elements.solve_supercell(supercell, light, numerics.rcwa)
        rows.append(_row((x, y), axis, solver, order, answer))
        progress("local periods", done, len(todo))
    return Coupling(mask_sha256, tuple(rows))


def measure_rings(
    pillars: PillarMap, library: Library, radius_um: float, mask_sha256: str, progress: Progress = silent
) -> Coupling:
    """Solve rows along x in the middle of rings of equal area of a steep lens, by RCWA; errors as measure_coupling."""
    places = [(radius_um * math.sqrt((ring + 0.5) / _RINGS), 0.0) for ring in range(_RINGS)]
    functions = 0
    for x, y in places:
        sites = max(local_period_sites(line)[0] for line in line_at(pillars, library, x, y, "x"))
        supercell = supercell_at(pillars, library, x, y, (1, sites))[0]
        if supercell.cell.is_shaped:
            functions = max(functions, count_functions(supercell, ElementNumerics().resolutions[0]))
    if functions > _MOST_FUNCTIONS:
        expected = f"curved outlines of up to {_MOST_FUNCTIONS} functions a row"
        raise InputError.single("supercell", "cell.shape", expected, f"{functions}", "`metafab coupling` solves them")
    numerics = CouplingNumerics(rcwa=ElementNumerics(target_error=_RINGS_TARGET))
    return measure_coupling(pillars, library, places, mask_sha256, numerics=numerics, progress=progress)


def save_coupling(coupling: Coupling, path: Path) -> None:
    """Write ``coupling.json``: the rows and their means."""
    content = {
        "kind": KIND,
        "format_version": FORMAT,
        "mask_sha256": coupling.mask_sha256,
        "coupling_error": coupling.coupling_error,
        "efficiency_ratio": coupling.efficiency_ratio,
        "rows": coupling.rows,
    }
    write_json(path, content)


def load_coupling(path: Path) -> Coupling | None:
    """Read ``coupling.json``; None where it is missing or of another kind."""
    return read_json(path, KIND, FORMAT, _coupling)


def find_coupling(folder: Path, masks: Iterable[Path]) -> Coupling | None:
    """Rows by ``metafab coupling`` or by the run, of one of the mask files of a run folder; None without any."""
    records = [found for name in ("coupling.json", "orders.json") if (found := load_coupling(folder / name))]
    of_masks = {file_sha256(path) for path in masks if path.is_file()} if records else ()
    return next((found for found in records if found.mask_sha256 in of_masks), None)


def _coupling(table: dict[str, Any]) -> Coupling | None:
    rows = tuple(CouplingRow(**row) for row in table["rows"])
    return Coupling(table["mask_sha256"], rows) if rows else None


def _row(
    place_um: tuple[float, float], axis: Axis, solver: Solver, order: int, answer: SupercellResponse
) -> CouplingRow:
    wanted = (order, 0) if axis == "x" else (0, order)
    index = int(np.flatnonzero(np.all(answer.order == wanted, axis=1))[0])
    per_um = 2.0 * math.pi / (answer.supercell.cell.wavelength_nm * 1e-3)
    sine = np.linalg.norm(answer.supercell.wavevectors_per_um(answer.order[index])) / per_um
    return CouplingRow(
        x_um=place_um[0],
        y_um=place_um[1],
        axis=axis,
        polarisation=answer.polarisation,
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
