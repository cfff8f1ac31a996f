"""From several resolutions to the limit of vanishing pixels, with an error that the spread supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray


@dataclass(frozen=True)
class Extrapolated:
    """The limit and how far it can be trusted.

    Attributes:
        value: shape (n_values,).
        error: estimate of the largest absolute error among the values.
    """

    value: ComplexArray
    error: float


def richardson(pixel_um: Sequence[float], values: Sequence[ComplexArray]) -> Extrapolated:
    """Limit of v(h) = v + c_2 h^2 + c_4 h^4 + ... from grids that share their coordinates.

    The three finest grids give both coefficients, two give the first only. The error is the step from the last
    limit but one of second order to the last: corners of the pillar add powers between h^1.5 and h^3, of
    which grids in the ratios 1 : 2 : 3 : 4 leave less than that step.

    Args:
        pixel_um: at least two grid spacings, coarse to fine.
        values: for each, shape (n_values,).
    """
    if len(pixel_um) < 2 or len(pixel_um) != len(values):
        raise ValueError(f"`pixel_um`: expected two or more, as many as `values`, got {len(pixel_um)}")
    if any(fine >= coarse for coarse, fine in pairwise(pixel_um)):
        raise ValueError(f"`pixel_um`: expected descending grid spacings, got {tuple(pixel_um)}")
    h, v = np.asarray(pixel_um, dtype=np.float64), np.asarray(values, dtype=np.complex128)
    last = _limit(h[-2:], v[-2:])
    if len(h) == 2:
        # Nothing checks the order yet: the whole correction to the finer grid stays in doubt.
        return Extrapolated(last, float(np.max(np.abs(last - v[-1]))))
    before = _limit(h[-3:-1], v[-3:-1])
    return Extrapolated(_limit(h[-3:], v[-3:]), float(np.max(np.abs(last - before))))


def _limit(h: FloatArray, v: ComplexArray) -> ComplexArray:
    """Value at h = 0 of the polynomial in h^2 through all points."""
    return np.asarray(np.linalg.solve(np.vander(h**2, increasing=True).astype(np.complex128), v)[0])
