"""One unit cell by FDTD: both polarisations, several resolutions, the limit, and its error."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from metafab.cell.meep.deembedding import amplitudes
from metafab.cell.meep.extrapolation import richardson
from metafab.cell.meep.grid import family, plan
from metafab.cell.meep.pool import Pool, own_pool
from metafab.cell.response import CellNumerics, CellResponse, PillarCell
from metafab.core.conventions import POLARISATIONS, ComplexArray, Polarisation
from metafab.core.errors import Fault, InputError, SolverError
from metafab.core.parallel.progress import Progress, silent


@dataclass(frozen=True)
class MeepSettings:
    """What is particular to FDTD.

    Attributes:
        members: grids of the cell's family to solve on, coarse to fine, at least two. A member has 10 to 18 times its
            number pixels a period. From the third on, finer ones are left out once the target error is reached.
        decay: a run ends when its extrapolated orders change by no more than this, relative to the incident wave.
        longest_periods: it ends after this many optical periods at the latest.
    """

    members: tuple[int, ...] = (1, 2, 3, 4)
    decay: float = 1e-4
    longest_periods: float = 1000.0

    def __post_init__(self) -> None:
        ascending = all(fine > coarse for coarse, fine in pairwise(self.members))
        if len(self.members) < 2 or not ascending or self.members[0] < 1:
            raise InputError.single("meep", "members", "two or more whole numbers from 1, ascending", f"{self.members}")


def solve(
    cell: PillarCell,
    numerics: CellNumerics,
    settings: MeepSettings = MeepSettings(),
    pool: Pool | None = None,
) -> CellResponse:
    """Jones matrices of one cell at normal incidence.

    Args:
        cell: what to solve.
        numerics: target error; ``solver`` is not looked at.
        settings: grid and decay.
        pool: workers to use; by default one that lives as long as this process.

    Raises:
        InputError: the cell lies outside what this solver treats.
        MissingToolError: no interpreter has Meep.
        SolverError: a worker failed, or the fields did not decay.
    """
    refuse_untreated(cell)
    start = time.perf_counter()
    workers = own_pool() if pool is None else pool
    # An x/y exchange symmetric cell answers both polarisations alike.
    square = cell.period_nm[0] == cell.period_nm[1] and cell.width_nm == cell.length_nm
    same = square and cell.n_substrate[0] == cell.n_substrate[1]
    polarisations: tuple[Polarisation, ...] = ("x",) if same else POLARISATIONS
    grids = family(cell)
    pixels: list[float] = []
    values: list[ComplexArray] = []
    tail = simulated = spent = 0.0
    for member in settings.members:
        found = []
        for polarisation in polarisations:
            run = plan(
                cell,
                polarisation,
                grids,
                member,
                decay=settings.decay,
                longest_time=settings.longest_periods * cell.wavelength_nm * 1e-3,
            )
            reply = workers.run(run.job)
            if not np.isfinite(reply["tail"]):
                raise SolverError(
                    f"Meep: the fields had not begun to decay after {settings.longest_periods:g} optical periods; "
                    "give more by `longest_periods`"
                )
            found.append(amplitudes(run, reply["limit"][:, 0, 0], reply["incident"]))
            tail = max(tail, float(reply["tail"]))
            simulated = max(simulated, float(reply["time"][-1]))
            spent += float(reply["seconds"])
        pixels.append(run.job.pixel_um)
        values.append(np.array(found).T.ravel())
        if len(pixels) == 1:
            continue
        best = richardson(pixels, values)
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
        details={
            "grids": float(len(pixels)),
            "pixels_per_period": float(run.job.n_x),
            "error_resolution": float(best.error),
            "error_decay": best.gain * tail,
            "last_correction": float(np.max(np.abs(best.value - values[-1]))),
            "fdtd_seconds": spent,
            "simulated_optical_periods": simulated / (cell.wavelength_nm * 1e-3),
        },
    )


def solve_many(
    cells: Iterable[PillarCell],
    numerics: CellNumerics,
    pool: Pool,
    settings: MeepSettings = MeepSettings(),
    progress: Progress = silent,
) -> Iterator[CellResponse]:
    """Solve many cells over the workers of ``pool``; responses come as they finish."""
    todo = list(cells)
    one = partial(solve, numerics=numerics, settings=settings, pool=pool)
    for done, (_, response) in enumerate(pool.stream(one, todo), start=1):
        progress("cells by FDTD", done, len(todo))
        yield response


def refuse_untreated(cell: PillarCell) -> None:
    """Say what this solver cannot do, before anything is started.

    Raises:
        InputError: with every reason.
    """
    faults = []
    if cell.angle_deg != 0.0:
        faults.append(
            Fault(
                "angle_deg",
                "0 for the solver meep",
                f"{cell.angle_deg:g}",
                "a pulse at a fixed wave vector arrives at another angle at every frequency; use rcwa",
            )
        )
    indices = {"n_substrate": cell.n_substrate, "n_ambient": (cell.n_ambient,)}
    faults += [
        Fault(name, "a lossless half space for the solver meep", f"{n}", "drop its k, or use rcwa")
        for name, values in indices.items()
        for n in dict.fromkeys(map(complex, values))
        if n.imag != 0.0
    ]
    if (complex(cell.n_pillar) ** 2).real <= 0.0:
        faults.append(Fault("n_pillar", "a dielectric for the solver meep", f"{cell.n_pillar}", "for a metal use rcwa"))
    if not math.isfinite(cell.height_nm) or cell.height_nm <= 0.0:
        faults.append(Fault("height_nm", "a positive height", f"{cell.height_nm:g}"))
    if faults:
        raise InputError("cell", faults)
