"""One unit cell by FDTD: both polarisations at several resolutions, their limit, and its error."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from metafab.cell.meep.extrapolation import richardson, smoothed_limit
from metafab.cell.meep.grid import family, plan
from metafab.cell.meep.pool import Pool, own_pool
from metafab.cell.meep.shaped import is_shaped, shaped_plan
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.symmetry import polarisations_swap
from metafab.cell.response import CellNumerics, CellResponse, SolverDetails
from metafab.core.conventions import POLARISATIONS, ComplexArray, Polarisation
from metafab.core.errors import Fault, InputError


@dataclass(frozen=True)
class MeepSettings:
    """Numerics of FDTD; InputError for fewer than two members, or members that do not ascend from 1."""

    #: Grids of the cell's family, coarse to fine, at least two. Member j has 10 j to 18 j pixels a period, of shaped
    #: cells 12 j or more. From the third on, finer ones are skipped once the target error is reached.
    members: tuple[int, ...] = (1, 2, 3, 4)
    #: A run ends when its extrapolated orders change by at most this, relative to the incident wave.
    decay: float = 1e-4
    longest_periods: float = 1000.0  #: Longest run, in optical periods.

    def __post_init__(self) -> None:
        ascending = all(fine > coarse for coarse, fine in pairwise(self.members))
        if len(self.members) < 2 or not ascending or self.members[0] < 1:
            raise InputError.single("meep", "members", "two or more whole numbers from 1, ascending", f"{self.members}")


@dataclass(frozen=True)
class MeepDetails(SolverDetails):
    """Figures of a solution by FDTD."""

    grids: int  #: Number of grids that were solved.
    pixels_per_period: int  #: Pixels of the x period on the finest grid.
    error_resolution: float  #: Error of the extrapolation to vanishing pixels.
    error_decay: float  #: Error of the fields' remaining decay.
    last_correction: float  #: Largest change of any amplitude from the finest grid to the limit.
    fdtd_seconds: float  #: Time of all runs, kept ones as when they ran.
    simulated_optical_periods: float  #: Length of the longest run.


def solve(
    cell: PillarCell, numerics: CellNumerics, settings: MeepSettings = MeepSettings(), pool: Pool | None = None
) -> CellResponse:
    """Solve one cell at normal incidence for its Jones matrices.

    Args:
        numerics: target error; ``solver`` is ignored.
        pool: workers; by default a pool that lives as long as this process.

    Raises:
        InputError: the solver does not treat the cell.
        MissingToolError: no interpreter has Meep.
        SolverError: a worker failed, or the fields did not decay.
    """
    refuse_untreated(cell)
    start = time.perf_counter()
    workers = own_pool() if pool is None else pool
    polarisations: tuple[Polarisation, ...] = ("x",) if polarisations_swap(cell) else POLARISATIONS
    wavelength_um = cell.wavelength_nm * 1e-3
    longest_time = settings.longest_periods * wavelength_um
    on_grid = shaped_plan if is_shaped(cell) else partial(plan, grids=family(cell))
    plan_of = partial(on_grid, cell, decay=settings.decay, longest_time=longest_time)
    limit_of = smoothed_limit if is_shaped(cell) else richardson
    pixels: list[float] = []
    values: list[ComplexArray] = []
    tail = simulated = spent = 0.0
    for member in settings.members:
        amplitudes = []
        for polarisation in polarisations:
            run = plan_of(polarisation=polarisation, member=member)
            reply = workers.run_to_decay(run.job)
            amplitudes.append(run.amplitudes(reply["limit"][:, 0, 0], reply["incident"]))
            tail = max(tail, float(reply["tail"]))
            simulated = max(simulated, float(reply["time"][-1]))
            spent += float(reply["seconds"])
        pixels.append(run.job.pixel_um)
        values.append(np.array(amplitudes).T.ravel())
        if len(pixels) == 1:
            continue
        best = limit_of(pixels, values)
        error = float(best.error + best.gain * tail)
        if len(pixels) > 2 and error <= numerics.target_error:
            break
    t, r = best.value.reshape(2, -1)
    return CellResponse(
        cell=cell,
        numerics=numerics,
        t=np.diag(np.broadcast_to(t, 2)).astype(np.complex128),
        r=np.diag(np.broadcast_to(r, 2)).astype(np.complex128),
        error=error,
        converged=error <= numerics.target_error,
        resolution=round(1.0 / pixels[-1]),
        seconds=time.perf_counter() - start,
        details=MeepDetails(
            grids=len(pixels),
            pixels_per_period=run.job.n_x,
            error_resolution=float(best.error),
            error_decay=best.gain * tail,
            last_correction=float(np.max(np.abs(best.value - values[-1]))),
            fdtd_seconds=spent,
            simulated_optical_periods=simulated / wavelength_um,
        ),
    )


def refuse_untreated(cell: PillarCell) -> None:
    """Refuse a cell that FDTD does not treat here, before any worker starts; InputError with every reason."""
    treated = ("angle_deg", "under, over", "sidewall_angle_deg", "shape, corner_radius_nm")
    faults = cell.untreated("the solver meep", treated=treated, remedy="solve with rcwa")
    if cell.angle_deg != 0.0:
        remedy = "a pulse of fixed wave vector has another angle at every frequency; use rcwa"
        faults.append(Fault("angle_deg", "0 for the solver meep", f"{cell.angle_deg:g}", remedy))
    for name, indices in (("n_substrate", cell.n_substrate), ("n_ambient", (cell.n_ambient,))):
        for n in dict.fromkeys(map(complex, indices)):
            if n.imag != 0.0:
                expected = "a lossless half space for the solver meep"
                faults.append(Fault(name, expected, f"{n}", "drop its k, or use rcwa"))
    named = {"n_pillar": cell.n_pillar}
    for side, layers in (("under", cell.under), ("over", cell.over)):
        named |= {f"{side}[{number}].n": layer.n_inside for number, layer in enumerate(layers)}
    for name, n in named.items():
        if (complex(n) ** 2).real <= 0.0:
            faults.append(Fault(name, "a dielectric for the solver meep", f"{n}", "for a metal use rcwa"))
    if not math.isfinite(cell.height_nm) or cell.height_nm <= 0.0:
        faults.append(Fault("height_nm", "a positive height", f"{cell.height_nm:g}"))
    if faults:
        raise InputError("cell", faults)
