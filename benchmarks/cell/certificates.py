"""Stated against true errors of the certified solvers, on random unit cells of all kinds.

The cells have periods of 200 to 600 nm, heights of 100 to 1500 nm, indices of 1.4 to 5 with extinctions of 0 to 3,
metals, both lattices, all cross-sections, sloped walls, films and caps of 1.3 to 4.5, birefringent substrates, and
light from either side at 0 to 60 degrees; each is solved to 1e-2, 1e-3 and 1e-4. All targets of a cell share its
truncations, and the reference is a finer one.

The reference becomes finer until its own error is a fifth of the stated one. Its error is its distance to the
truncation below; where errors fall as a power of the truncation, the largest error that the truncations down to 1 / 1.6
of it imply by that law; for sloped walls also the distance to half as many steps. An answer whose reference stays worse
than a third of the stated error is not judged. An answer is broken where it is off by more than stated, beyond the
error of its reference.

Each cell is drawn from the seed and its number, and its answers are kept in the folder that ``METAFAB_CERTIFICATES``
names, so that a run goes on where another one of the same seed and code has ended.
"""

from __future__ import annotations

import json
import math
import os
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.cell.truncation_time import seconds_of_truncation
from metafab.cell import CellNumerics, PillarCell, curved, solve
from metafab.cell.pillar import Slice
from metafab.cell.rcwa.certificate import SlopedDetails
from metafab.cell.rcwa.convergence import power_law
from metafab.cell.rcwa.jones import ZeroOrder, distance
from metafab.cell.rcwa.slicing import smooth
from metafab.core.conventions import Side
from metafab.core.errors import InputError
from metafab.core.storage.provenance import sources_sha256

#: Truncations by (cosines or polynomial order, steps).
Truncations: TypeAlias = dict[tuple[int, int], ZeroOrder]

KEPT = Path(os.environ.get("METAFAB_CERTIFICATES", "runs/benchmark/certificates/kept"))
TARGETS = (1e-2, 1e-3, 1e-4)
#: Kind of cell -> its share.
KINDS = {
    "rectangle": 0.27,
    "tall, high index": 0.16,
    "absorbing": 0.13,
    "metal": 0.05,
    "hexagonal lattice": 0.08,
    "light at an angle": 0.07,
    "films and caps": 0.08,
    "ellipse": 0.04,
    "cross": 0.04,
    "rounded corners": 0.01,
    "sloped walls": 0.01,
    "birefringent substrate": 0.03,
    "shapes at an angle": 0.02,
    "ring": 0.01,
}
#: Rungs of the references by cosines, and those of spectral elements by polynomial order.
_RUNGS, _ELEMENT_RUNGS = (6, 7, 8, 9, 10, 12, 14, 16, 18), (5, 6, 7, 8, 9)
#: Estimated time, s, of the finest truncation of an answer and of a reference, where 5 cosines take 4 ms.
_ANSWER_S, _REFERENCE_S, _FIVE_COSINES_S = 0.06, 0.6, 4e-3
#: One cell in so many is followed to finer truncations, which may take this much longer.
_DEEP, _DEEP_TIME = 16, 5.0
#: Time of a hexagonal lattice, which has no mirror planes through the middle of its rows, over that of a square one.
_STAGGERED = 2.0
#: Largest polynomial order of answers; deep ones go one higher.
_ELEMENT_ORDER = 5
#: Largest cosines of answers with sloped walls, and the factor of the time that their references may take, as those of
#: light at an angle, which leaves few mirror planes or none.
_SLOPED_ORDERS, _SLOW = 8, 20.0
#: Largest error of a reference over the stated one: wanted, and accepted.
_FINE, _COARSE = 0.2, 1.0 / 3.0
#: Largest ratio of two truncations by which a power law is judged.
_SPAN = 1.6


