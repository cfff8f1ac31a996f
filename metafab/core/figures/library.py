"""Statistics of the build of a library and of its models, and its quality."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class BuildStatistics:
    """Statistics of a build, independent of the machine; NaN or 0 where one does not apply."""

    points_solved: int = 0  #: Sizes solved, on and off the grid.
    points_between: int = 0  #: Sizes solved off the grid.
    points_total: int = 0  #: Sizes of the library.
    points_left_out: int = 0  #: Rows of an imported sweep without a finite amplitude, which are left out.
    max_error: float = math.nan  #: Largest error bound of a size.
    sizes_beyond_target: int = 0  #: Sizes whose error bound is above the target error.
    max_solver_error: float = math.nan  #: Largest solver error in the error bounds.
    max_model_error: float = math.nan  #: Largest model error in the error bounds of unsolved sizes.
    max_between_error: float = math.nan  #: Largest error bound between the sizes; NaN if the library is not continuous.
    held_out_error: float = math.nan  #: Largest error of the model at sizes that it was not fitted to.
    held_out: int = 0  #: Number of these sizes.
    rounds: int = 0  #: Rounds of solving.
    numerator_degree: int = 0  #: Total degree of the model's numerators.
    denominator_degree: int = 0  #: Total degree of the model's denominator.
    #: Covered part of the phase circle (:func:`metafab.library.use.quality.coverage_rad`).
    coverage_rad: float = math.nan

    @property
    def is_imported(self) -> bool:
        """Whether another program solved the sizes, whose own error is in no error bound."""
        return self.points_solved > 0 and self.rounds == 0


@dataclass(frozen=True)
class CornerStatistics:
    """Statistics of the adaptive sampling over sizes and axes, equal on every machine."""

    points_solved: int = 0  #: Cells solved.
    rounds: int = 0  #: Rounds of solving.
    held_out: int = 0  #: Cells of the last round predicted before they were solved, without those chosen as the worst.
    held_out_error: float = math.nan  #: Largest error of these predictions.
    held_out_rms: float = math.nan  #: Rms error of these predictions.
    open_share: float = math.nan  #: Share of the box whose error estimate is above the tolerance.
    target: str = ""  #: "reached", or "not reached ..." with the reason.
    axis_weight: int = 0  #: Factor of an axis' power in the model's total degree.
    numerator_degree: int = 0  #: Total degree of the model's numerators.
    denominator_degree: int = 0  #: Total degree of the model's denominator.


@dataclass(frozen=True)
class LineStatistics:
    """Errors of one chain (the model of neighbours along one axis and polarisation) on solved rows.

    They are relative rms of the transmitted field over the propagating orders.
    """

    rows: int = 0  #: Rows that the chain was fitted to.
    held_out: int = 0  #: Rows kept out of the fit, from which the errors below were taken.
    local_period_error: float = math.nan  #: Rms error of the local-period approximation on the held-out rows.
    error: float = math.nan  #: Rms error of the chain on the held-out rows.
    error_unlike: float = math.nan  #: Rms error on held-out rows of random sizes.
    error_alike: float = math.nan  #: Rms error on held-out rows with phases that change steadily, as in a lens.
    #: Rms error of the local-period approximation on these; NaN in older files.
    local_period_error_alike: float = math.nan
    error_p90: float = math.nan  #: 90th percentile of the errors on rows with steady phases.
    error_fitted: float = math.nan  #: Rms error on the rows of the fit.
    solver_error: float = math.nan  #: Rms error of the solved rows, from a sample solved more finely.
    error_floor: float = math.nan  #: Smallest stated error of a row.
    #: Stated error above the floor, over the product of the row's predictors
    #: (:class:`metafab.library.neighbours.doubt.RowDoubts`), each to its power below.
    error_slope: float = math.nan
    error_power: float = 1.0  #: Power of the correction times the step: 0 in new trainings, 1 in the oldest files.
    error_power_correction: float = 0.0  #: Power of the correction.
    error_power_bend: float = 0.0  #: Power of the bend.
    error_power_gain: float = 0.0  #: Power of the gain.
    error_power_resonance: float = 0.0  #: Power of the resonance.


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Figures of merit of a library, for target phases spread evenly over the (phi_x, phi_y) torus."""

    coverage_rad: float  #: Covered part of the phase circle (:func:`metafab.library.use.quality.coverage_rad`).
    torus_coverage: float  #: Share of all pairs of phases that are covered.
    #: Largest distance of a pair of phases from the sizes with high transmittance, in the worse phase.
    worst_hole_rad: float
    worst_hole_phase_x_rad: float  #: Phase of x at that pair, in (-pi, pi].
    worst_hole_phase_y_rad: float  #: Phase of y at that pair, in (-pi, pi].
    phase_rms_error_rad: float  #: Rms phase error of the sizes with the best overlap, both polarisations.
    phase_max_error_rad: float  #: Largest phase error of these sizes.
    mean_transmittance: float  #: Mean power transmittance of these sizes.
    mean_overlap: float  #: Mean field overlap of these sizes; 1 for full transmittance without phase error.
    cd_phase_rms_rad: float  #: Rms phase change of these sizes when both sides grow by 5 nm, to first order.
