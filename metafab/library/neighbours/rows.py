"""Training rows: which pillars stand in them, and their transmitted orders by spectral elements.

Half of the rows hold random sizes. In the other half the target phases of both polarisations change steadily along the
row, as in a lens, and the sizes are among the best of the library for them. The row of a number depends on the number
alone, so that a stopped training continues and any number of workers gives the same rows.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from metafab.cell import PillarCell, pillar_cell
from metafab.cell.elements import orders_at
from metafab.cell.supercell import Supercell, exchanged_site
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress
from metafab.library.library import Library
from metafab.library.neighbours.fit import RowSet
from metafab.library.sweep.checkpoint import Checkpoint, SolvedPoint

#: Pillars of a row, in turn. Rows of 7 cost 2.3 times as much as rows of 5 and hold more distances between pillars.
ROW_SITES = (5, 7, 5)
#: Resolution of the spectral elements. Measured on rows of 5 and 7 against resolution 4: 0.001 to 0.007 of the field at
#: 3.0, but 0.01 to 0.07 at 2.5.
RESOLUTION = 3.0
#: Largest phase step from pillar to pillar of a row with steady phases, rad.
_STEEPEST_RAD = 2.0 * np.pi / 6.0
#: Sizes of a row with steady phases are drawn from this many best ones.
_BEST = 3
#: Part of the light cone beyond which an order is grazing, and the weight of its squared residual in the fit.
_GRAZING, _GRAZING_WEIGHT = 0.95, 0.3
#: Rows that a worker solves in one call, and calls in flight.
_CHUNK, _AHEAD = 2, 16


@dataclass(frozen=True)
class RowSampler:
    """Chooses rows along x by number."""

    cell: PillarCell  #: Period and materials; its size is ignored.
    polarisation: Polarisation  #: Of the incident light.
    size_nm: FloatArray  #: Shape (n, 2), the library's sizes, (width, length).
    t: ComplexArray  #: Shape (n, 2), the library's t of x and y polarised light.
    stream: int  #: Number that sets the random rows apart from those of other chains.

    @classmethod
    def of(cls, library: Library, direction: int, polarisation: Polarisation) -> RowSampler:
        """Rows along x (``direction`` 0) or y (1) of a library; rows along y are exchanged into rows along x."""
        width, length = np.meshgrid(library.width_nm, library.length_nm)
        size_nm, t = np.stack([width, length], axis=-1).reshape(-1, 2), library.t.reshape(-1, 2)
        cell = pillar_cell(library.unit_cell, 0.0, 0.0)
        if direction == 1:
            cell = exchanged_site(cell)
            size_nm, t = size_nm[:, ::-1], t[:, ::-1]
        return cls(cell, polarisation, size_nm, t, 2 * direction + POLARISATIONS.index(polarisation))

    def pillars(self, number: int) -> FloatArray:
        """Sizes of row ``number`` and whether its phases are steady: shape (sites, 2)."""
        rng = np.random.default_rng([self.stream, number])
        sites = ROW_SITES[number % len(ROW_SITES)]
        if not is_steady(number):
            return self.size_nm[rng.integers(0, len(self.size_nm), sites)]
        start, slope = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(-_STEEPEST_RAD, _STEEPEST_RAD, 2)
        target = np.exp(-1j * (start + np.arange(sites)[:, None] * slope))
        overlap = np.einsum("sp,np->sn", target, self.t, optimize=True).real
        best = np.argpartition(-overlap, _BEST, axis=1)[:, :_BEST]
        return self.size_nm[best[np.arange(sites), rng.integers(0, _BEST, sites)]]

    def solve(self, number: int, resolution: float) -> tuple[complex, ...]:
        """Amplitudes of all propagating orders of row ``number`` at one resolution."""
        supercell = Supercell(self.cell, self.pillars(number)[None])
        solved = orders_at(supercell, (self.polarisation,), resolution)
        return tuple(complex(value) for value in solved[:, POLARISATIONS.index(self.polarisation), 0])

    def row_set(self, numbers: Sequence[int], amplitude: Sequence[tuple[complex, ...]]) -> RowSet:
        """Solved rows of one length, as a fit takes them."""
        size_nm = np.stack([self.pillars(number) for number in numbers])
        supercell = Supercell(self.cell, size_nm[:1])
        order = supercell.propagating_orders(self.polarisation)
        sine = np.hypot(*supercell.wavevectors_per_um(order).T) / (1e3 * self.cell.k0_per_nm)
        sine = sine / self.cell.n_out[POLARISATIONS.index(self.polarisation)].real
        return RowSet(
            size_nm=size_nm,
            local=self._local(size_nm),
            amplitude=np.array(amplitude),
            order=order[:, 0].astype(np.float64),
            weight=np.where(sine > _GRAZING, _GRAZING_WEIGHT, 1.0),
        )

    def _local(self, size_nm: FloatArray) -> ComplexArray:
        """The library's t at sizes of the grid, shape (..., 2) to (...)."""
        place = {tuple(size): k for k, size in enumerate(self.size_nm)}
        flat = [place[tuple(size)] for size in size_nm.reshape(-1, 2)]
        return self.t[flat, POLARISATIONS.index(self.polarisation)].reshape(size_nm.shape[:-1])


def is_steady(number: int) -> bool:
    """Whether the phases of row ``number`` change steadily."""
    return number // len(ROW_SITES) % 2 == 1


def solve_rows(
    samplers: Sequence[RowSampler],
    rows: int,
    record: Checkpoint,
    executor: Executor,
    progress: Progress,
) -> list[dict[int, tuple[complex, ...]]]:
    """Solve the first ``rows`` rows of each sampler; rows in the checkpoint are not solved again.

    Returns:
        For each sampler, amplitudes by number of the row.
    """
    total = rows * len(samplers)
    known = {point.number for point in record.points}
    missing = [number for number in range(total) if number not in known]
    chunks = [tuple(missing[k : k + _CHUNK]) for k in range(0, len(missing), _CHUNK)]
    ahead = 1 if isinstance(executor, SerialExecutor) else _AHEAD
    for _, points in stream(executor, partial(_solve_chunk, tuple(samplers)), chunks, ahead=ahead):
        record.add(points)
        progress("rows of unlike pillars", len(record.points), total)
    answers: list[dict[int, tuple[complex, ...]]] = [{} for _ in samplers]
    for point in sorted(record.points, key=lambda point: point.number):
        answers[point.number % len(samplers)][point.number // len(samplers)] = point.amplitudes
    return answers


def _solve_chunk(samplers: Sequence[RowSampler], numbers: tuple[int, ...]) -> list[SolvedPoint]:
    points = []
    for number in numbers:
        start = time.perf_counter()
        sampler = samplers[number % len(samplers)]
        amplitudes = sampler.solve(number // len(samplers), RESOLUTION)
        points.append(SolvedPoint(number, amplitudes, 0.0, time.perf_counter() - start))
    return points
