"""Training rows: their pillars, and their reflected and transmitted orders by spectral elements.

Half of the rows hold random sizes. In the other half the target phases of both polarisations change steadily along the
row, as in a lens, and the sizes are among the best of the library for them. Short rows alone see the guided waves at a
few Bloch phases only, the multiples of a turn over the row's length. Long rows that are their own mirror images cost as
much as rows of half their length and see the phases between. The row of a number depends on the number alone, so that a
stopped training continues and any number of workers gives the same rows.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from metafab.cell import PillarCell
from metafab.cell.elements.solve import scattered_by_row
from metafab.cell.supercell import Supercell
from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress
from metafab.library.sweep.checkpoint import Checkpoint, SolvedPoint


@dataclass(frozen=True)
class RowKind:
    """Length and symmetry of a row."""

    sites: int  #: Pillars.
    mirrored: bool = False  #: Whether the row is its own mirror image about its middle.

    @property
    def drawn(self) -> int:
        """Pillars that are drawn; the others are their images."""
        return (self.sites + 1) // 2 if self.mirrored else self.sites


#: Kinds of rows, in turn.
ROW_KINDS = (
    RowKind(5),
    RowKind(11, mirrored=True),
    RowKind(7),
    RowKind(14, mirrored=True),
    RowKind(5),
    RowKind(9, mirrored=True),
    RowKind(7),
    RowKind(18, mirrored=True),
)
#: Resolution of the spectral elements. Measured on rows of 5 and 7 against resolution 4: 0.001 to 0.007 of the field at
#: 3.0, but 0.01 to 0.07 at 2.5.
RESOLUTION = 3.0
#: Largest phase step from pillar to pillar of a row with steady phases, rad.
STEEPEST_RAD = 2.0 * np.pi / 6.0
#: Sizes of a row with steady phases are drawn from this many best ones.
BEST = 3
#: Rows that a worker solves in one call, and calls in flight.
_CHUNK, _AHEAD = 2, 16


@dataclass(frozen=True)
class RowSampler:
    """Chooses rows along x by number."""

    cell: PillarCell  #: Period and materials; its size is ignored.
    polarisation: Polarisation  #: Of the incident light.
    size_nm: FloatArray  #: Shape (n, 2), the library's sizes, (width, length).
    r: ComplexArray  #: Shape (n, 2), the library's r of x and y polarised light.
    t: ComplexArray  #: Shape (n, 2), the library's t.
    stream: int  #: Number that sets the random rows apart from those of other chains.

    def pillars(self, number: int) -> FloatArray:
        """Sizes of row ``number``, shape (sites, 2)."""
        kind = kind_of(number)
        drawn = self._drawn(number, kind.drawn)
        return np.concatenate([drawn, drawn[::-1][kind.sites % 2 :]]) if kind.mirrored else drawn

    def _drawn(self, number: int, sites: int) -> FloatArray:
        rng = np.random.default_rng([self.stream, number])
        if not is_steady(number):
            return self.size_nm[rng.integers(0, len(self.size_nm), sites)]
        start, slope = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(-STEEPEST_RAD, STEEPEST_RAD, 2)
        target = np.exp(-1j * (start + np.arange(sites)[:, None] * slope))
        overlap = np.einsum("sp,np->sn", target, self.t, optimize=True).real
        best = np.argpartition(-overlap, BEST, axis=1)[:, :BEST]
        return self.size_nm[best[np.arange(sites), rng.integers(0, BEST, sites)]]

    def solve(self, number: int, resolution: float) -> tuple[complex, ...]:
        """Amplitudes of all reflected orders of row ``number``, then of all transmitted ones, at one resolution."""
        supercell = Supercell(self.cell, self.pillars(number)[None])
        scattered = scattered_by_row(supercell, self.polarisation, resolution)
        return tuple(complex(value) for value in scattered.ravel())


def kind_of(number: int) -> RowKind:
    """Kind of row ``number``."""
    return ROW_KINDS[number % len(ROW_KINDS)]


def is_steady(number: int) -> bool:
    """Whether the phases of row ``number`` change steadily."""
    return number // len(ROW_KINDS) % 2 == 1


class Sampler(Protocol):
    """Chooses supercells by number, and solves them."""

    def solve(self, number: int, resolution: float) -> tuple[complex, ...]:
        """Amplitudes of the supercell of a number, by elements of one resolution."""


def solve_sampled(
    samplers: Sequence[Sampler],
    wanted: Sequence[Iterable[int]],
    record: Checkpoint,
    executor: Executor,
    progress: Progress,
    step: str = "rows of unlike pillars",
) -> list[dict[int, tuple[complex, ...]]]:
    """Solve supercells of each sampler; those in the checkpoint, which may hold others, are not solved again.

    Args:
        samplers: choose the supercells.
        wanted: their numbers, for each sampler.
        record: the checkpoint.
        executor: solves them.
        progress: called with the number of solved ones.
        step: their name for ``progress``.

    Returns:
        For each sampler, amplitudes by number of the supercell.
    """
    numbers = {number * len(samplers) + place for place, rows in enumerate(wanted) for number in rows}
    total = len(numbers)
    missing = sorted(numbers - {point.number for point in record.points})
    chunks = [tuple(missing[k : k + _CHUNK]) for k in range(0, len(missing), _CHUNK)]
    ahead = 1 if isinstance(executor, SerialExecutor) else _AHEAD
    done = 0
    for _, points in stream(executor, partial(_solve_chunk, tuple(samplers)), chunks, ahead=ahead):
        record.add(points)
        done += len(points)
        progress(step, total - len(missing) + done, total)
    answers: list[dict[int, tuple[complex, ...]]] = [{} for _ in samplers]
    found = (point for point in record.points if point.number in numbers)
    for point in sorted(found, key=lambda point: point.number):
        answers[point.number % len(samplers)][point.number // len(samplers)] = point.amplitudes
    return answers


def _solve_chunk(samplers: Sequence[Sampler], numbers: tuple[int, ...]) -> list[SolvedPoint]:
    points = []
    for number in numbers:
        start = time.perf_counter()
        sampler = samplers[number % len(samplers)]
        amplitudes = sampler.solve(number // len(samplers), RESOLUTION)
        points.append(SolvedPoint(number, amplitudes, 0.0, time.perf_counter() - start))
    return points
