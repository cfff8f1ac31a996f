"""Target phases as functions of position: a profile is a sum of terms, evaluated tile by tile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from typing import Protocol

import numpy as np

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation


class Term(Protocol):
    """One summand of a target phase."""

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Evaluate the phase on a rectangular grid.

        Args:
            x_um: shape (n_x,), positions from the optical axis.
            y_um: shape (n_y,), positions from the optical axis.
            polarisation: "x" or "y".

        Returns:
            Shape (n_y, n_x), radians, not wrapped.
        """


@dataclass(frozen=True)
class PolarisedTerm(ABC):
    """Base of the terms: zero for a polarisation that the term does not act on.

    Attributes:
        polarisation: the polarisation that the term acts on; None for both.
    """

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
class PhaseFigures:
    """Key figures of a profile, under the names of the summary; None where a figure does not apply.

    A figure with "gain" is relative to the plain spiral of Eq. 2.

    Attributes:
        peak_gain: gain of the mean peak of the main lobe over the full turn.
        worst_gain: gain of the smallest peak.
        peak_mean: mean peak, Strehl ratio.
        target_reached: mean (or, for "worst_peak", smallest) Strehl ratio at the target points.
        target_bound: upper bound of ``target_reached`` for any mask.
        bound_fraction: ``target_reached`` over ``target_bound``.
        side_lobe: limited side lobe over the main lobe.
        side_lobe_without_limit: the same ratio without a limit.
        blind_information_gain: gain of the depth information for unknown texture.
        rotation_deg: turn of the main lobe of PSF_x from the nearest to the farthest depth of ``[verify]``, degrees,
            counter-clockwise, by the paraxial pupil.
        rotation_deg_per_dioptre: slope of that turn over the vergence.
        rotation_deg_per_dioptre_theory: the slope of the zones of the plain spiral, or the law of rotation that an
            optimised lobe is steered by.
        hologram_efficiency: share of the light in the picture.
        hologram_correlation: Pearson correlation of irradiance and picture.
    """

    peak_gain: float | None = None
    worst_gain: float | None = None
    peak_mean: float | None = None
    target_reached: float | None = None
    target_bound: float | None = None
    bound_fraction: float | None = None
    side_lobe: float | None = None
    side_lobe_without_limit: float | None = None
    blind_information_gain: float | None = None
    rotation_deg: float | None = None
    rotation_deg_per_dioptre: float | None = None
    rotation_deg_per_dioptre_theory: float | None = None
    hologram_efficiency: float | None = None
    hologram_correlation: float | None = None

    def applicable(self) -> dict[str, float]:
        """Figures that apply, by name."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class PhaseProfile:
    """The target transmission phase of both polarisations.

    Attributes:
        terms: summands; each is zero for a polarisation that it does not act on.
        figures: key figures of the phase design.
    """

    terms: tuple[Term, ...]
    figures: PhaseFigures = PhaseFigures()

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Evaluate the phase of both polarisations on a rectangular grid.

        Args:
            x_um: shape (n_x,), positions from the optical axis.
            y_um: shape (n_y,), positions from the optical axis.

        Returns:
            Shape (2, n_y, n_x), radians, not wrapped; first axis x and y polarisation.
        """
        total = np.zeros((2, y_um.size, x_um.size))
        for index, polarisation in enumerate(POLARISATIONS):
            for term in self.terms:
                total[index] += term(x_um, y_um, polarisation)
        return total

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Evaluate exp(i phase) on a rectangular grid.

        Args:
            x_um: shape (n_x,), positions from the optical axis.
            y_um: shape (n_y,), positions from the optical axis.

        Returns:
            Shape (2, n_y, n_x); first axis x and y polarisation.
        """
        return np.asarray(np.exp(1j * self(x_um, y_um)))
