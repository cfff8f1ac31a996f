"""Rows that are held out of the fit of a chain, and its errors on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.figures import LineStatistics
from metafab.library.neighbours.doubt import RowDoubts, error_law
from metafab.library.neighbours.line import LineModel
from metafab.library.neighbours.rows import RESOLUTION, ROW_KINDS, RowSampler, is_steady
from metafab.library.neighbours.solve import line_corrections
from metafab.library.neighbours.training.fit import RowSet
from metafab.library.neighbours.training.row_sets import Answers, row_sets

#: One row in this number is held out of the fit.
_HELD_OUT = 6
#: Number of rows that are solved again to measure the error of the rows, and the increase of their resolution.
_CHECKED_ROWS, _FINER = 3, 1.0


def is_held_out(number: int) -> bool:
    """One row in ``_HELD_OUT`` of each kind, of random sizes and of steady phases."""
    turn, place = divmod(number, 2 * len(ROW_KINDS))
    return (place + turn) % _HELD_OUT == _HELD_OUT - 1


def measured(
    sampler: RowSampler, answers: Answers, held: Sequence[int], fitted: Sequence[RowSet], model: LineModel
) -> LineStatistics:
    """Errors of a fitted chain, and the law of its stated error.

    Args:
        sampler: chooses and solves the rows.
        answers: solved rows.
        held: numbers of those that are held out.
        fitted: rows that the chain is fitted to.
        model: the chain.
    """
    alike = row_sets(sampler, answers, [number for number in held if is_steady(number)])
    unlike = row_sets(sampler, answers, [number for number in held if not is_steady(number)])
    errors_alike, errors_unlike = ([rows.errors(model) for rows in sets] for sets in (alike, unlike))
    errors = np.concatenate([*errors_alike, *errors_unlike])
    checked = []
    for number in held[:_CHECKED_ROWS]:
        fine, coarse = (
            np.reshape(scattered, (2, -1))[1]
            for scattered in (sampler.solve(number, RESOLUTION + _FINER), answers[number])
        )
        checked.append(np.linalg.norm(fine - coarse) / np.linalg.norm(fine))
    solver_error = _rms([np.array(checked)])
    return replace(
        error_law(_doubts((*alike, *unlike), model), errors, floor=solver_error),
        rows=sum(len(rows.size_nm) for rows in fitted),
        held_out=len(held),
        local_period_error=_rms([rows.errors(None) for rows in (*alike, *unlike)]),
        error=_rms([errors]),
        error_unlike=_rms(errors_unlike),
        error_alike=_rms(errors_alike),
        local_period_error_alike=_rms([rows.errors(None) for rows in alike]),
        error_p90=float(np.quantile(np.concatenate(errors_alike), 0.9)),
        error_fitted=_rms([rows.errors(model) for rows in fitted]),
        solver_error=solver_error,
    )


def _doubts(sets: Sequence[RowSet], model: LineModel) -> RowDoubts:
    """Predictors of the errors of all rows of the sets, in turn."""
    found = []
    for rows in sets:
        corrections = line_corrections(model, model.polynomials(rows.size_nm))
        found.append(vars(RowDoubts.of(model, rows.size_nm, rows.local[1], corrections)))
    return RowDoubts(**{name: np.concatenate([each[name] for each in found]) for name in found[0]})


def _rms(errors: Sequence[FloatArray]) -> float:
    every = np.concatenate(list(errors))
    return math.sqrt(float(np.mean(every**2)))
