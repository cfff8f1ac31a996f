"""Interpolation between Chebyshev points."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from metafab.core.conventions import FloatArray

Span = tuple[float, float]


def points(span: Span, count: int) -> FloatArray:
    """Return the Chebyshev points of the first kind on ``span``, ascending, shape (count,)."""
    low, high = span
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * (np.arange(count) + 0.5) / count)


def interpolation(span: Span, count: int, at: FloatArray) -> FloatArray:
    """Return the matrix, shape (n, count), from values at :func:`points` to values at ``at``, shape (n,)."""
    low, high = span
    if high == low:
        return np.full((at.size, count), 1.0 / count)
    angles = np.arccos(np.clip((low + high - 2.0 * at) / (high - low), -1.0, 1.0))
    order = np.arange(count)
    cosines = np.cos(np.outer(angles, order)) * np.where(order == 0, 1.0, 2.0) / count
    return np.asarray(cosines @ np.cos(np.outer(order, np.pi * (order + 0.5) / count)))


def power_coefficients(function: Callable[[FloatArray], FloatArray], degree: int, span: Span) -> tuple[float, ...]:
    """Return the polynomial through a function of shape (n,) at Chebyshev points: coefficients, lowest power first."""
    series = np.polynomial.Chebyshev.interpolate(function, degree, domain=list(span))
    power = series.convert(kind=np.polynomial.Polynomial, domain=[-1.0, 1.0], window=[-1.0, 1.0])
    return tuple(float(c) for c in power.coef)


def points_needed(phase_rad: float, tolerance: float) -> int:
    """Return the number of points that represent exp(i ``phase_rad`` s), s from -1 to 1, to ``tolerance``.

    The Chebyshev coefficients are Bessel functions J_n(phase). At n = phase + x (phase / 2)^(1/3) they decay like the
    Airy function Ai(x), that is like exp(-2/3 x^(3/2)).
    """
    fall = math.pow(1.5 * math.log(1.0 / tolerance), 2.0 / 3.0)
    return 4 + math.ceil(phase_rad + fall * math.cbrt(0.5 * phase_rad))
