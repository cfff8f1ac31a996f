"""Target phases as functions of position: a profile is a sum of terms, evaluated tile by tile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
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


@dataclass(frozen=True)
class PhaseProfile:
    """The target transmission phase of both polarisations."""

    terms: tuple[Term, ...]  #: Summands; each is zero for a polarisation that it does not act on.
    figures: PhaseFigures = field(default_factory=PhaseFigures)  #: Key figures of the phase design.

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Evaluate the phase of x and y polarisation at x, shape (n_x,), and y, shape (n_y,), from the axis.

        The shape is (2, n_y, n_x), radians, not wrapped.
        """
        total = np.zeros((2, y_um.size, x_um.size))
        for index, polarisation in enumerate(POLARISATIONS):
            for term in self.terms:
                total[index] += term(x_um, y_um, polarisation)
        return total

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Evaluate exp(i phase), shape (2, n_y, n_x), at positions of shapes (n_x,) and (n_y,) from the axis."""
        return phasor(self(x_um, y_um))
