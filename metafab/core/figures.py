"""Figures that the steps of a run compute and store: the entries of ``summary.json`` and of the steps' own files.

They are defined below the packages that compute them, so that a run without stale steps imports none of these packages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from metafab.core.conventions import FloatArray
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
    min_gap_nm: float | None  #: Smallest gap between neighbours; None for a single pillar.
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
    #: Retardance (mean phase of y polarisation minus that of x) less that of the design's targets, in (-pi, pi]; chosen
    #: to suit the library unless ``rules.retardance`` keeps it.
    retardance_error_rad: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: ``efficiency`` by the library's model of neighbours, where sizes were chosen by it; by a table, that of sampled
    #: windows of the mask.
    neighbour_efficiency: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: ``neighbour_efficiency`` of the sizes that suit equal neighbours best.
    neighbour_efficiency_before: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: Rms phase error of the field among neighbours, averaged along rows over about a period, with the chosen sizes.
    neighbour_phase_rms_error_rad: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: ``neighbour_phase_rms_error_rad`` of the sizes that suit equal neighbours best.
    neighbour_phase_rms_error_before_rad: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: Error bound of the library in complex t, rms over the pillars.
    library_error: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: Largest error bound of a size that is used.
    worst_library_error: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    #: Number of pillars whose size is beyond the library's target error.
    doubtful_pillars: int | None = field(default=None, metadata={"optional": True}, kw_only=True)

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


@dataclass(frozen=True)
class Wavefront:
    """Overlap of the field behind a mask with the target wave, for x and y polarisation."""

    overlap: tuple[float, float]  #: |<a u*>|^2 / <|a|^2> over sites with a pillar.
    error: tuple[float, float]  #: Statistical error of ``overlap``, as rows are sampled.
    best_overlap: tuple[float, float]  #: Overlap with continuous sizes, chosen as in the mapping.
    filled: float  #: Share of the sites in the aperture that carry a pillar.
    sites: int  #: Number of sampled sites with a pillar.


@dataclass(frozen=True)
class Loss:
    """One factor of the loss chain."""

    stage: str  #: Cause of the loss.
    factor: tuple[float, float] | None  #: Remaining share of x and of y polarised light; None if it was not measured.


@dataclass(frozen=True)
class SpaceVariance:
    """Image points and aberrations of both polarisations over a grid of object directions."""

    tangent_x: FloatArray  #: Shape (n_x,), x/z of the object.
    tangent_y: FloatArray  #: Shape (n_y,), y/z of the object.
    defocus_dioptre: FloatArray  #: Shape (2, n_y, n_x), change of vergence, positive as for a nearer object.
    astigmatism_dioptre: FloatArray  #: Shape (2, n_y, n_x), half the vergence along x minus that along y.
    distortion_um: FloatArray  #: Shape (2, n_y, n_x, 2), deviation from the image by a pinhole at the lens centre.


@dataclass(frozen=True)
class ToleranceRow:
    """One corner compared with the nominal mask; each figure is the worst of both polarisations and all depths.

    For random faults, ``change``, ``turn_deg`` and ``depth_error_m`` are the rms over the draws, the others their mean.
    """

    corner: str  #: Name of the corner or fault.
    change: float  #: Relative L2 change of the irradiance.
    peak_ratio: float  #: Smallest peak over the nominal peak.
    efficiency: float  #: Smallest share of the power in the window.
    efficiency_change: float  #: Signed change of ``efficiency`` where its modulus is largest.
    #: Smallest ratio of wanted over unwanted light in the window of x; NaN where one window holds both polarisations.
    extinction_ratio: float
    #: Signed turn of the main lobe of PSF_x where its modulus is largest; NaN where the lobe lies on the image point.
    turn_deg: float
    #: Signed error of the decoded depth where its modulus is largest, over finite depths; NaN where the pair does not
    #: turn, no trial depth agrees, or one window holds both images.
    depth_error_m: float
    #: Relative error of these changes, from the error of the corner's amplitudes or the number of draws.
    relative_error: float
    draws: int = 0  #: Number of random masks; 0 for a corner of the cell.
    solved: int = 0  #: Number of cells solved for the row.
    #: Whether the change of the PSFs is within their error, so that the row is an upper bound.
    below_error: bool = False
    #: Full width at half maximum of a lens' focus along x, and along y, at the focus depth, as in
    #: :class:`FocusFigures`; NaN for other devices and where the window is too narrow.
    fwhm_x_um: float = math.nan
    fwhm_y_um: float = math.nan
    strehl: float = math.nan  #: Strehl ratio there, likewise.


@dataclass(frozen=True)
class ToleranceTable:
    """All fabrication corners of a mask."""

    depth_m: FloatArray  #: Shape (n_depth,), object depths.
    error: float  #: Relative L2 error of any PSF; smaller changes are not significant.
    block_sites: int  #: Lattice sites along the side of a pupil block.
    nominal: ToleranceRow  #: The mask without faults.
    rows: tuple[ToleranceRow, ...]  #: Corners and random faults.


@dataclass(frozen=True)
class SegmentFigures:
    """Depth and contrast of one segment; standard errors are those of photon and read noise."""

    number: int  #: Number of the segment, from 1, as in the segment map of the image.
    pixels: int  #: Pixels of the segment.
    depth_m: float  #: Depth at the middle of the segment.
    slope_x_per_m: float  #: Change of 1/depth per pixel along x, 1/m; 0 for a segment of one depth.
    slope_y_per_m: float  #: Change of 1/depth per pixel along y, 1/m.
    #: Standard error of ``depth_m`` by its likelihood; depths scatter by 1.3 to 1.45 times that, which ``confidence``
    #: counts. Infinite where most pixels are saturated: the segment then has no depth in the image.
    error_m: float
    contrast: float  #: I_x / I_y, mean over the interior of the segment.
    contrast_error: float  #: Standard error of ``contrast``.
    correlation: float  #: Normalised cross-correlation of the twin images at that depth, 0 to 1.


@dataclass(frozen=True)
class DecodingFigures:
    """Figures of the decoding of a frame; None where a figure does not apply.

    From ``share_decoded`` to ``contrast_error`` they compare with the truth, and are None without one.
    """

    reason: str | None = optional()  #: Why nothing was decoded.
    #: Why the calibration does not seem to be the camera's, or that many pixels are saturated.
    warning: str | None = optional()
    layers: int | None = optional()  #: Depths at which many pixels lie.
    basis_images: int | None = optional()  #: Basis kernels that each image was filtered with.
    step_px: int | None = optional()  #: Frame pixels from one compared pixel to the next.
    pixels: int | None = optional()  #: Pixels of the window.
    pixels_without_signal: int | None = optional()  #: Pixels without light.
    pixels_without_texture: int | None = optional()  #: Lit pixels without a depth.
    pixels_broken: int | None = optional()  #: Saturated pixels, and those that are not a number.
    #: Median over the pixels of the contrast's relative standard error.
    contrast_standard_error: float | None = optional()
    twin_mismatch: float | None = optional()  #: Share of the twins' power that neither noise nor depth explains.
    seconds: float | None = optional()  #: Time of decoding.
    share_decoded: float | None = optional()  #: Of the pixels with a true depth, the share with a decoded one.
    nmae_pixel: float | None = optional()  #: Mean |depth error| / depth of the pixels' own depths.
    #: Peak signal-to-noise ratio of the x image; the peak is the largest true intensity.
    psnr_x_db: float | None = optional()
    ssim_x: float | None = optional()  #: Structural similarity of the x image.
    psnr_y_db: float | None = optional()  #: Peak signal-to-noise ratio of the y image.
    ssim_y: float | None = optional()  #: Structural similarity of the y image.
    object_error: float | None = optional()  #: Mean over the true objects of the median relative error of depth.
    worst_object_error: float | None = optional()  #: The largest of these.
    contrast_error: float | None = optional()  #: Mean relative error of the true objects' contrasts.
    changed_share: float | None = optional()  #: Share of a film frame's pixels that were decoded again.


@dataclass(frozen=True)
class AberrationFigures:
    """Wavefront behind a lens against the sphere about its image point, in waves, positive where light arrives late.

    The image point of a design with phases of its own lies where their mean slope sends the light, which for coma is
    not the peak: the coefficients then have a tilt. Rms, Strehl ratio and map leave out piston and tilt, by the plane
    of least squares, since a tilt moves the image and does not blur it.

    Coefficients are those of least squares, weighted by power, over the circle of ``radius_um``. Fringe coefficients
    are amplitudes at the rim, Noll coefficients rms values.
    """

    polarisation: Literal["x", "y"]  #: Polarisation of the light.
    depth_m: float  #: Object depth.
    radius_um: float  #: Radius of the unit circle of the polynomials, half the aperture.
    rms_waves: float  #: Rms about the plane, weighted by power, over places within the circle.
    residual_waves: float  #: Rms of what the Noll polynomials leave.
    strehl_of_phase: float  #: Strehl ratio that these phases leave: |mean field|^2 over that without phase errors.
    noll_waves: FloatArray  #: Shape (36,), Noll coefficients from number 1, the piston.
    fringe_waves: FloatArray  #: Shape (36,), fringe coefficients from number 1, the piston.
    x_um: FloatArray  #: Shape (n_x,), middles of some blocks of pillars.
    y_um: FloatArray  #: Shape (n_y,).
    opd_waves: FloatArray  #: Shape (n_y, n_x), wavefront error about the plane; NaN where a block is dark.


@dataclass(frozen=True)
class FocusFigures:
    """Focus of a lens on the sensor, beside that of the ideal flat lens of its aperture, sharp at the focus depth.

    Widths are those of the density of electric energy in unpolarised light, the mean of both polarisations about their
    image points. Shares and the Strehl ratio are those of the flux.
    """

    depth_m: float  #: Object depth, the focus depth.
    numerical_aperture: float  #: Sine of half the angle of the aperture at the image point.
    #: Full width at half maximum along x through the maximum; likewise along y; NaN where the window is too narrow.
    fwhm_x_um: float
    fwhm_y_um: float
    fwhm_limit_um: float  #: That of the ideal lens, mean of both axes.
    #: Shape (2, 2), widths of x and of y polarised light along x and y.
    fwhm_polarised_um: tuple[tuple[float, ...], ...]
    fwhm_polarised_limit_um: tuple[tuple[float, ...], ...]  #: Shape (2, 2), those of the ideal lens.
    strehl: float  #: Maximum per transmitted power over that of the ideal lens.
    encircled_radius_um: float  #: 0.61 wavelength / NA, the radius of Airy's first dark ring.
    encircled_energy: float  #: Share of the transmitted light within that radius about the maximum.
    encircled_energy_limit: float  #: That of the ideal lens.
    offset_um: FloatArray  #: Shape (n,), distance from the maximum.
    section_x: FloatArray  #: Shape (n,), cross-section along x over the maximum; likewise along y.
    section_y: FloatArray
    section_limit: FloatArray  #: Shape (n,), cross-section of the ideal lens along x.
    radius_um: FloatArray  #: Shape (m,), radii of ``encircled`` and ``encircled_limit``.
    encircled: FloatArray  #: Shape (m,), share of the transmitted light within the radius.
    encircled_limit: FloatArray  #: Shape (m,), that of the ideal lens.


@dataclass(frozen=True, kw_only=True)
class OrderFigures:
    """One transmitted order of a mask whose pattern repeats, for one incident polarisation."""

    polarisation: Literal["x", "y"]  #: Polarisation of the incident light.
    order: tuple[int, ...]  #: Orders (m, n) of the repeat along x and y.
    angle_x_deg: float  #: Angle behind the mask whose sine is the direction's component along x; likewise y.
    angle_y_deg: float
    efficiency: float  #: Power over the incident power, by full wave.
    library_efficiency: float  #: The same by the library, each pillar among equal ones.
    error: float  #: Bound on the error of ``efficiency``: of the solver, and of the windows that were not solved.
    wanted: bool  #: Whether the library's light is at least half as bright as in its brightest order.


@dataclass(frozen=True, kw_only=True)
class OrdersFigures:
    """Orders of a mask whose pattern repeats, far from its rim, by full wave."""

    reason: str | None = optional()  #: Why they were not solved.
    sites: tuple[int, ...] | None = optional()  #: Pillars of a repeat along x and y.
    windows: int | None = optional()  #: Unlike repeats that were solved.
    coupling_error: float | None = optional()  #: Relative L2 error of the library's field.
    #: Of a steep lens: light in the wanted order of its rows by full wave, over that by the library.
    efficiency_ratio: float | None = optional()
    #: Wanted orders, and all others of 3 % of the light or more, brightest first, x then y polarisation.
    orders: tuple[OrderFigures, ...] = ()

    def wanted(self, polarisation: str) -> tuple[float, float, float]:
        """Efficiency, error and the library's efficiency, summed over the wanted orders of a polarisation."""
        rows = [row for row in self.orders if row.wanted and row.polarisation == polarisation]
        return (
            sum(row.efficiency for row in rows),
            sum(row.error for row in rows),
            sum(row.library_efficiency for row in rows),
        )

    @property
    def label(self) -> str:
        """Label of the sentence; rows of a lens measure the effect of neighbours, not orders."""
        return "wanted orders" if self.efficiency_ratio is None else "neighbours"

    @property
    def sentence(self) -> str:
        """Light in the wanted orders in words, or why it comes from the library alone."""
        if self.efficiency_ratio is not None:
            return (
                f"{self.windows} rows of the lens by full wave bring {self.efficiency_ratio:.2g} times the library's "
                "light into the focusing order: efficiency and peak are off by about that factor"
            )
        if self.sites is None:
            return f"by the library alone: {self.reason}"
        shares = [self.wanted(p) for p in ("x", "y")]
        text = ", ".join(
            f"{100 * e:.1f} ± {float(f'{100 * d:.1g}'):g} % of {p}" for p, (e, d, _) in zip("xy", shares, strict=True)
        )
        library = ", ".join(f"{100 * of_library:.1f}" for _, _, of_library in shares)
        return (
            f"{text} polarised light, by full wave of {self.sites[0]} x {self.sites[1]} pillars (library {library} %)"
        )
