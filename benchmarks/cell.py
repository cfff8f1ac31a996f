"""The unit-cell solver on the paper's pillars: true error and time against the target error, certificate included.

``error`` is the largest difference of any t or r from a reference of 16 orders (which a rise to 20 orders moves by
less than 1e-5), over pillars drawn between 100 and 250 nm and those on guided-mode resonances; ``seconds`` is the
processor time of one pillar with both polarisations and reflection, on one thread: the median over the set.
A peer runs on a few of the pillars, against the same reference.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from metafab.cell import CellNumerics, PillarCell
from metafab.cell.rcwa import Formulation, ZeroOrder, solve, zero_order
from metafab.cell.rcwa.jones import distance
from metafab.core.conventions import ComplexArray

RESONANT_NM = ((250.0, 250.0), (150.0, 210.0), (145.0, 245.0), (155.0, 185.0), (220.0, 195.0), (220.8, 244.6))


def rows(quick: bool) -> list[dict[str, Any]]:
    """A row for each target of the certified solver, and for single truncations of both formulations."""
    drawn = np.random.default_rng(3).uniform(100.0, 250.0, (2 if quick else 40, 2)).round(1)
    sizes_nm = [*(RESONANT_NM[1::4] if quick else RESONANT_NM), *map(tuple, drawn.tolist())]
    cells = [
        PillarCell((350.0, 350.0), width, length, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)
        for width, length in sizes_nm
    ]
    references = [zero_order(cell, 12 if quick else 16) for cell in cells]
    table = [_certified(target, cells, references) for target in (1e-2, 1e-3, 1e-4)]
    truncations: list[tuple[Formulation, int]] = [("adaptive", m) for m in (3, 4, 5, 6, 7, 8, 9)]
    truncations += [("fourier", m) for m in ((5, 8) if quick else (5, 9, 15))]
    table += [_truncated(formulation, orders, cells, references) for formulation, orders in truncations]
    shared = [i for i, cell in enumerate(cells) if (cell.width_nm % 2, cell.length_nm % 2) == (0.0, 0.0)][:3]
    return table + _peers([cells[i] for i in shared], [references[i] for i in shared], quick)


def _certified(target: float, cells: Sequence[PillarCell], references: Sequence[ZeroOrder]) -> dict[str, Any]:
    numerics = CellNumerics(target_error=target)
    answers, seconds = _timed(lambda cell: solve(cell, numerics), cells)
    errors = [
        float(max(np.abs(answer.t - reference.t).max(), np.abs(answer.r - reference.r).max()))
        for answer, reference in zip(answers, references, strict=True)
    ]
    worst = max(error / answer.error for error, answer in zip(errors, answers, strict=True))
    unmet = sum(not answer.converged for answer in answers)
    return _row(f"rcwa, target {target:g}", max(errors), seconds, worst_error_over_bound=worst, targets_missed=unmet)


def _truncated(
    formulation: Formulation, orders: int, cells: Sequence[PillarCell], references: Sequence[ZeroOrder]
) -> dict[str, Any]:
    answers, seconds = _timed(lambda cell: zero_order(cell, orders, formulation), cells)
    errors = [distance(answer, reference) for answer, reference in zip(answers, references, strict=True)]
    name = f"rcwa, {formulation}, {(2 * orders + 1) ** 2} orders, no certificate"
    return _row(name, max(errors), seconds, median_error=float(np.median(errors)))


def _peers(cells: Sequence[PillarCell], references: Sequence[ZeroOrder], quick: bool) -> list[dict[str, Any]]:
    """Rows of grcwa (github.com/weiliangjinca/grcwa) where it is installed, a row that says so where it is not."""
    if find_spec("grcwa") is None:
        return [
            {"name": "grcwa", "error": np.nan, "seconds": np.nan, "peak_rss_mb": np.nan, "skipped": "not installed"}
        ]
    table = []
    for orders in (49, 121) if quick else (49, 121, 225, 361):
        errors, seconds = [], []
        for cell, reference in zip(cells, references, strict=True):
            start = time.thread_time()
            t = _grcwa_transmission(cell, orders)
            seconds.append(time.thread_time() - start)
            errors.append(float(np.abs(t - np.diag(reference.t)).max()))
        name = f"grcwa, {orders} orders, t alone"
        table.append(_row(name, max(errors), float(np.median(seconds)), pillars=float(len(errors))))
    return table


def _grcwa_transmission(cell: PillarCell, orders: int) -> ComplexArray:
    """t_xx and t_yy of light from the substrate.

    grcwa scales incident light by its index. Its permittivity is a raster, here of 1 nm: pillars of whole even sizes
    are exact on it.
    """
    grcwa = import_module("grcwa")
    period_um = cell.period_nm[0] / 1e3
    layers = grcwa.obj(orders, [period_um, 0.0], [0.0, period_um], 1e3 / cell.wavelength_nm, 0.0, 0.0, verbose=0)
    pixels = round(cell.period_nm[0])
    layers.Add_LayerUniform(0.0, cell.n_substrate[0] ** 2)
    layers.Add_LayerGrid(cell.height_nm / 1e3, pixels, pixels)
    layers.Add_LayerUniform(0.0, cell.n_ambient**2)
    layers.Init_Setup()
    at_nm = np.arange(pixels) + 0.5 - pixels / 2
    inside = (np.abs(at_nm)[:, None] < cell.width_nm / 2) & (np.abs(at_nm) < cell.length_nm / 2)
    layers.GridLayer_geteps(np.where(inside, cell.n_pillar**2, cell.n_ambient**2).ravel())
    amplitudes = []
    for component, (p, s) in enumerate(((1.0, 0.0), (0.0, 1.0))):
        layers.MakeExcitationPlanewave(p, 0.0, s, 0.0, order=0)
        electric, _ = layers.Solve_FieldFourier(2, 0.0)
        amplitudes.append(cell.n_substrate[0] * electric[component][0])
    return np.array(amplitudes)


def _timed(call: Callable[[PillarCell], Any], cells: Sequence[PillarCell]) -> tuple[list[Any], float]:
    call(cells[0])  # warm-up
    answers, seconds = [], []
    for cell in cells:
        start = time.thread_time()
        answers.append(call(cell))
        seconds.append(time.thread_time() - start)
    return answers, float(np.median(seconds))


def _row(name: str, error: float, seconds: float, **more: float) -> dict[str, Any]:
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {"name": name, "error": error, "seconds": seconds, "peak_rss_mb": peak_mb, **more}