@dataclass(frozen=True)
class Case:
    """One answer and its reference."""

    number: int  #: Number of the cell within its seed.
    kind: str  #: Kind of the cell, one of :data:`KINDS`.
    target_error: float  #: Target of the answer.
    truncation: int  #: Cosines or polynomial order of the answer.
    converged: bool  #: Whether the answer states at most the target.
    stated: float  #: Stated error.
    true: float  #: Distance to the reference.
    reference_error: float  #: Error of the reference; infinite where there was none that is fine enough to compute.
    seconds: float  #: Processor time of the answer and its reference, beyond what an earlier target has computed.

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


def rows(
    quick: bool, seed: int = 0, samples: int | None = None, only: Sequence[str] = tuple(KINDS)
) -> list[dict[str, Any]]:
    """A row of all answers, and one for each kind of cell and each target.

    Without ``only``, kinds have their shares of :data:`KINDS`; else equal shares of those named.
    """
    for name in only:
        if name not in KINDS:
            raise InputError.single("benchmark", "--only", f"one of {', '.join(KINDS)}", repr(name))
    cases = list(audit(seed, samples or (20 if quick else 300), () if len(only) == len(KINDS) else tuple(only)))
    groups = {kind: [case for case in cases if case.kind == kind] for kind in KINDS}
    groups |= {f"target {target:g}": [case for case in cases if case.target_error == target] for target in TARGETS}
    table = [_row("all answers", cases), *(_row(name, group) for name, group in groups.items() if group)]
    worst = max((case for case in cases if case.judged), key=lambda case: case.ratio, default=None)
    if worst is not None:
        worst_cell = draw(seed, worst.number, worst.kind)[1]
        table[0] |= {"worst_cell": repr(worst_cell), "worst_target": worst.target_error}
    return table


