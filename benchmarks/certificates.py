"""Stated against true errors of the certified solver, on random unit cells of all kinds.

The cells have periods of 200 to 600 nm, heights of 100 to 1500 nm, indices of 1.4 to 5 with extinctions of 0 to 3,
metals, both lattices, all cross-sections, and light from either side at 0 to 60 degrees; the targets are 1e-2, 1e-3 and
1e-4. The reference is a finer truncation, up to 10 cosines by modes, where the answer comes from doubling. Its own
error is its distance to the truncation below, and it becomes finer until this is a tenth of the stated error; an answer
whose reference stays worse than a third of the stated error is not judged. An answer is broken where it is off by more
than stated, beyond the error of its reference.
"""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from metafab.cell import CellNumerics, PillarCell, solve
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.cost import seconds_of_truncation
from metafab.cell.rcwa.jones import ZeroOrder, distance
from metafab.core.conventions import Side

TARGETS = (1e-2, 1e-3, 1e-4)
#: Kind of cell -> its share.
KINDS = {
    "rectangle": 0.28,
    "tall, high index": 0.16,
    "absorbing": 0.10,
    "metal": 0.05,
    "hexagonal lattice": 0.12,
    "light at an angle": 0.12,
    "ellipse": 0.06,
    "cross": 0.06,
    "rounded corners": 0.05,
}
#: Rungs of the references.
_RUNGS = (6, 7, 8, 9, 10, 12, 14, 16, 18)
#: Estimated time, s, of the finest truncation of an answer and of a reference, where 5 cosines take 4 ms.
_ANSWER_S, _REFERENCE_S, _FIVE_COSINES_S = 0.25, 0.6, 4e-3
#: Finest reference that is solved by modes, which take three times as long as doubling.
_BY_MODES = 10
#: Largest error of a reference over the stated one: wanted, and accepted.
_FINE, _COARSE = 0.1, 1.0 / 3.0


@dataclass(frozen=True)
class Case:
    """One answer and its reference."""

    kind: str  #: Kind of the cell, one of :data:`KINDS`.
    cell: PillarCell  #: The cell.
    target_error: float  #: Target of the answer.
    orders: int  #: Cosines of the answer.
    converged: bool  #: Whether the answer states at most the target.
    stated: float  #: Stated error.
    true: float  #: Distance to the reference.
    reference_error: float  #: Error of the reference; infinite where there was none that is fine enough to compute.
    seconds: float  #: Processor time of the answer.

    @property
    def judged(self) -> bool:
        """Whether the reference suffices."""
        return math.isfinite(self.stated) and self.reference_error <= _COARSE * self.stated

    @property
    def ratio(self) -> float:
        """True over stated error."""
        return self.true / self.stated

    @property
    def broken(self) -> bool:
        """Whether the answer is off by more than stated, whatever the error of its reference."""
        return self.true - self.reference_error > self.stated


def rows(quick: bool, seed: int = 0, samples: int | None = None) -> list[dict[str, Any]]:
    """A row of all answers, and one for each kind of cell and each target."""
    cases = list(audit(seed, samples or (20 if quick else 300)))
    groups = {kind: [case for case in cases if case.kind == kind] for kind in KINDS}
    groups |= {f"target {target:g}": [case for case in cases if case.target_error == target] for target in TARGETS}
    table = [_row("all answers", cases), *(_row(name, group) for name, group in groups.items() if group)]
    worst = max((case for case in cases if case.judged), key=lambda case: case.ratio, default=None)
    if worst is not None:
        table[0] |= {"worst_cell": repr(worst.cell), "worst_target": worst.target_error}
    return table


def audit(seed: int, samples: int) -> Iterator[Case]:
    """Draw cells, and solve each to every target; ``samples`` is the number of answers."""
    rng, left = np.random.default_rng(seed), samples
    while left > 0:
        kind, cell = draw(rng)
        references: dict[int, ZeroOrder] = {}
        for target_error in TARGETS[:left]:
            yield judge(kind, cell, target_error, references)
        left -= len(TARGETS)


