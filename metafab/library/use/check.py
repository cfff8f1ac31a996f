"""Validation of a library against another solver, or the same one with a smaller error, at held-out sizes."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from metafab.cell import CellNumerics, CellResponse, CellSolver, solve
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import SerialExecutor, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.library.library import Library
from metafab.library.surface import SizeResponse

#: Target error of the finer solver over the library's target error.
FINER = 0.1
#: Least target error of Meep: finer grids would take it hours a size.
MEEP_ERROR = 1e-2
#: Bounds of library and solver that together exclude hardly any amplitude: half of a whole one.
VACUOUS = 0.5
#: Least amplitude for which a phase error counts.
LEAST_AMPLITUDE = 0.1


@dataclass(frozen=True)
class CheckedSize:
    """One size of a check."""

    width_nm: float  #: Width.
    length_nm: float  #: Length.
    abs_error: float  #: Largest |t - t_solver| of both polarisations.
    stated_error: float  #: Error bound of the library.
    solver_error: float  #: Error bound of the solver.


@dataclass(frozen=True)
class LibraryCheck:
    """Result of a check over t_xx and t_yy of all its samples."""

    against: Literal["rcwa", "meep"]  #: Reference solver.
    samples: int  #: Sizes drawn, evenly over the sweep and off its grid where the library is continuous.
    max_abs_error: float  #: Largest |t - t_solver|.
    mean_abs_error: float  #: Mean over the sizes of the larger |t - t_solver| of both polarisations.
    max_phase_error_rad: float  #: Largest phase error, where |t| is at least 0.1.
    mean_phase_error_rad: float  #: Mean magnitude of the phase error there.
    max_stated_error: float  #: Largest error bound of the library at these sizes.
    max_solver_error: float  #: Largest error bound of the reference solver.
    beyond_stated: int  #: Samples whose error exceeds the sum of both bounds.
    #: Samples whose reference comes from the library's own solver with no smaller error bound than the library's: the
    #: difference proves nothing.
    not_checked: int
    worst_width_nm: float  #: Width of the size with the largest error.
    worst_length_nm: float  #: Length of the size with the largest error.
    solver_seconds: float  #: Time in the solver.
    #: Samples at which both bounds together are 0.5 or more, which excludes hardly any amplitude.
    vacuous: int
    #: "fails" if a sample is beyond the bounds, "no check" if no sample was checked with bounds below 0.5, else
    #: "holds".
    verdict: Literal["holds", "fails", "no check"]
    sizes: tuple[CheckedSize, ...]  #: Each sample, in the order of the draw.

    def warnings(self) -> list[str]:
        """Return sentences about samples that were not checked, and about bounds that exclude nothing."""
        sentences = []
        if self.not_checked:
            sentences.append(
                f"{self.not_checked} of {self.samples} samples are not checked: the finer {self.against} ended at no "
                "smaller error than the library's. Check them by the other solver, whose error is independent"
            )
        if self.vacuous:
            sentences.append(
                f"{self.vacuous} of {self.samples} samples have bounds that together are {VACUOUS:g} or more (library: "
                f"at most {self.max_stated_error:.2g}, {self.against}: {self.max_solver_error:.2g}), which exclude "
                "hardly any amplitude: an error within them proves nothing, but the errors found are valid; a smaller "
                "`sweep.size_grid_nm` lowers the library's bounds"
            )
        return sentences


def check(
    library: Library,
    against: Literal["rcwa", "meep"] = "rcwa",
    samples: int = 10,
    seed: int = 1,
    executor: Executor | None = None,
    progress: Progress = silent,
    solver: CellSolver = solve,
) -> LibraryCheck:
    """Compare a library with a solver at random sizes.

    Args:
        against: "rcwa" at a tenth of the library's target error, or "meep" (MissingToolError without it) at the target
            error, but no less than 1e-2. Finished runs of Meep are kept, so that a check that was stopped continues.
        seed: of the random draw.
        executor: runs the solver; None for this process.

    InputError for fewer than one sample.
    """
    if samples < 1:
        raise InputError.single("library", "samples", "1 or more", f"{samples}")
    width_nm, length_nm = _drawn_sizes(library, samples, np.random.default_rng(seed))
    response = (library.surface if library.is_continuous else library.at_sizes)(width_nm, length_nm)
    target = library.unit_cell.sweep.target_error
    numerics = CellNumerics(
        target_error=FINER * target if against == "rcwa" else max(target, MEEP_ERROR), solver=against
    )
    cells = [library.pillar(float(width), float(length)) for width, length in zip(width_nm, length_nm, strict=True)]
    answers = []
    for answer in in_order(executor or SerialExecutor(), partial(solver, numerics=numerics), cells):
        answers.append(answer)
        progress("library check", len(answers), len(cells))
    return _compared(library, against, width_nm, length_nm, response, answers)


def _drawn_sizes(library: Library, samples: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Random widths and lengths, shape (n,) each: any in the range of a continuous library, else known sizes, once."""
    if library.is_continuous:
        width_nm = rng.uniform(library.width_nm[0], library.width_nm[-1], samples)
        return width_nm, rng.uniform(library.length_nm[0], library.length_nm[-1], samples)
    row, column = np.nonzero(library.known)
    drawn = rng.choice(row.size, min(samples, row.size), replace=False)
    return library.width_nm[column[drawn]], library.length_nm[row[drawn]]


def _compared(
    library: Library,
    against: Literal["rcwa", "meep"],
    width_nm: FloatArray,
    length_nm: FloatArray,
    response: SizeResponse,
    answers: Sequence[CellResponse],
) -> LibraryCheck:
    """Errors and bounds of a library's ``response`` at sizes, shape (n,) each, by the answers of a solver."""
    reference = np.array([[answer.t[0, 0], answer.t[1, 1]] for answer in answers])
    solver_error = np.array([answer.error for answer in answers])
    t = np.stack([response.t_xx, response.t_yy], axis=-1)
    error = np.abs(t - reference).max(axis=-1)
    beyond = int(np.count_nonzero(error > response.error + solver_error))
    same_solver = library.unit_cell.solver.name == against
    idle = int(np.count_nonzero(solver_error >= response.error)) if same_solver else 0
    vacuous = response.error + solver_error >= VACUOUS
    says_nothing = vacuous | (solver_error >= response.error if same_solver else False)
    worst = int(np.argmax(error))
    phase_error = np.abs(np.angle(t / reference))[np.abs(reference) >= LEAST_AMPLITUDE]
    rows = np.stack([width_nm, length_nm, error, response.error, solver_error], axis=-1)
    return LibraryCheck(
        against=against,
        samples=len(answers),
        max_abs_error=float(error.max()),
        mean_abs_error=float(error.mean()),
        max_phase_error_rad=float(phase_error.max(initial=0.0)),
        mean_phase_error_rad=float(phase_error.mean()) if phase_error.size else 0.0,
        max_stated_error=float(response.error.max()),
        max_solver_error=float(solver_error.max()),
        beyond_stated=beyond,
        not_checked=idle,
        worst_width_nm=float(width_nm[worst]),
        worst_length_nm=float(length_nm[worst]),
        solver_seconds=float(sum(answer.seconds for answer in answers)),
        vacuous=int(np.count_nonzero(vacuous)),
        verdict="fails" if beyond else "no check" if np.all(says_nothing) else "holds",
        sizes=tuple(CheckedSize(*row) for row in rows.tolist()),
    )
