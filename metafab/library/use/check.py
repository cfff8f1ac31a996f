"""Held-out sizes solved again, by the other solver or by the same one with a smaller error."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from metafab.cell import CellNumerics, CellResponse, CellSolver, PillarCell, solve
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress, silent
from metafab.library.library import Library

#: The finer solver is asked for this part of the library's target error.
FINER = 0.1
#: Meep is asked for no less than this: finer grids would take it hours a size.
MEEP_ERROR = 1e-2


@dataclass(frozen=True)
class CheckedSize:
    """One size of a check: what was found, beside what both sides state."""

    width_nm: float
    length_nm: float
    abs_error: float
    stated_error: float
    solver_error: float


@dataclass(frozen=True)
class LibraryCheck:
    """What a check found, over t_xx and t_yy of all its samples.

    Attributes:
        against: the solver that judged.
        samples: sizes drawn, evenly over the sweep and off its grid where the library is continuous.
        max_abs_error: largest |t - t_solver|.
        mean_abs_error: mean of it.
        max_phase_error_rad: largest phase error, where at least a tenth of the light's amplitude passes.
        mean_phase_error_rad: mean of its magnitude there.
        max_stated_error: largest error that the library states for these sizes.
        max_solver_error: largest error that the judging solver states.
        beyond_stated: samples whose error exceeds what library and solver state together.
        worst_width_nm: the size of the largest error; with ``worst_length_nm``.
        worst_length_nm: see ``worst_width_nm``.
        solver_seconds: time in the solver.
        verdict: "holds" if no sample is beyond the stated errors, else "fails".
        sizes: each sample, in the order of the draw.
    """

    against: Literal["rcwa", "meep"]
    samples: int
    max_abs_error: float
    mean_abs_error: float
    max_phase_error_rad: float
    mean_phase_error_rad: float
    max_stated_error: float
    max_solver_error: float
    beyond_stated: int
    worst_width_nm: float
    worst_length_nm: float
    solver_seconds: float
    verdict: Literal["holds", "fails"]
    sizes: tuple[CheckedSize, ...]


def check(
    library: Library,
    against: Literal["rcwa", "meep"] = "rcwa",
    samples: int = 10,
    seed: int = 1,
    executor: Executor | None = None,
    progress: Progress = silent,
    solver: CellSolver = solve,
) -> LibraryCheck:
    """Compare the library with a solver at random sizes.

    Args:
        library: what is judged.
        against: "rcwa" at a tenth of the library's target error, or "meep" at the target error itself, but no less
            than 1e-2. What Meep has finished is kept, so that a check that was stopped goes on where it was.
        samples: how many sizes.
        seed: of the draw.
        executor: where cells are solved; this process when None.
        progress: called after each.
        solver: solves one cell.

    Raises:
        MissingToolError: Meep is asked for and not installed.
    """
    rng = np.random.default_rng(seed)
    width_nm = rng.uniform(library.width_nm[0], library.width_nm[-1], samples)
    length_nm = rng.uniform(library.length_nm[0], library.length_nm[-1], samples)
    if not library.is_continuous:
        row, column = np.nonzero(library.known)
        samples = min(samples, row.size)
        drawn = rng.choice(row.size, samples, replace=False)
        width_nm, length_nm = library.width_nm[column[drawn]], library.length_nm[row[drawn]]
        stated = library.at_sizes(width_nm, length_nm)
    else:
        stated = library.surface(width_nm, length_nm)
    target = library.unit_cell.sweep.target_error
    asked = FINER * target if against == "rcwa" else max(target, MEEP_ERROR)
    numbered = [
        (k, library.pillar(float(w), float(length)))
        for k, (w, length) in enumerate(zip(width_nm, length_nm, strict=True))
    ]
    answers: dict[int, CellResponse] = {}
    work = partial(_solve_numbered, solver, CellNumerics(asked, against))
    for (k, _), answer in stream(executor or SerialExecutor(), work, numbered):
        answers[k] = answer
        progress("library check", len(answers), samples)
    found = np.array([[answers[k].t[0, 0], answers[k].t[1, 1]] for k in range(samples)])
    solver_error = np.array([answers[k].error for k in range(samples)])
    held = np.stack([stated.t_xx, stated.t_yy], axis=-1)
    error = np.abs(held - found).max(axis=-1)
    beyond = int(np.count_nonzero(error > stated.error + solver_error))
    worst = int(np.argmax(error))
    phase_error = np.abs(np.angle(held / found))[np.abs(found) >= 0.1]
    return LibraryCheck(
        against=against,
        samples=samples,
        max_abs_error=float(error.max()),
        mean_abs_error=float(error.mean()),
        max_phase_error_rad=float(phase_error.max(initial=0.0)),
        mean_phase_error_rad=float(phase_error.mean()) if phase_error.size else 0.0,
        max_stated_error=float(stated.error.max()),
        max_solver_error=float(solver_error.max()),
        beyond_stated=beyond,
        worst_width_nm=float(width_nm[worst]),
        worst_length_nm=float(length_nm[worst]),
        solver_seconds=float(sum(answer.seconds for answer in answers.values())),
        verdict="fails" if beyond else "holds",
        sizes=tuple(
            CheckedSize(*map(float, row))
            for row in zip(width_nm, length_nm, error, stated.error, solver_error, strict=True)
        ),
    )


def _solve_numbered(solver: CellSolver, numerics: CellNumerics, item: tuple[int, PillarCell]) -> CellResponse:
    return solver(item[1], numerics)
