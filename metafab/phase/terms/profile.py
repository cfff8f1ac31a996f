"""Target phases as functions of position: a profile is a sum of terms, evaluated tile by tile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation


class Term(Protocol):
    """One summand of a target phase."""

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase in radians (not wrapped) on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x)."""


@dataclass(frozen=True)
class PhaseProfile:
    """The target transmission phase of both polarisations.

    Attributes:
        terms: summands; each is zero for a polarisation that it does not act on.
        figures: what the design step measured (``peak_gain``, ``rotation_deg``, ...), for the summary.
    """

    terms: tuple[Term, ...]
    figures: dict[str, float]

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Phase of both polarisations on a rectangular grid.

        Args:
            x_um: shape (n_x,), positions from the optical axis.
            y_um: shape (n_y,).

        Returns:
            Shape (2, n_y, n_x), radians, not wrapped; first axis x and y polarisation.
        """
        if not self.terms:  # A lens alone, without its carrier.
            return np.zeros((2, y_um.size, x_um.size))
        total = np.empty((2, y_um.size, x_um.size))
        first, *others = self.terms
        for index, polarisation in enumerate(POLARISATIONS):
            total[index] = first(x_um, y_um, polarisation)
            for term in others:
                total[index] += term(x_um, y_um, polarisation)
        return total

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Return exp(i phase) on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,), shape (2, n_y, n_x)."""
        return np.asarray(np.exp(1j * self(x_um, y_um)))
