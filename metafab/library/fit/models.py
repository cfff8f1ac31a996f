"""Models of all four amplitudes over the plane of sizes, fitted in pairs: where two disagree, neither is right."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import maximum_filter

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.fit.rational import Degrees, RationalModel, fit, terms

#: Degrees of the denominator that are tried, and the largest degree of the numerators.
DENOMINATOR_DEGREES = (7, 10, 12)
LARGEST_DEGREE = 16
#: Unknowns that a fit may have for each equation; below 1 keeps noise and false poles away.
FILLING = 0.7
#: Sweeps with many guided modes (TiO2 in the visible) need more; these are tried once samples abound.
MANY_MODES_DENOMINATOR, MANY_MODES_DEGREE, MANY_MODES_FILLING = 14, 22, 0.35


@dataclass(frozen=True)
class Samples:
    """Solved sizes.

    Attributes:
        width_nm: shape (n,).
        length_nm: shape (n,).
        amplitudes: shape (n, 4), t_xx, t_yy, r_xx, r_yy.
    """

    width_nm: FloatArray
    length_nm: FloatArray
    amplitudes: ComplexArray

    def __getitem__(self, which: np.ndarray) -> Samples:
        return Samples(self.width_nm[which], self.length_nm[which], self.amplitudes[which])

    def joined(self, more: Samples) -> Samples:
        """These samples, then ``more``."""
        return Samples(
            np.concatenate([self.width_nm, more.width_nm]),
            np.concatenate([self.length_nm, more.length_nm]),
            np.concatenate([self.amplitudes, more.amplitudes]),
        )


@dataclass(frozen=True)
class SizeModel:
    """All four amplitudes as continuous functions of width and length.

    Attributes:
        x: channels t_xx and r_xx, which share the poles of x polarisation.
        y: channels t_yy and r_yy.
    """

    x: RationalModel
    y: RationalModel

    def __call__(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        """Shape (n,) sizes -> shape (n, 4): t_xx, t_yy, r_xx, r_yy."""
        x, y = self.x(width_nm, length_nm), self.y(width_nm, length_nm)
        return np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1)

    def on_grid(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        """Values on a grid: shape (4, n_length, n_width)."""
        x, y = self.x.on_grid(width_nm, length_nm), self.y.on_grid(width_nm, length_nm)
        return np.stack([x[0], y[0], x[1], y[1]])


@dataclass(frozen=True)
class ModelPair:
    """The two models that predict held-out sizes best.

    Attributes:
        best: the one to use.
        rival: the runner-up; where both agree, neither hangs on its own degrees.
    """

    best: SizeModel
    rival: SizeModel

    def disagreement(self, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
        """Largest difference of any amplitude on a grid: shape (n_length, n_width)."""
        difference = self.best.on_grid(width_nm, length_nm) - self.rival.on_grid(width_nm, length_nm)
        return np.asarray(np.abs(difference).max(axis=0), dtype=np.float64)

    def disagreement_around(self, width_nm: FloatArray, length_nm: FloatArray) -> FloatArray:
        """The same, but the largest up to half a step away, where a false pole can hide between the sizes."""
        fine = self.disagreement(_with_middles(width_nm), _with_middles(length_nm))
        return np.asarray(maximum_filter(fine, size=3, mode="nearest")[::2, ::2], dtype=np.float64)


def _with_middles(axis_nm: FloatArray) -> FloatArray:
    return np.linspace(axis_nm[0], axis_nm[-1], 2 * axis_nm.size - 1)


def fit_models(
    samples: Samples, held_out: np.ndarray, span_nm: tuple[FloatArray, FloatArray], exchange: bool
) -> ModelPair:
    """Try several degrees without the held-out samples, then fit the two best to all samples.

    Args:
        samples: solved sizes.
        held_out: shape (n,), which of them judge the degrees.
        span_nm: smallest and largest width, smallest and largest length.
        exchange: whether t_yy(W, L) = t_xx(L, W).
    """
    known, unseen = samples[~held_out], samples[held_out]

    def miss(degrees: Degrees) -> float:
        predicted = _fit(known, degrees, span_nm, exchange)(unseen.width_nm, unseen.length_nm)
        return float(np.sqrt(np.mean(np.abs(predicted - unseen.amplitudes) ** 2)))

    ranked = sorted(_candidates(_equations(known, exchange)), key=miss)
    best, rival = (_fit(samples, degrees, span_nm, exchange) for degrees in ranked[:2])
    return ModelPair(best, rival)


def _equations(samples: Samples, exchange: bool) -> int:
    """Samples of one polarisation."""
    return samples.width_nm.size * (2 if exchange else 1)


def _candidates(count: int) -> list[Degrees]:
    """Degrees (numerator, denominator) that ``count`` samples of two channels can determine."""
    found: list[Degrees] = []
    for below in (*DENOMINATOR_DEGREES, MANY_MODES_DENOMINATOR):
        filling = FILLING if below <= DENOMINATOR_DEGREES[-1] else MANY_MODES_FILLING
        top = _largest_numerator(below, LARGEST_DEGREE, filling * 2 * count)
        if _largest_numerator(below, MANY_MODES_DEGREE, MANY_MODES_FILLING * 2 * count) == MANY_MODES_DEGREE:
            found.append((MANY_MODES_DEGREE, below))
        if top:
            found += [(above, below) for above in sorted({top, max(3 * top // 4, 1)})]
    return found if len(found) > 1 else [(2, 0), (1, 0)]


def _largest_numerator(below: int, largest: int, unknowns: float) -> int:
    """Largest degree whose unknowns, with those of the denominator, are no more than these; 0 if none."""
    fitting = [above for above in range(1, largest + 1) if 2 * terms(above) + terms(below) <= unknowns]
    return fitting[-1] if fitting else 0


def _fit(samples: Samples, degrees: Degrees, span_nm: tuple[FloatArray, FloatArray], exchange: bool) -> SizeModel:
    """Fit both polarisations; with exchange, one fit to the samples and their mirror images serves both."""
    x_range, y_range = ((float(span[0]), float(span[-1])) for span in span_nm)
    x_values, y_values = samples.amplitudes[:, [0, 2]], samples.amplitudes[:, [1, 3]]
    width, length = samples.width_nm, samples.length_nm
    # With so many guided modes every degree of the denominator is needed, and there are the samples to decide it.
    simple = degrees[0] < MANY_MODES_DEGREE
    fit_to = partial(fit, width_range_nm=x_range, length_range_nm=y_range, degrees=degrees, simple=simple)
    if not exchange:
        x, y = (fit_to(width, length, values) for values in (x_values, y_values))
        return SizeModel(x, y)
    off_diagonal = width != length
    x = fit_to(
        np.concatenate([width, length[off_diagonal]]),
        np.concatenate([length, width[off_diagonal]]),
        np.concatenate([x_values, y_values[off_diagonal]]),
    )
    return SizeModel(x, x.exchanged())
