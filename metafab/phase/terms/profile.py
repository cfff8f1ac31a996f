"""Target phases as functions of position: a profile is a sum of terms, evaluated tile by tile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError
from metafab.core.figures import PhaseFigures
from metafab.core.numeric.phasor import phasor


class Term(Protocol):
    """One summand of a target phase."""

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Evaluate the phase at x, shape (n_x,), and y from the axis: shape (n_y, n_x), radians, not wrapped."""


@dataclass(frozen=True)
class PolarisedTerm(ABC):
    """Base of the terms: zero for a polarisation that the term does not act on."""

    #: The polarisation that the term acts on; None for both.
    polarisation: Polarisation | None = field(default=None, kw_only=True)

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Evaluate the phase on a rectangular grid; shapes and units as in :class:`Term`."""
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        return self._phase(x_um, y_um, polarisation)

    @abstractmethod
    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase where the term acts; shapes and units as in :class:`Term`."""


@dataclass(frozen=True)
class SumTerm:
    """The sum of several terms."""

    terms: tuple[Term, ...]  #: Summands.

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Evaluate the phase on a rectangular grid; shapes and units as in :class:`Term`."""
        return np.asarray(sum(term(x_um, y_um, polarisation) for term in self.terms))


#: Places at which the shape of each term of a profile is tried, um: two rows of three, so that exchanged axes show.
_TRIED_X_UM, _TRIED_Y_UM = np.array([-1.0, 0.0, 1.0]), np.array([-0.5, 0.5])


@dataclass(frozen=True)
class PhaseProfile:
    """The target transmission phase of both polarisations.

    Raises:
        InputError: ``terms`` is no sequence, or a term does not return real phases of shape (n_y, n_x).
    """

    terms: tuple[Term, ...]  #: Summands; each is zero for a polarisation that it does not act on.
    figures: PhaseFigures = field(default_factory=PhaseFigures)  #: Key figures of the phase design.

    def __post_init__(self) -> None:
        """Try the shape of each term."""
        if not isinstance(self.terms, Sequence):
            got = f"one {type(self.terms).__name__}"
            raise InputError.single("phase", "terms", "a sequence of terms", got, "put it in a tuple, (term,)")
        for number, term in enumerate(self.terms):
            with np.errstate(all="ignore"):
                phase = np.asarray(term(_TRIED_X_UM, _TRIED_Y_UM, "x"))
            shape = _TRIED_Y_UM.size, _TRIED_X_UM.size
            if phase.dtype.kind not in "fiu" or not _fits(phase.shape, shape):
                expected = f"real radians of shape (n_y, n_x), {shape} at 3 values of x and 2 of y"
                got = f"{phase.dtype} of shape {phase.shape}"
                remedy = "x varies along the last axis: x_um, y_um[:, None]"
                raise InputError.single("phase", f"terms[{number}]", expected, got, remedy)

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Evaluate the phase of x and y polarisation at x, shape (n_x,), and y, shape (n_y,), from the axis.

        The shape is (2, n_y, n_x), radians, not wrapped. A sum that is not finite raises InputError.
        """
        total = np.zeros((2, y_um.size, x_um.size))
        for index, polarisation in enumerate(POLARISATIONS):
            for term in self.terms:
                total[index] += term(x_um, y_um, polarisation)
        if not np.isfinite(total.sum()):
            lost = np.count_nonzero(~np.isfinite(total))
            expected, got = "finite radians at all places, beyond the aperture too", f"NaN or infinity at {lost}"
            remedy = "give places without a phase any number: numpy.nan_to_num"
            raise InputError.single("phase", "terms", expected, f"{got} of {total.size}", remedy)
        return total

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Evaluate exp(i phase), shape (2, n_y, n_x), at positions of shapes (n_x,) and (n_y,) from the axis."""
        return phasor(self(x_um, y_um))


def _fits(shape: tuple[int, ...], into: tuple[int, int]) -> bool:
    """Whether an array of ``shape`` fills one of shape ``into`` by broadcasting."""
    try:
        return np.broadcast_shapes(shape, into) == into
    except ValueError:
        return False
