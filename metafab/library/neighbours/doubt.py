"""Stated error of a row: a product of powers of predictors that are known without a solver.

Rows that the model corrects more, that change less evenly from site to site, or that respond more to errors of their
matrix are less certain. The powers are fitted to the held-out rows, so that rows with steady phases and rows of random
sizes lie on one line; the factor is a prediction limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear
from scipy.special import stdtrit

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import LineStatistics
from metafab.library.neighbours.line import LineModel
from metafab.library.neighbours.solve import line_gains

#: Chance of an error above the stated one, if ratios of the two are log-normal. Their tails are longer: measured on
#: unseen rows with steady phases 0.002 to 0.009 with 10 and 18 rows held out, 0.002 to 0.014 with 160.
_UNSTATED = 1e-3
#: Smallest number of held-out rows for each power that is fitted.
_ROWS_A_POWER = 2
#: Least value of a predictor in logarithms: equal pillars have no correction and no bend.
_LEAST = 1e-12


@dataclass(frozen=True)
class RowDoubts:
    """Predictors of the error of rows, shape (rows,) each, rms over the sites, relative to the rms of t."""

    correction: FloatArray  #: Correction by the neighbours.
    step: FloatArray  #: Difference of t from site to site; the oldest files use it, new fits the other four.
    bend: FloatArray  #: Second difference of t; it is small where phases change steadily.
    gain: FloatArray  #: Change of the field by independent unit errors of all elements of the site matrices.
    resonance: FloatArray  #: Norm of the inverse of the row's matrix, not relative to t.

    @classmethod
    def of(cls, model: LineModel, size_nm: FloatArray, local: ComplexArray, corrections: ComplexArray) -> RowDoubts:
        """Predictors of closed rows.

        Args:
            model: the chain.
            size_nm: sizes along and across the row, shape (rows, sites, 2).
            local: the library's t, shape (rows, sites).
            corrections: those of the chain, shape (rows, sites).
        """
        norm = np.linalg.norm(local, axis=1)
        before, after = np.roll(local, 1, axis=1), np.roll(local, -1, axis=1)
        parts = (corrections, local - before, after - 2.0 * local + before)
        gain, resonance = line_gains(model, model.polynomials(size_nm))
        correction, step, bend = (np.linalg.norm(part, axis=1) / norm for part in parts)
        return cls(correction, step, bend, gain / norm, resonance)

    def stated_errors(self, statistics: LineStatistics) -> FloatArray:
        """Stated relative error of each row, shape (rows,)."""
        law = (
            (self.correction * self.step) ** statistics.error_power
            * self.correction**statistics.error_power_correction
            * self.bend**statistics.error_power_bend
            * self.gain**statistics.error_power_gain
            * self.resonance**statistics.error_power_resonance
        )
        return np.asarray(statistics.error_floor + statistics.error_slope * law)


def error_law(doubts: RowDoubts, errors: FloatArray, floor: float = 0.0) -> LineStatistics:
    """Floor, slope and powers of a stated error that the next row exceeds with the chance ``_UNSTATED``.

    The powers, none below 0, are those of the least-squares plane through the logarithms. The slope is the prediction
    limit of the log-normal distribution from which the held-out rows are a sample: fewer rows give a larger one. Rows
    of equal pillars, without correction, are left out. ValueError with fewer than three others.

    Args:
        doubts: predictors of the held-out rows.
        errors: their relative errors, shape (rows,).
        floor: smallest stated error.
    """
    counts = doubts.correction > _LEAST
    rows = int(np.count_nonzero(counts))
    if rows < 3:
        raise ValueError(f"`doubts`: expected three held-out rows of unlike pillars or more, got {rows}")
    most = max(1, rows // _ROWS_A_POWER - 1)
    names = ("correction", "bend", "gain", "resonance")[:most]
    error = np.log(errors[counts])
    logs = np.log(np.maximum(np.stack([getattr(doubts, name)[counts] for name in names], axis=1), _LEAST))
    middle = logs.mean(axis=0)
    power = lsq_linear(logs - middle, error - error.mean(), bounds=(0.0, np.inf)).x
    rest = error - logs @ power
    free = rows - len(names) - 1
    spread = math.sqrt(float(np.sum((rest - rest.mean()) ** 2)) / free * (1.0 + (len(names) + 1) / rows))
    limit = float(rest.mean()) + float(-stdtrit(free, _UNSTATED)) * spread
    powers = dict(zip(names, power.tolist(), strict=True))
    return LineStatistics(
        error_floor=floor,
        error_slope=math.exp(limit),
        error_power=0.0,
        error_power_correction=powers["correction"],
        error_power_bend=powers.get("bend", 0.0),
        error_power_gain=powers.get("gain", 0.0),
        error_power_resonance=powers.get("resonance", 0.0),
    )
