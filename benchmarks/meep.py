"""FDTD by the real Meep: error against RCWA, and what mirrors and tail extrapolation save.

Errors are the largest of |t - t_ref| and |r - r_ref|; the reference is RCWA at a target of 1e-4. ``peak_rss_mb``
is that of the largest worker.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from metafab.cell import rcwa
from metafab.cell.meep import MeepSettings, Pool, solve
from metafab.cell.meep.deembedding import amplitudes
from metafab.cell.meep.grid import family, plan
from metafab.cell.response import CellNumerics, PillarCell

CELL = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=120.0,
    length_nm=180.0,
    height_nm=600.0,
    n_pillar=3.6941 + 0.0065j,
    n_substrate=(1.7601 + 0j, 1.7601 + 0j),
    n_ambient=1.0 + 0j,
    wavelength_nm=800.0,
)
#: (width, length) in nm; the last two lie on or beside guided-mode resonances.
SIZES = ((120.0, 180.0), (130.0, 200.0), (150.0, 210.0), (250.0, 250.0))


def rows(quick: bool) -> list[dict[str, Any]]:
    """Rows of name, error, seconds and peak memory.

    Args:
        quick: one pillar on coarse grids only.
    """
    members = ((1, 2), (1, 2, 3)) if quick else ((1, 2), (1, 2, 3), (1, 2, 3, 4))
    found = []
    with Pool(1) as pool:
        for width, length in SIZES[:1] if quick else SIZES:
            cell = replace(CELL, width_nm=width, length_nm=length)
            reference = rcwa.solve(cell, CellNumerics(target_error=1e-4))
            for grids in members:
                response = solve(cell, CellNumerics(1e-12, "meep"), MeepSettings(grids), pool)
                difference = max(
                    float(np.max(np.abs(response.t - reference.t))), float(np.max(np.abs(response.r - reference.r)))
                )
                found.append(
                    _row(f"meep {width:g} x {length:g} nm, members {grids}", difference, response.seconds)
                    | {"stated_error": response.error, "pixels_per_um": response.resolution}
                )
        found += _savings(pool, 2 if quick else 3)
    # Known once the workers have ended; the largest of them all.
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    return [row | {"peak_rss_mb": peak} for row in found]


def _savings(pool: Pool, member: int) -> list[dict[str, Any]]:
    """One polarisation on one grid, as the driver runs it, and as a plain script would: whole cell, long wait."""
    decay = MeepSettings().decay
    run = plan(CELL, "x", family(CELL), member, decay=decay, longest_time=500.0)
    start = time.perf_counter()
    ours = pool.run(run.job)
    seconds = time.perf_counter() - start
    # How long the orders themselves take to settle to the same level, on the quarter cell.
    settled = pool.run(replace(run.job, decay=decay * 1e-3))
    rest = np.max(np.abs(settled["amplitude"] - settled["limit"]), axis=(1, 2, 3)) / np.abs(settled["incident"]).max()
    wait = float(settled["time"][np.flatnonzero(rest > decay)[-1]])
    start = time.perf_counter()
    plain = pool.run(replace(run.job, mirrors=(), decay=0.0, longest_time=wait))
    plain_seconds = time.perf_counter() - start
    exact = amplitudes(run, settled["limit"][:, 0, 0], settled["incident"])
    errors = [
        float(np.max(np.abs(np.subtract(amplitudes(run, values[:, 0, 0], reply["incident"]), exact))))
        for values, reply in ((ours["limit"], ours), (plain["amplitude"][-1], plain))
    ]
    return [
        _row(f"one run at {run.job.n_x} pixels: quarter cell, extrapolated tail", errors[0], seconds),
        _row(f"one run at {run.job.n_x} pixels: whole cell, waiting for the tail", errors[1], plain_seconds),
    ]


def _row(name: str, error: float, seconds: float) -> dict[str, Any]:
    return {"name": name, "error": error, "seconds": seconds}


if __name__ == "__main__":
    print(json.dumps(rows("--quick" in sys.argv), indent=2))
