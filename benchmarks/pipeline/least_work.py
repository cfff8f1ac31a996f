"""Processor time of the least work of a step, by the plainest code on the machine that runs it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy import fft

from benchmarks.cell.algebra import least_seconds
from benchmarks.pipeline.commands import measure
from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.library.sweep.build import solver_target
from metafab.spec import UnitCell

#: Sizes that give the mean time of the solver.
_SAMPLED_SIZES = 24
#: Order of the matrices that give the rate of multiplications.
_ORDER = 512


def solver_s(unit_cell: UnitCell) -> float:
    """Mean processor time of the solver for one size of a sweep, to the error that a build asks for, with slopes."""
    sweep = unit_cell.sweep
    sizes_nm = np.random.default_rng(1).uniform(0.0, 1.0, (_SAMPLED_SIZES, 2))
    spans = (sweep.width_nm, sweep.length_nm)
    cells = [pillar_cell(unit_cell, *(low + u * (high - low) for u, (low, high) in zip(pair, spans, strict=True)))
             for pair in sizes_nm.tolist()]  # fmt: skip
    numerics = CellNumerics(target_error=solver_target(unit_cell), solver=unit_cell.solver.name, slopes=True)
    solve(cells[0], numerics)
    return least_seconds(lambda: [solve(cell, numerics) for cell in cells]) / len(cells)


def start_s() -> float:
    """Processor time of a Python that starts, imports nothing and ends."""
    return min(measure([sys.executable, "-c", ""]).processor_seconds for _ in range(3))


def written_s(path: Path, count: int) -> float:
    """Processor time of writing ``count`` bytes."""
    block = bytes(1 << 20)

    def write() -> None:
        with path.open("wb") as stream:
            for start in range(0, count, len(block)):
                stream.write(block[: count - start])

    seconds = least_seconds(write)
    path.unlink()
    return seconds


def read_s(paths: list[Path]) -> float:
    """Processor time of reading files."""

    def read() -> None:
        for path in paths:
            with path.open("rb") as stream:
                while stream.read(1 << 20):
                    pass

    return least_seconds(read)


def passes_s(pillars: int) -> float:
    """Processor time of looking up t of ``pillars`` pillars and adding it up, for both polarisations."""
    count = min(pillars, 1 << 22)
    index = np.random.default_rng(1).integers(0, 2500, count).astype(np.uint16)
    table = np.ones(2500, dtype=np.complex64)
    return 2.0 * pillars / count * least_seconds(lambda: np.take(table, index).sum())


def window_s(blocks: int, window_px: int) -> float:
    """Processor time of a matrix Fourier transform of ``blocks`` blocks and their two moments to a square window."""
    side = max(1, round(blocks**0.5))
    matrix = np.ones((_ORDER, _ORDER), dtype=np.complex64)
    per_product = least_seconds(lambda: matrix @ matrix) / _ORDER**3
    return 3.0 * per_product * (side * side * window_px + side * window_px * window_px)


def transform_s(rows_px: int, columns_px: int) -> float:
    """Processor time of one real Fourier transform of a picture."""
    picture = np.ones((fft.next_fast_len(rows_px, real=True), fft.next_fast_len(columns_px, real=True)), np.float32)
    return least_seconds(lambda: fft.rfft2(picture))
