"""Change of a library's amplitudes at a corner of the fabrication, fitted to a few sizes that are solved there.

Height, sidewalls, round corners and index move and widen the resonances of a pillar as other sizes would, and change
its phase and power smoothly:

    t_corner = exp(p) [t(width + q, length + r) + i (u dt/d(width) + v dt/d(length))],

with polynomials p (complex), q, r, u and v (real) of the sizes. A resonance that moves by more than its width needs the
shift inside t: by an expansion linear in q and r, Shen's cell with walls of 88 degrees was off by 0.2 to 0.3 of
the field. Beyond the library's sweep, t is continued by the library's model. The value at the end of the sweep, used
instead, misses resonances: one size of a sample then made the stated error 0.13, where the true one was 0.024.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.library import Library

#: Degrees of the polynomials: of the shifts of the sizes; of the logarithm and of the widening.
_SHIFT_DEGREE, _DEGREE = 2, 1
#: Prior of the fit: a coefficient of 1 nm, or of 1 in the logarithm, costs as much as this error of the field. It keeps
#: coefficients small that the sample leaves open.
_SHIFT_WEIGHT, _LOG_WEIGHT = 0.002, 0.02
#: Share of the sweep by which the library's model is continued on either side. Its error in Shen's cell, from 14
#: solved sizes at each distance below/above a sweep of 150 nm: 0.0005/0.002 of the field at 4 nm, 0.004/0.02 at 8 nm,
#: 0.01/0.03 at 12 nm and 0.12/0.16 at 16 nm. The value at the end of the sweep errs by 0.16/0.14 at 4 nm.
_BEYOND = 0.08
#: Half of the step of the numerical derivatives of the library's surface (nm), and most evaluations of the fit.
_HALF_STEP_NM, _EVALUATIONS = 0.5, 30
#: Standard errors of the mean square of the leave-one-out misses in the stated error.
_STANDARD_ERRORS = 2.0


def fitted_amplitudes(
    library: Library,
    size_nm: FloatArray,
    sample: NDArray[np.int64],
    changed: ComplexArray,
    groups: Sequence[tuple[int, ...]],
) -> tuple[ComplexArray, float]:
    """Return the amplitudes of all sizes at a corner, shape (n, 2), and a bound of their relative error.

    The bound is the leave-one-out error, with two standard errors of its mean square over the sample: a few sizes near
    resonances contribute most of it.

    Args:
        library: a continuous library.
        size_nm: shape (n, 2), width and length.
        sample: indices of the sizes whose change is solved.
        changed: shape (n_sample, 2), their amplitudes at the corner for x and y polarisation.
        groups: polarisations, 0 and 1, of each fit; those of one group share its coefficients, which refer to the sides
            along and across the polarisation.
    """
    fitted, missed = np.empty(size_nm.shape, dtype=np.complex128), []
    for group in groups:
        some = _Sizes(library, size_nm[sample], group)
        wanted = changed[:, group]

        def misfit(coefficients: FloatArray, some: _Sizes = some, wanted: ComplexArray = wanted) -> FloatArray:
            """Real and imaginary parts of the misses, all of one size side by side, and the weighted coefficients."""
            miss = some.amplitudes(coefficients) - wanted
            return np.concatenate([miss.view(np.float64).ravel(), _WEIGHTS * coefficients])

        found = least_squares(misfit, np.zeros(_WEIGHTS.size), x_scale=_SHIFT_WEIGHT / _WEIGHTS, max_nfev=_EVALUATIONS)
        missed.append(_left_out(found.fun, np.asarray(found.jac), len(sample), 2 * len(group)).reshape(len(sample), -1))
        fitted[:, group] = _Sizes(library, size_nm, group).amplitudes(found.x)
    square = np.sum(np.concatenate(missed, axis=1) ** 2, axis=1)
    bound = square.sum() + _STANDARD_ERRORS * math.sqrt(len(sample)) * float(square.std())
    return fitted, math.sqrt(bound) / float(np.linalg.norm(changed))


def _terms(degree: int) -> int:
    return (degree + 1) * (degree + 2) // 2


#: Numbers of coefficients of q, r, u, v and of both parts of p, and the weight of each coefficient.
_COUNTS = (_terms(_SHIFT_DEGREE),) * 2 + (_terms(_DEGREE),) * 4
_WEIGHTS = np.repeat([_SHIFT_WEIGHT] * 4 + [_LOG_WEIGHT] * 2, _COUNTS)


def _left_out(misfit: FloatArray, jacobian: FloatArray, sizes: int, size_rows: int) -> FloatArray:
    """Leave-one-out misfit of each size, to first order in the coefficients; ``size_rows`` rows belong to a size."""
    projected = jacobian @ np.linalg.pinv(jacobian)
    missed = []
    for first in range(0, sizes * size_rows, size_rows):
        rows = slice(first, first + size_rows)
        missed.append(np.linalg.lstsq(np.eye(size_rows) - projected[rows, rows], misfit[rows], rcond=1e-6)[0])
    return np.concatenate(missed)


@dataclass(frozen=True)
class _Sizes:
    """Sizes whose amplitudes are changed."""

    #: Its surface gives t and its slopes; beyond the sweep its model, if it has one, or the surface at the end.
    library: Library
    size_nm: FloatArray  #: Shape (n, 2).
    group: tuple[int, ...]  #: Polarisations.

    def amplitudes(self, coefficients: FloatArray) -> ComplexArray:
        """Amplitudes with the change of these coefficients, shape (n, len(group))."""
        q, r, u, v, real, imaginary = np.split(coefficients, np.cumsum(_COUNTS)[:-1])
        columns = []
        for p in self.group:
            shift_powers, powers = self._powers(p, _SHIFT_DEGREE), self._powers(p, _DEGREE)
            moved = self.size_nm.copy()
            moved[:, p] += shift_powers @ q
            moved[:, 1 - p] += shift_powers @ r
            at = self._surface(moved, p)
            at += 1j * ((powers @ u) * self._slope(moved, p, p) + (powers @ v) * self._slope(moved, 1 - p, p))
            columns.append(at * np.exp(powers @ (real + 1j * imaginary)))
        return np.stack(columns, axis=1)

    def _ends(self) -> tuple[FloatArray, FloatArray]:
        sides = (self.library.width_nm, self.library.length_nm)
        return np.array([side[0] for side in sides]), np.array([side[-1] for side in sides])

    def _reach(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest width and length with an amplitude of their own."""
        low, high = self._ends()
        beyond = _BEYOND * (high - low) if self.library.model is not None else 0.0
        return low - beyond, high + beyond

    def _powers(self, along: int, degree: int) -> FloatArray:
        """Products of powers of the sides along and across a polarisation, from -1 to 1 in the sweep: (n, terms)."""
        low, high = self._ends()
        place = (2.0 * self.size_nm - low - high) / np.maximum(high - low, 1.0)
        u, v = place[:, along], place[:, 1 - along]
        return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)

    def _surface(self, size_nm: FloatArray, polarisation: int) -> ComplexArray:
        (low, high), model = self._ends(), self.library.model
        found = self.library.surface(*np.clip(size_nm, low, high).T)
        t = found.t_yy if polarisation else found.t_xx
        if model is not None:
            beyond = np.any((size_nm < low) | (size_nm > high), axis=1)
            t[beyond] = model(*np.clip(size_nm[beyond], *self._reach()).T)[:, polarisation]
        return t

    def _slope(self, size_nm: FloatArray, side: int, polarisation: int) -> ComplexArray:
        """Derivative of the amplitude over the width (0) or the length (1), per nm."""
        low, high = self._reach()
        ends = []
        for step in (-_HALF_STEP_NM, _HALF_STEP_NM):
            at = np.clip(size_nm, low, high)
            at[:, side] = np.clip(at[:, side] + step, low[side], high[side])
            ends.append((at[:, side], self._surface(at, polarisation)))
        (left, t_left), (right, t_right) = ends
        return np.asarray((t_right - t_left) / (right - left))
