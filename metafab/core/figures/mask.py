"""Figures of the target phases, of the pillars that follow them, and of the time that the e-beam takes."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from metafab.core.storage.tables import optional


@dataclass(frozen=True)
class PhaseFigures:
    """Key figures of a profile, under the names of the summary; None where a figure does not apply.

    A figure with "gain" is relative to the plain spiral of Shen 2023, Eq. 2.
    """

    peak_gain: float | None = optional()  #: Gain of the mean peak of the main lobe over the full turn.
    worst_gain: float | None = optional()  #: Gain of the smallest peak.
    peak_mean: float | None = optional()  #: Mean peak, Strehl ratio.
    #: Mean (or, for "worst_peak", smallest) Strehl ratio at the target points.
    target_reached: float | None = optional()
    target_bound: float | None = optional()  #: Upper bound of ``target_reached`` for any mask.
    bound_fraction: float | None = optional()  #: ``target_reached`` over ``target_bound``.
    side_lobe: float | None = optional()  #: Limited side lobe over the main lobe.
    side_lobe_without_limit: float | None = optional()  #: Side lobe over the main lobe without a limit.
    blind_information_gain: float | None = optional()  #: Gain of the depth information for unknown texture.
    #: Turn of the main lobe of PSF_x from the nearest to the farthest depth of ``[verify]``, degrees,
    #: counter-clockwise, by the paraxial pupil.
    rotation_deg: float | None = optional()
    rotation_deg_per_dioptre: float | None = optional()  #: Slope of that turn over the vergence.
    #: The slope of the zones of the plain spiral, or the law of rotation that an optimised lobe is steered by.
    rotation_deg_per_dioptre_theory: float | None = optional()
    hologram_efficiency: float | None = optional()  #: Share of the light in the picture.
    hologram_correlation: float | None = optional()  #: Pearson correlation of irradiance and picture.


@dataclass(frozen=True)
class Remedy:
    """A change of the design that reduces the loss of depth accuracy by a wide filter."""

    change: str  #: Description.
    information_kept: float  #: Information over that at one wavelength with equal electrons.
    #: Cramer-Rao bound of depth over that of the unchanged design, with the electrons that the change lets through.
    depth_error_factor: float


@dataclass(frozen=True)
class MappingFigures:
    """How well the pillars of a lens follow the target phases; the fields in ``_x``, ``_y`` are of one polarisation."""

    pillars: int  #: Number of pillars.
    distinct_sizes: int  #: Number of different sizes among them.
    #: Smallest gap between neighbours as they stand, without ``mask.bias_nm``; None for a single pillar.
    min_gap_nm: float | None
    phase_rms_error_rad: float  #: Rms over both polarisations, after the constant phases of the mapping.
    mean_transmittance: float  #: Power transmittance, mean over pillars and polarisations.
    mean_transmittance_x: float
    mean_transmittance_y: float
    field_overlap: float  #: |<target, t>|^2 / (<target, target> <t, t>), mean of both polarisations.
    field_overlap_x: float
    field_overlap_y: float
    #: Transmittance times overlap, the share of power in the wanted wave, mean of both polarisations.
    efficiency: float
    efficiency_x: float
    efficiency_y: float
    _: KW_ONLY
    #: Retardance (mean phase of y polarisation minus that of x) less that of the design's targets, in (-pi, pi]; chosen
    #: to suit the library unless ``rules.retardance`` keeps it.
    retardance_error_rad: float | None = optional()
    #: ``efficiency`` by the library's model of neighbours, where sizes were chosen by it; by a table, that of sampled
    #: windows of the mask.
    neighbour_efficiency: float | None = optional()
    #: ``neighbour_efficiency`` of the sizes that suit equal neighbours best.
    neighbour_efficiency_before: float | None = optional()
    #: Rms phase error of the field among neighbours, averaged along rows over about a period, with the chosen sizes.
    neighbour_phase_rms_error_rad: float | None = optional()
    #: ``neighbour_phase_rms_error_rad`` of the sizes that suit equal neighbours best.
    neighbour_phase_rms_error_before_rad: float | None = optional()
    #: Error bound of the library in complex t, rms over the pillars.
    library_error: float | None = optional()
    #: Largest error bound of a size that is used.
    worst_library_error: float | None = optional()
    #: Number of pillars whose size is beyond the library's target error.
    doubtful_pillars: int | None = optional()

    def warnings(self) -> list[str]:
        """Return a sentence about pillars whose response is not known to the target error."""
        if not self.doubtful_pillars:
            return []
        share = 100.0 * self.doubtful_pillars / self.pillars
        return [
            f"{share:.3g} % of the pillars have sizes beyond the library's target error, known to "
            f"{self.worst_library_error:.2g} at worst; no other size serves these phases as well"
        ]


@dataclass(frozen=True)
class LightMapping:
    """How well the pillars follow the target phases of one of several lights."""

    wavelength_nm: float  #: Vacuum wavelength.
    weight: float  #: Weight in the choice of sizes.
    offsets_rad: tuple[float, ...]  #: Constants added to the target phases of x and y polarisation.
    figures: MappingFigures  #: Figures at this wavelength.
    angle_x_deg: float = 0.0  #: Angle of incidence in the x-z plane, in the medium of incidence.
    angle_y_deg: float = 0.0  #: Likewise in the y-z plane.


@dataclass(frozen=True)
class WriteTime:
    """Time that the e-beam takes, without blanking, alignment, further stage moves and loading."""

    area_um2: float  #: Exposed area.
    shapes: int  #: Exposed shapes.
    trapezoids: int  #: Trapezoids of these shapes.
    #: Shots of the trapezoids; None without a shot size, or where the field is exposed and not the pillars.
    shots: int | None
    fields: int  #: Write fields that hold any shape.
    beam_seconds: float  #: Dose x area / current; longer where the largest rate of shots limits it.
    settling_seconds: float  #: Settling of trapezoids and fields.
    seconds: float  #: Sum of both.
    stitching_rms_nm: float | None = None  #: Rms of the drift between neighbouring fields; None without a drift.
    stitching_max_nm: float | None = None  #: Its largest value.
