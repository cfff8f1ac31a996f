"""Processor time of each step of a run beside its floor: what its solves, bytes or transforms alone take here.

The floor of a step is measured in the same process with the plainest code that does the least necessary work:

- ``library``: the solver alone, on as many sizes as were solved;
- ``layout``: zeros of as many bytes as the mask files hold, written;
- ``drc``: the mask files, read;
- ``psf``: each pillar's t looked up and added up once a polarisation, and one matrix Fourier transform of the blocks
  for each window;
- ``capture``: one transform and its inverse of the frame for each object and polarisation;
- ``decode``: the transforms of both images, of each basis image, and of each layer's sharp images.

``phase``, ``study``, ``merit`` and ``report`` have no floor that is worth its name.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import fft

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.core.parallel.measure import measured
from metafab.core.parallel.work import Work
from metafab.library.sweep.build import solver_target
from metafab.run import STEPS, run
from metafab.spec import Design, UnitCell, load_design
from metafab.steps import RunSummary
from metafab.steps.job import Job, Step

LAYOUTS = Path(__file__).parents[2] / "layouts"
#: Sizes that give the mean time of the solver.
_SAMPLED_SIZES = 24
#: Order of the matrices that give the rate of multiplications.
_ORDER = 512


def rows(quick: bool) -> list[dict[str, Any]]:
    """A row of each step: processor seconds, floor, and their ratio; ``error`` is the step's own.

    Args:
        quick: the small lens alone, without the paper's.
    """
    return [row for name in ("helix_small", "helix_2mm")[: 1 if quick else 2] for row in steps_of(name)]


def steps_of(name: str) -> list[dict[str, Any]]:
    """Rows of the design ``layouts/NAME.toml``, on one core, with a library that is built on the way."""
    design = load_design(LAYOUTS / f"{name}.toml")
    costs: dict[str, tuple[float, float]] = {}
    with TemporaryDirectory() as place:
        folder = Path(place)
        cell = folder / design.library.name
        shutil.copy(design.library, cell)
        design = replace(design, library=cell)
        steps = [replace(step, work=_timed(step, costs)) for step in STEPS]
        summary = run(design, folder / "run", steps=steps, work=Work(workers=1))
        floors = _floors(design, summary, folder / "run")
    errors = _errors(summary)
    return [
        {
            "name": f"{name}: {step}",
            "error": errors.get(step),
            "seconds": seconds,
            "peak_rss_mb": peak_rss_mb,
            "floor_s": floors.get(step),
            "ratio": seconds / floors[step] if floors.get(step) else None,
        }
        for step, (seconds, peak_rss_mb) in costs.items()
    ]


def _timed(step: Step, costs: dict[str, tuple[float, float]]) -> Callable[[Job], Any]:
    def work(job: Job) -> Any:
        with measured() as cost:
            figures = step.work(job)
        costs[step.name] = (cost.processor_seconds, cost.peak_rss_mb)
        return figures

    return work


def _errors(summary: RunSummary) -> dict[str, float | None]:
    library, layout, psf, decode = summary.library, summary.layout, summary.psf, summary.decode
    return {
        "library": None if library is None else library.max_error,
        "layout": None if layout is None else layout.phase_rms_error_rad,
        "psf": None if psf is None else max(psf.error),
        "decode": None if decode is None else decode.nmae,
    }


def _floors(design: Design, summary: RunSummary, folder: Path) -> dict[str, float]:
    library, layout, psf, decode, scene = summary.library, summary.layout, summary.psf, summary.decode, design.scene
    assert library is not None
    assert layout is not None
    assert psf is not None
    assert decode is not None
    assert scene is not None
    masks = [folder / file.name for file in layout.files]
    directions = 1 + int(np.prod(design.verify.field_points))
    windows = 2 * (directions * psf.depths + len(design.verify.depths_m))
    rows_px, columns_px = scene.field_px
    step = decode.step_px or 1
    return {
        "library": library.points_solved * solver_s(design.unit_cell),
        "layout": written_s(folder / "floor", sum(path.stat().st_size for path in masks)),
        "drc": read_s(masks),
        "psf": passes_s(layout.pillars) + windows * window_s(round(psf.blocks or 1), design.verify.window_px),
        "capture": 4 * len(scene.objects) * transform_s(rows_px, 2 * columns_px),
        "decode": (2 + 2 * (decode.basis_images or 0)) * transform_s(rows_px // step, columns_px // step)
        + 2 * (decode.layers or 1) * transform_s(rows_px, columns_px),
    }


def solver_s(unit_cell: UnitCell) -> float:
    """Mean processor time of the solver for one size of a sweep, to the error that a build asks for."""
    sweep = unit_cell.sweep
    sizes_nm = np.random.default_rng(1).uniform(0.0, 1.0, (_SAMPLED_SIZES, 2))
    spans = (sweep.width_nm, sweep.length_nm)
    cells = [pillar_cell(unit_cell, *(low + u * (high - low) for u, (low, high) in zip(pair, spans, strict=True)))
             for pair in sizes_nm.tolist()]  # fmt: skip
    numerics = CellNumerics(solver_target(unit_cell), unit_cell.solver.name)
    solve(cells[0], numerics)
    return _seconds(lambda: [solve(cell, numerics) for cell in cells]) / len(cells)


def written_s(path: Path, count: int) -> float:
    """Processor time of writing ``count`` bytes."""
    block = bytes(1 << 20)

    def write() -> None:
        with path.open("wb") as stream:
            for start in range(0, count, len(block)):
                stream.write(block[: count - start])

    seconds = _seconds(write)
    path.unlink()
    return seconds


def read_s(paths: list[Path]) -> float:
    """Processor time of reading files."""

    def read() -> None:
        for path in paths:
            with path.open("rb") as stream:
                while stream.read(1 << 20):
                    pass

    return _seconds(read)


def passes_s(pillars: int) -> float:
    """Processor time of looking up t of ``pillars`` pillars and adding it up, for both polarisations."""
    count = min(pillars, 1 << 22)
    index = np.random.default_rng(1).integers(0, 2500, count).astype(np.uint16)
    table = np.ones(2500, dtype=np.complex64)
    return 2.0 * pillars / count * _seconds(lambda: np.take(table, index).sum())


def window_s(blocks: int, window_px: int) -> float:
    """Processor time of a matrix Fourier transform of ``blocks`` blocks and their two moments to a square window."""
    side = max(1, round(blocks**0.5))
    matrix = np.ones((_ORDER, _ORDER), dtype=np.complex64)
    per_product = _seconds(lambda: matrix @ matrix) / _ORDER**3
    return 3.0 * per_product * (side * side * window_px + side * window_px * window_px)


def transform_s(rows_px: int, columns_px: int) -> float:
    """Processor time of one real Fourier transform of a picture."""
    picture = np.ones((fft.next_fast_len(rows_px, real=True), fft.next_fast_len(columns_px, real=True)), np.float32)
    return _seconds(lambda: fft.rfft2(picture))


def _seconds(work: Callable[[], Any], rounds: int = 3) -> float:
    """Least processor time of a few rounds."""
    found = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        found.append(time.process_time() - begun)
    return min(found)