def audit(seed: int, samples: int, only: tuple[str, ...] = ()) -> Iterator[Case]:
    """Draw cells, and solve each to every target; ``samples`` is the number of answers.

    ``only`` names the kinds, one cell of each in turn; all by their shares if it is empty.

    Answers that are kept are taken from there.
    """
    code = sha256(sources_sha256(("metafab.cell",), ("cell",)).encode() + Path(__file__).read_bytes())
    named = "_".join(kind.replace(", ", " ").replace(" ", "-") for kind in only)
    file = KEPT / f"seed_{seed}{named and '_' + named}_{code.hexdigest()[:12]}.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)
    kept = dict(_kept(file))
    for number in range(-(-samples // len(TARGETS))):
        if number not in kept:
            kept[number] = list(judge(seed, number, only[number % len(only)] if only else None))
            with file.open("a", encoding="utf-8") as stream:
                # The line break comes first: a line that was cut short spoils none behind it.
                stream.write("\n" + json.dumps([vars(case) for case in kept[number]]))
        yield from kept[number][: samples - number * len(TARGETS)]


def _kept(file: Path) -> Iterator[tuple[int, list[Case]]]:
    """Numbers and answers of the cells in a file; a line that was cut short is left out."""
    for line in file.read_text(encoding="utf-8").splitlines() if file.is_file() else ():
        try:
            cases = [Case(**table) for table in json.loads(line)]
        except json.JSONDecodeError:
            continue
        yield cases[0].number, cases


def judge(seed: int, number: int, kind: str | None = None) -> Iterator[Case]:
    """Solve a cell to every target, and compare each answer with a finer truncation."""
    (kind, cell), deep = draw(seed, number, kind), number % _DEEP == 0
    known: Truncations = {}
    for target_error in TARGETS:
        start = time.thread_time()
        answer = solve(cell, CellNumerics(target_error=target_error, max_orders=_finest_answer(cell, deep=deep)), known)
        details = vars(answer.details)
        truncation = int(details.get("order") or details["orders_x"])
        steps = 2 * answer.details.steps if isinstance(answer.details, SlopedDetails) else 1
        true, error = math.nan, math.inf
        for rung, error_there in _references(cell, truncation, steps, known, deep=deep):
            true, error = distance(answer, known[rung, steps]), error_there
            if error <= _FINE * answer.error:
                break
        yield Case(
            number, kind, target_error, truncation, answer.converged, answer.error, true, error,
            time.thread_time() - start,
        )  # fmt: skip


def _references(
    cell: PillarCell, truncation: int, steps: int, known: Truncations, *, deep: bool
) -> Iterator[tuple[int, float]]:
    """Ever finer references of an answer, which are added to ``known``, and the error of each."""
    by_elements = curved.is_treated(cell)
    law = None if by_elements else power_law(cell)
    if by_elements:
        rungs = [rung for rung in _ELEMENT_RUNGS if truncation < rung <= _finest_answer(cell, deep=deep) + 2]
    else:
        is_slow = cell.is_sloped or cell.angle_deg > 0.0
        most_s = _REFERENCE_S * (_SLOW if is_slow else 1.0) * (_DEEP_TIME if deep else 1.0)
        least = truncation + (1 if cell.is_sloped else 2)
        rungs = [rung for rung in _RUNGS if rung >= least and _seconds(rung, cell) <= most_s]

    def at(rung: int, steps: int) -> ZeroOrder:
        if (rung, steps) not in known:
            known[rung, steps] = curved.zero_order(cell, rung) if by_elements else smooth(cell, rung, "adaptive", steps)
        return known[rung, steps]

    for below, rung in pairwise(rungs):
        finer = at(rung, steps)
        error = distance(at(below, steps), finer)
        if law is not None:
            coarser = [count for count in rungs if rung / _SPAN <= count < rung]
            error = max(distance(at(k, steps), finer) / ((rung / k) ** law.power - 1.0) for k in coarser)
        yield rung, error + (distance(at(rung, steps // 2), finer) if steps > 1 else 0.0)


def _finest_answer(cell: PillarCell, *, deep: bool) -> int:
    """Largest truncation of answers; at least the one from which a power law says anything."""
    if curved.is_treated(cell):
        return _ELEMENT_ORDER + deep
    if cell.is_sloped:
        return _SLOPED_ORDERS
    most_s, law = _ANSWER_S * (_DEEP_TIME if deep else 1.0), power_law(cell)
    least = _RUNGS[0] if law is None else law.from_orders
    return max(rung for rung in _RUNGS if rung <= least or _seconds(rung, cell) <= most_s)


def draw(seed: int, number: int, kind: str | None = None) -> tuple[str, PillarCell]:
    """Draw the kind of a cell, if it is not given, and the cell."""
    rng = np.random.default_rng((seed, number))
    drawn = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    kind = kind or drawn
    x_nm, y_nm = (float(period) for period in rng.uniform(200.0, 600.0, 2))
    if rng.random() < 0.6:
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
        period_nm=(x_nm, y_nm),
        width_nm=width_nm,
        length_nm=length_nm,
        height_nm=height_nm,
        n_pillar=n_pillar,
        n_substrate=(n_substrate,) * 2,
        n_ambient=n_ambient,
        wavelength_nm=wavelength_nm,
        side=side,
    )
    return kind, _varied(kind, cell, rng)


def _varied(kind: str, cell: PillarCell, rng: np.random.Generator) -> PillarCell:
    """The plain cell with what its kind has besides."""
    if kind == "hexagonal lattice":
        y_nm = 0.5 * math.sqrt(3.0) * cell.period_nm[0]
        length_nm = min(cell.length_nm, 0.95 * y_nm)
        return replace(cell, period_nm=(cell.period_nm[0], y_nm), length_nm=length_nm, is_staggered=True)
    if kind == "light at an angle":
        return _tilted(cell, rng)
    if kind == "shapes at an angle":
        shaped = _varied(str(rng.choice(["ellipse", "cross"])), cell, rng)
        return _tilted(replace(shaped, is_staggered=False), rng)
    if kind == "birefringent substrate":
        n_x = complex(rng.uniform(1.3, 2.6))
        return replace(cell, n_substrate=(n_x, n_x + float(rng.uniform(-0.3, 0.3))))
    if kind == "films and caps":
        return _layered(cell, rng)
    if kind == "ellipse":
        is_staggered = bool(rng.random() < 0.3)
        y_nm = 0.5 * math.sqrt(3.0) * cell.period_nm[0] if is_staggered else cell.period_nm[1]
        width_nm, length_nm = cell.width_nm, min(cell.length_nm, 0.95 * y_nm)
        reach = math.hypot(width_nm / cell.period_nm[0], 0.5 * length_nm / y_nm)
        if is_staggered and reach > 0.98:
            # Ellipses of adjacent rows would touch.
            width_nm, length_nm = 0.97 / reach * width_nm, 0.97 / reach * length_nm
        return replace(
            cell,
            shape="ellipse",
            is_staggered=is_staggered,
            period_nm=(cell.period_nm[0], y_nm),
            width_nm=width_nm,
            length_nm=length_nm,
        )
    if kind == "ring":
        round_cell = _varied("ellipse", replace(cell, length_nm=cell.width_nm), rng)
        outer_nm = min(round_cell.width_nm, round_cell.length_nm)
        hole_nm = outer_nm * float(rng.uniform(0.05, 0.95))
        return replace(round_cell, shape="ring", width_nm=outer_nm, length_nm=outer_nm, hole_nm=hole_nm)
    if kind == "cross":
        most = 0.95 * min(cell.period_nm)
        return replace(cell, shape="cross", width_nm=min(cell.width_nm, most), length_nm=min(cell.length_nm, most))
    if kind == "rounded corners":
        radius_nm = float(rng.uniform(0.05, 0.45)) * min(cell.width_nm, cell.length_nm)
        return replace(cell, corner_radius_nm=radius_nm)
    if kind == "sloped walls":
        wall_deg = float(rng.uniform(84.0, 89.5))
        # The wall may take a third of the smaller size off at the top, and add it at the bottom.
        gap_nm = min(cell.period_nm[0] - cell.width_nm, cell.period_nm[1] - cell.length_nm)
        room_nm = min(cell.width_nm, cell.length_nm, gap_nm)
        height_nm = min(cell.height_nm, 0.33 * room_nm * math.tan(math.radians(wall_deg)))
        return replace(cell, sidewall_angle_deg=wall_deg, height_nm=height_nm)
    return cell


def _tilted(cell: PillarCell, rng: np.random.Generator) -> PillarCell:
    """The cell under light at 1 to 60 degrees, in a plane of symmetry or in any."""
    azimuth_deg = float(rng.choice([0.0, 90.0, rng.uniform(0.0, 360.0)]))
    return replace(cell, angle_deg=float(rng.uniform(1.0, 60.0)), azimuth_deg=azimuth_deg)


def _layered(cell: PillarCell, rng: np.random.Generator) -> PillarCell:
    """A cell with closed films under the pillar, caps of its outline on it, or both; a third of these are ellipses."""

    def layers(around: complex | None) -> tuple[Slice, ...]:
        bounds = (1.3, 2.5) if rng.random() < 0.5 else (2.5, 4.5)
        indices = [complex(rng.uniform(*bounds)) for _ in range(int(rng.integers(1, 3)))]
        return tuple(Slice(float(rng.uniform(10.0, 150.0)), n, n if around is None else around) for n in indices)

    under, over = layers(None), layers(complex(cell.n_ambient))
    which = int(rng.integers(3))
    shape = "ellipse" if rng.random() < 1.0 / 3.0 else "rectangle"
    return replace(cell, under=() if which == 1 else under, over=() if which == 0 else over, shape=shape)


def _seconds(orders: int, cell: PillarCell) -> float:
    seconds = seconds_of_truncation(orders, cell, 96 if cell.is_sloped else 1, five_cosines_s=_FIVE_COSINES_S)
    return seconds * (_STAGGERED if cell.is_staggered else 1.0)


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
        "broken": sum(case.broken for case in cases),
        "worst_ratio": max(ratios, default=None),
        "median_margin": 1.0 / float(np.median(ratios)) if ratios else None,
    }