def judge(kind: str, cell: PillarCell, target_error: float, references: dict[int, ZeroOrder]) -> Case:
    """Solve a cell to a target, and compare with a reference, which is kept in ``references`` by its cosines."""
    most = max((rung for rung in _RUNGS if _seconds(rung, cell) <= _ANSWER_S), default=_RUNGS[0])
    start = time.thread_time()
    answer = solve(cell, CellNumerics(target_error, max_orders=most))
    seconds = time.thread_time() - start
    orders = int((math.isqrt(answer.resolution) - 1) // 2)
    affordable = [rung for rung in _RUNGS if rung > orders + 1 and _seconds(rung, cell) <= _REFERENCE_S]
    true, reference_error = math.nan, math.inf
    for below, rung in pairwise(affordable):
        for orders_there in (below, rung):
            if orders_there not in references:
                references[orders_there] = zero_order(cell, orders_there, by_modes=orders_there <= _BY_MODES)
        finer = references[rung]
        true, reference_error = distance(answer, finer), distance(references[below], finer)
        if reference_error <= _FINE * answer.error:
            break
    return Case(
        kind, cell, target_error, orders, answer.converged, answer.error, true, reference_error, seconds
    )  # fmt: skip


def draw(rng: np.random.Generator) -> tuple[str, PillarCell]:
    """Draw the kind of a cell, and the cell."""
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    x_nm, y_nm = (float(period) for period in rng.uniform(200.0, 600.0, 2))
    if kind == "hexagonal lattice":
        y_nm = 0.5 * math.sqrt(3.0) * x_nm
    elif rng.random() < 0.6:
        y_nm = x_nm
    width_nm, length_nm = (float(size) for size in rng.uniform(0.1, 0.95, 2) * (x_nm, y_nm))
    if rng.random() < 0.1:
        width_nm = length_nm = min(width_nm, length_nm)
    wavelength_nm, height_nm = float(rng.uniform(450.0, 1600.0)), float(rng.uniform(100.0, 1500.0))
    n_pillar = complex(rng.uniform(1.4, 5.0))
    if kind == "absorbing":
        n_pillar += 1j * float(10.0 ** rng.uniform(-3.0, math.log10(3.0)))
    elif kind == "metal":
        n_pillar, height_nm = complex(rng.uniform(0.05, 2.0), rng.uniform(2.5, 8.0)), float(rng.uniform(100.0, 300.0))
    elif kind == "tall, high index":
        n_pillar = complex(rng.uniform(3.0, 4.2))
        height_nm = min(1500.0, wavelength_nm * float(rng.uniform(1.0, 2.0)))
    n_substrate = complex(rng.choice([1.0, 1.45, 1.7601, rng.uniform(1.0, 3.0)]))
    n_ambient = complex(rng.choice([1.0, 1.0, 1.0, rng.uniform(1.0, 2.0)]))
    side: Side = "substrate" if rng.random() < 0.5 else "ambient"
    cell = PillarCell(
        (x_nm, y_nm), width_nm, length_nm, height_nm, n_pillar, (n_substrate,) * 2, n_ambient, wavelength_nm, side
    )
    return kind, _varied(kind, cell, rng)


def _varied(kind: str, cell: PillarCell, rng: np.random.Generator) -> PillarCell:
    """The plain cell with what its kind has besides."""
    if kind == "hexagonal lattice":
        return replace(cell, is_staggered=True)
    if kind == "light at an angle":
        azimuth_deg = float(rng.choice([0.0, 90.0, rng.uniform(0.0, 360.0)]))
        return replace(cell, angle_deg=float(rng.uniform(1.0, 60.0)), azimuth_deg=azimuth_deg)
    if kind == "ellipse":
        return replace(cell, shape="ellipse")
    if kind == "cross":
        most = 0.95 * min(cell.period_nm)
        return replace(cell, shape="cross", width_nm=min(cell.width_nm, most), length_nm=min(cell.length_nm, most))
    if kind == "rounded corners":
        radius_nm = float(rng.uniform(0.05, 0.45)) * min(cell.width_nm, cell.length_nm)
        return replace(cell, corner_radius_nm=radius_nm)
    return cell


def _seconds(orders: int, cell: PillarCell) -> float:
    return seconds_of_truncation(orders, cell, five_cosines_s=_FIVE_COSINES_S)


def _row(name: str, cases: Sequence[Case]) -> dict[str, Any]:
    """Counts and ratios of a group; ``worst_ratio`` is true over stated, ``median_margin`` stated over true."""
    judged = [case for case in cases if case.judged]
    ratios = [case.ratio for case in judged]
    return {
        "name": name,
        "series": "metafab, certified",
        "error": float(np.median([case.true for case in judged])) if judged else None,
        "seconds": float(np.median([case.seconds for case in cases])),
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
        "samples": len(cases),
        "judged": len(judged),
        "converged": sum(case.converged for case in cases),
        "broken": sum(case.broken for case in judged),
        "worst_ratio": max(ratios, default=None),
        "median_margin": 1.0 / float(np.median(ratios)) if ratios else None,
    }
