"""Unit-cell solvers on the paper's pillars: true error and time, of metafab and of other solvers.

``error`` is the largest difference of any t or r from a reference of 16 orders (which a rise to 20 orders moves by
less than 1e-5), over pillars drawn between 100 and 250 nm and those on guided-mode resonances; ``seconds`` is the
processor time of one pillar with both polarisations and reflection, on one thread: the median over the set.

Peers (``cell_peers.py``) run in the interpreter named by METAFAB_PEERS_PYTHON, by default this one, on the pillars
``PEER_NM``, as long as a pillar takes less than METAFAB_PEERS_SECONDS (20). Their errors are of t alone. The row of a
peer's smallest error has ``ours_faster`` and ``ours_certified_faster``: the peer's time over that of metafab's fastest
single truncation, and of its fastest certified answer, with at most that error.
"""

from __future__ import annotations

import json
import os
import resource
import runpy
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cell.algebra import algebra_s
from benchmarks.cell.fourier_limit import fourier_limit
from metafab.cell import CellNumerics, PillarCell, solve_many
from metafab.cell.rcwa import solve, zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.jones import ZeroOrder, distance

RESONANT_NM = ((250.0, 250.0), (150.0, 210.0), (145.0, 245.0), (155.0, 185.0), (220.0, 195.0), (220.8, 244.6))
#: Whole nanometres, so that a raster of 0.5 nm is exact: one plain pillar, one near a resonance.
PEER_NM = ((120.0, 180.0), (150.0, 210.0))
PEERS_FILE = Path(__file__).with_name("cell_peers.py")
TARGETS = (1e-2, 1e-3, 1e-4)
TRUNCATIONS = (3, 4, 5, 6, 7, 8, 9)


def rows(quick: bool) -> list[dict[str, Any]]:
    """A row for each target of the certified solver, for single truncations of both formulations, and a limit."""
    drawn = np.random.default_rng(3).uniform(100.0, 250.0, (2 if quick else 40, 2)).round(1)
    sizes_nm = [*(RESONANT_NM[1::4] if quick else RESONANT_NM), *map(tuple, drawn.tolist())]
    cells = [paper_cell(*size_nm) for size_nm in sizes_nm]
    references = [zero_order(cell, 12 if quick else 16) for cell in cells]
    table = [_certified(target, cells, references) for target in TARGETS]
    table += [_truncated("adaptive", m, cells, references) for m in TRUNCATIONS]
    table += [_truncated("fourier", m, cells, references) for m in ((5, 8) if quick else (5, 9, 15))]
    return [*table, _extrapolated(cells, references), *many(quick), *_peers(quick)]


def paper_cell(width_nm: float, length_nm: float) -> PillarCell:
    """The paper's cell with a pillar of this size."""
    return PillarCell(
        period_nm=(350.0, 350.0),
        width_nm=width_nm,
        length_nm=length_nm,
        height_nm=600.0,
        n_pillar=3.6941 + 0.0065j,
        n_substrate=(1.7601, 1.7601),
        n_ambient=1.0,
        wavelength_nm=800.0,
    )


def _certified(target: float, cells: Sequence[PillarCell], references: Sequence[ZeroOrder]) -> dict[str, Any]:
    numerics = CellNumerics(target_error=target)
    answers, seconds = _timed(lambda cell: solve(cell, numerics), cells)
    errors = [distance(answer, reference) for answer, reference in zip(answers, references, strict=True)]
    worst = max(error / answer.error for error, answer in zip(errors, answers, strict=True))
    unmet = sum(not answer.converged for answer in answers)
    name = f"rcwa, target {target:g}"
    return _row(name, "metafab, certified", max(errors), seconds, worst_error_over_bound=worst, targets_missed=unmet)


def _truncated(
    formulation: Formulation, orders: int, cells: Sequence[PillarCell], references: Sequence[ZeroOrder]
) -> dict[str, Any]:
    answers, seconds = _timed(lambda cell: zero_order(cell, orders, formulation), cells)
    errors = [distance(answer, reference) for answer, reference in zip(answers, references, strict=True)]
    name = f"rcwa, {formulation}, {(2 * orders + 1) ** 2} orders, no certificate"
    series = {"adaptive": "metafab, one truncation", "fourier": "metafab, Li's rules"}[formulation]
    return _row(name, series, max(errors), seconds, median_error=float(np.median(errors)))


def _extrapolated(cells: Sequence[PillarCell], references: Sequence[ZeroOrder]) -> dict[str, Any]:
    answers, seconds = _timed(fourier_limit, cells)
    errors = [distance(answer, reference) for answer, reference in zip(answers, references, strict=True)]
    worst = max(error / answer.error for error, answer in zip(errors, answers, strict=True))
    name = "rcwa, fourier, extrapolated from 8 to 12 cosines"
    return _row(name, "metafab, Li's rules", max(errors), seconds, worst_error_over_bound=worst)


