"""The model of neighbours that a library holds: one chain of coupled modes for each direction and polarisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from metafab.core.conventions import ComplexArray, Polarisation
from metafab.core.figures import LineStatistics
from metafab.library.neighbours.line import LineModel


@dataclass(frozen=True)
class TrainedLine:
    """One chain and its errors."""

    model: LineModel  #: The chain.
    statistics: LineStatistics  #: Errors on solved rows.
    #: Coupling of a block's lines: free elements of K, shape (n_pairs,); None where no blocks were solved.
    coupling: ComplexArray | None = None

    @property
    def compared(self) -> tuple[float, float]:
        """Rms errors of the chain and of the local-period approximation on held-out rows with steady phases.

        Files of older trainings do not hold the second: then both are those on all held-out rows.
        """
        known = self.statistics
        if math.isnan(known.local_period_error_alike):
            return known.error, known.local_period_error
        return known.error_alike, known.local_period_error_alike

    @property
    def pays(self) -> bool:
        """Whether the chain is not known to be worse than the local-period approximation (:attr:`compared`)."""
        error, local_period_error = self.compared
        return not error >= local_period_error


@dataclass(frozen=True)
class Neighbours:
    """Chains of coupled modes for rows along x and along y and for both polarisations."""

    #: Light polarised along the row, for rows along x and along y. Both are one chain if a rotation by 90 degrees maps
    #: the cell to itself.
    along: tuple[TrainedLine, TrainedLine]
    across: tuple[TrainedLine, TrainedLine]  #: Light polarised across the row, likewise.
    inputs_sha256: str = ""  #: Fingerprint of the training's inputs.
    #: Coupling of both polarisations in a block: free elements of all M
    #: (:mod:`metafab.library.neighbours.blocks.cross`), shape (n,); None where no blocks were solved.
    cross: ComplexArray | None = None

    def line(self, direction: int, polarisation: Polarisation) -> TrainedLine:
        """The chain of rows along x (``direction`` 0) or y (1); its sizes are (along the row, across the row)."""
        is_along = polarisation == ("x", "y")[direction]
        return (self.along if is_along else self.across)[direction]

    @property
    def uncoupled(self) -> Neighbours:
        """The model without the couplings of blocks."""
        return replace(self.with_couplings([None] * len(self.lines)), cross=None)

    def with_couplings(self, couplings: Sequence[ComplexArray | None]) -> Neighbours:
        """The model with the couplings of its distinct chains, shape (n_pairs,) each, in the order of :attr:`lines`."""
        lines = [replace(line, coupling=coupling) for line, coupling in zip(self.lines, couplings, strict=True)]
        half = len(lines) // 2
        return replace(self, along=(lines[0], lines[:half][-1]), across=(lines[half], lines[half:][-1]))

    @property
    def lines(self) -> tuple[TrainedLine, ...]:
        """The distinct chains."""
        return (self.along[0], self.across[0]) if self.shares_directions else (*self.along, *self.across)

    @property
    def overall(self) -> LineStatistics:
        """Statistics of all chains together: sums of the rows, rms of the errors."""
        every = [line.statistics for line in self.lines]
        errors = {
            name: math.sqrt(sum(getattr(one, name) ** 2 for one in every) / len(every))
            for name, value in vars(every[0]).items()
            if isinstance(value, float)
        }
        return LineStatistics(sum(one.rows for one in every), sum(one.held_out for one in every), **errors)

    @property
    def pays(self) -> bool:
        """Whether every chain pays (:attr:`TrainedLine.pays`)."""
        return all(line.pays for line in self.lines)

    @property
    def warning(self) -> str | None:
        """A sentence, without its full stop, about the worst chain that does not pay; None if all do."""
        failing = [line.compared for line in self.lines if not line.pays]
        if not failing:
            return None
        error, local_period_error = max(failing, key=lambda errors: errors[0] / errors[1])
        return (
            f"a chain of the model of neighbours does not lower the error: {error:.3f} of the field on held-out rows, "
            f"{local_period_error:.3f} without it"
        )

    @property
    def summary(self) -> str:
        """Errors on held-out rows with and without the model, in one line."""
        overall = self.overall
        return (
            f"relative error {overall.error:.3f} on held-out rows, {overall.local_period_error:.3f} without the model"
        )

    @property
    def shares_directions(self) -> bool:
        """Whether rows along x and along y have the same chains."""
        return self.along[0] is self.along[1] and self.across[0] is self.across[1]
