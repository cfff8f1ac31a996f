"""One unit cell by FDTD: both polarisations at several resolutions.

Richardson extrapolation gives the limit of vanishing pixels, and the spread of several extrapolations its error.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise

import numpy as np

from metafab.cell.meep.grid import family, plan
from metafab.cell.meep.pool import Pool, own_pool
from metafab.cell.meep.shaped import is_shaped, shaped_plan
from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.symmetry import polarisations_swap
from metafab.cell.response import CellNumerics, CellResponse, SolverDetails
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.errors import Fault, InputError

#: Power of h in the error of a field that is singular at a right-angled corner: 2 alpha for a field r^(alpha - 1), with
#: alpha > 2/3 for any dielectric; smooth fields have h^2.
_SLOWEST_POWER = 4.0 / 3.0


@dataclass(frozen=True)
class Extrapolated:
    """Limit of a sequence of grids."""

    value: ComplexArray  #: Shape (n_values,), the limit.
    error: float  #: Estimate of the largest absolute error among the values.
    gain: float  #: Factor from an independent error of each grid's values to that of the limit.


def richardson(pixel_um: Sequence[float], values: Sequence[ComplexArray]) -> Extrapolated:
    """Limit of v(h) = v + c_2 h^2 + c_4 h^4 + ... from two grids or more that share their coordinates, coarse to fine.

    The three finest grids give both coefficients, two grids the first only. The error assumes that the step between the
    last two second-order limits is due to a term in h^(4/3), the slowest that a pillar's corners add. With two grids it
    is the whole correction. The values of each grid have the shape (n_values,). ValueError for fewer than two grids, or
    spacings that do not descend.
    """
    if len(pixel_um) < 2 or len(pixel_um) != len(values):
        raise ValueError(f"`pixel_um`: expected two or more, as many as `values`, got {len(pixel_um)}")
    if any(fine >= coarse for coarse, fine in pairwise(pixel_um)):
        raise ValueError(f"`pixel_um`: expected descending grid spacings, got {tuple(pixel_um)}")
    h, v = np.asarray(pixel_um, dtype=np.float64), np.asarray(values, dtype=np.complex128)
    last = _limit(h[-2:], v[-2:])
    if len(h) == 2:
        return Extrapolated(last, float(np.max(np.abs(last - v[-1]))), _gain(h))
    step = float(np.max(np.abs(last - _limit(h[-3:-1], v[-3:-1]))))
    coarse, fine = (abs(_limit(pair, pair[:, None] ** _SLOWEST_POWER)[0]) for pair in (h[-3:-1], h[-2:]))
    return Extrapolated(_limit(h[-3:], v[-3:]), step * fine / (coarse - fine), _gain(h[-3:]))


def smoothed_limit(pixel_um: Sequence[float], values: Sequence[ComplexArray]) -> Extrapolated:
    """Limit of v(h) = v + c h^2 from two plain grids or more, coarse to fine, whose walls cross pixels anywhere.

    The error of such a grid deviates irregularly from c h^2, by 22 % for a circle on 36 pixels a period. The limit is
    that of weighted least squares with deviations in proportion to h^2. Its error is the largest difference from the
    limit of any two grids, and at least the correction of the finest; of two grids twice that. The values of each grid
    have the shape (n_values,); errors are raised as by :func:`richardson`.
    """
    if len(pixel_um) < 2 or len(pixel_um) != len(values):
        raise ValueError(f"`pixel_um`: expected two or more, as many as `values`, got {len(pixel_um)}")
    h, v = np.asarray(pixel_um, dtype=np.float64), np.asarray(values, dtype=np.complex128)
    columns = np.stack([h**-2, np.ones_like(h)], axis=-1)
    weights = np.linalg.pinv(columns)[0] / h**2
    value = weights @ v
    pairs = [_limit(h[[i, j]], v[[i, j]]) for i, j in combinations(range(len(h)), 2)]
    spread = max(float(np.max(np.abs(pair - value))) for pair in pairs)
    correction = float(np.max(np.abs(value - v[-1])))
    error = 2.0 * correction if len(h) == 2 else max(spread, correction)
    return Extrapolated(value, error, float(np.sum(np.abs(weights))))


def _limit(h: FloatArray, v: FloatArray | ComplexArray) -> ComplexArray:
    """Value at h = 0 of the polynomial in h^2 through all points."""
    return np.asarray(np.linalg.solve(np.vander(h**2, increasing=True).astype(np.complex128), v)[0])


def _gain(h: FloatArray) -> float:
    """Sum of the magnitudes of the weights in :func:`_limit`."""
    return float(np.sum(np.abs(_limit(h, np.eye(len(h))))))


@dataclass(frozen=True)
class MeepSettings:
    """Numerics of FDTD; InputError for fewer than two members, or members that do not ascend from 1."""

    #: Grids of the cell's family, coarse to fine, at least two. Member j has 10 j to 18 j pixels a period, of shaped
    #: cells 12 j or more. Once the target error is reached with three or more, finer ones are skipped.
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
    fdtd_seconds: float  #: Time of all runs; for a run that was kept, the time that it took then.
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