def many(quick: bool) -> list[dict[str, Any]]:
    """A hundred pillars certified to 1e-3 in one call: of random sizes, and of ten widths by ten lengths.

    ``error`` is the largest bound; ``seconds`` the processor time of all processes, ``wall_seconds`` the clock's,
    ``floor_s`` that of the matrix products and linear systems alone.
    """
    side = 3 if quick else 10
    axis, drawn = np.linspace(100.0, 250.0, side), np.random.default_rng(1).uniform(100.0, 250.0, (side * side, 2))
    sets = {"random sizes": drawn.tolist(), "widths by lengths": [(w, length) for w in axis for length in axis]}
    table = []
    for name, sizes_nm in sets.items():
        cells = [paper_cell(*size_nm) for size_nm in sizes_nm]
        solve(cells[0])  # warm-up
        start, spent = time.perf_counter(), sum(os.times()[:4])
        answers = list(solve_many(cells))
        wall, spent = time.perf_counter() - start, sum(os.times()[:4]) - spent
        error = max(answer.error for answer in answers)
        solved = [answer for answer in answers if answer.seconds > 0.0]
        label = f"{len(cells)} pillars in one call, {name}"
        figures = {"wall_seconds": wall, "cells_solved": len(solved), "floor_s": algebra_s(solved)}
        table.append(_row(label, None, error, spent, **figures))
    return table


def _peers(quick: bool) -> list[dict[str, Any]]:
    """Rows of all peers; one row with the reason for a peer that is missing."""
    cells = [paper_cell(*size_nm) for size_nm in PEER_NM]
    references = [zero_order(cell, 12 if quick else 16) for cell in cells]
    single = [_truncated("adaptive", m, cells, references) for m in TRUNCATIONS]
    certified = [_certified(target, cells, references) for target in TARGETS]
    truth = np.array([np.diag(reference.t) for reference in references])
    longest_s = 0.1 if quick else float(os.environ.get("METAFAB_PEERS_SECONDS", "20"))
    table = []
    for name in runpy.run_path(str(PEERS_FILE))["PEERS"]:
        answers, complaint = ask_peer(name, cells, longest_s)
        own = []
        for answer in answers:
            t = np.array(answer["t"])
            error = float(np.abs(t[..., 0] + 1j * t[..., 1] - truth).max())
            row = _row(f"{name}, {answer['orders']} orders, t alone", name, error, float(np.median(answer["seconds"])))
            own.append(row | {"peak_rss_mb": answer["peak_rss_mb"]})
        if own:
            best = min(own, key=lambda row: row["error"])
            best |= {"ours_faster": _ratio(best, single), "ours_certified_faster": _ratio(best, certified)}
        else:
            own = [_skipped(name, complaint)]
        table += own
    return [*table, _skipped("S4", "in no package registry (pip's S4 is another program); its source must be built")]


def ask_peer(name: str, cells: Sequence[PillarCell], longest_s: float) -> tuple[list[dict[str, Any]], str]:
    """Run a peer in another interpreter; return its answers, and the last line of its error if it ended early."""
    pillars = [
        {
            "period_nm": cell.period_nm[0],
            "width_nm": cell.width_nm,
            "length_nm": cell.length_nm,
            "height_nm": cell.height_nm,
            "wavelength_nm": cell.wavelength_nm,
            "n_pillar": [complex(cell.n_pillar).real, complex(cell.n_pillar).imag],
            "n_substrate": complex(cell.n_substrate[0]).real,
            "n_ambient": complex(cell.n_ambient).real,
        }
        for cell in cells
    ]
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    jax = {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
    done = subprocess.run(
        [os.environ.get("METAFAB_PEERS_PYTHON", sys.executable), str(PEERS_FILE)],
        input=json.dumps({"peer": name, "pillars": pillars, "longest_s": longest_s}),
        env=os.environ | one_thread | jax,
        capture_output=True,
        text=True,
        check=False,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    return answers, "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]


def _ratio(peer: dict[str, Any], ours: Sequence[dict[str, Any]]) -> float | None:
    """The peer's seconds over those of our fastest row with at most its error; None where there is none."""
    seconds = [row["seconds"] for row in ours if row["error"] <= peer["error"]]
    return peer["seconds"] / min(seconds) if seconds else None


def _timed(call: Callable[[PillarCell], Any], cells: Sequence[PillarCell]) -> tuple[list[Any], float]:
    call(cells[0])  # warm-up
    answers, seconds = [], []
    for cell in cells:
        start = time.thread_time()
        answers.append(call(cell))
        seconds.append(time.thread_time() - start)
    return answers, float(np.median(seconds))


def _row(name: str, series: str | None, error: float, seconds: float, **more: float) -> dict[str, Any]:
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    return {"name": name, "series": series, "error": error, "seconds": seconds, "peak_rss_mb": peak_mb, **more}


def _skipped(name: str, reason: str) -> dict[str, Any]:
    return {"name": name, "series": name, "error": None, "seconds": None, "peak_rss_mb": None, "skipped": reason}
