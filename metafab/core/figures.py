"""Figures that a room computes and a run stores: the entries of ``summary.json`` and of the files that rooms write.

They are defined below all rooms, so that a run without stale steps reads them back without importing a room.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from metafab.core.conventions import FloatArray
from metafab.core.storage.tables import optional


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

    peak_gain: float | None = optional()
    worst_gain: float | None = optional()
    peak_mean: float | None = optional()
    target_reached: float | None = optional()
    target_bound: float | None = optional()
    bound_fraction: float | None = optional()
    side_lobe: float | None = optional()
    side_lobe_without_limit: float | None = optional()
    blind_information_gain: float | None = optional()
    rotation_deg: float | None = optional()
    rotation_deg_per_dioptre: float | None = optional()
    rotation_deg_per_dioptre_theory: float | None = optional()
    hologram_efficiency: float | None = optional()
    hologram_correlation: float | None = optional()


@dataclass(frozen=True)
class Remedy:
    """A change that lowers the cost of a filter.

    Attributes:
        change: description.
        information_kept: information over that of one wavelength with the same electrons.
        depth_error_factor: Cramer-Rao bound of depth over that of the unchanged design, with the electrons that the
            change lets through.
    """

    change: str
    information_kept: float
    depth_error_factor: float


@dataclass(frozen=True)
class MappingFigures:
    """How well the pillars of a lens follow the target phases; the fields in ``_x``, ``_y`` are of one polarisation.

    Attributes:
        pillars: number of pillars.
        distinct_sizes: number of different sizes among them.
        min_gap_nm: smallest gap between neighbours; None for a single pillar.
        phase_rms_error_rad: rms over both polarisations, after the constant phases of the mapping.
        mean_transmittance: power transmittance, mean over pillars and polarisations.
        field_overlap: |<target, t>|^2 / (<target, target> <t, t>), mean of both polarisations.
        efficiency: transmittance times overlap, the share of power in the wanted wave, mean of both polarisations.
        neighbour_efficiency: that share by the library's model of neighbours, where sizes were chosen by it.
        neighbour_efficiency_before: the same of the sizes that suit lone pillars best.
        library_error: error bound of the library in complex t, rms over the pillars.
        worst_library_error: largest error bound of a size that is used.
        doubtful_pillars: number of pillars whose size is beyond the library's target error.
    """

    pillars: int
    distinct_sizes: int
    min_gap_nm: float | None
    phase_rms_error_rad: float
    mean_transmittance: float
    mean_transmittance_x: float
    mean_transmittance_y: float
    field_overlap: float
    field_overlap_x: float
    field_overlap_y: float
    efficiency: float
    efficiency_x: float
    efficiency_y: float
    neighbour_efficiency: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    neighbour_efficiency_before: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    library_error: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    worst_library_error: float | None = field(default=None, metadata={"optional": True}, kw_only=True)
    doubtful_pillars: int | None = field(default=None, metadata={"optional": True}, kw_only=True)

    def warnings(self) -> list[str]:
        """Return a sentence about pillars whose response is not known to the target error."""
        if not self.doubtful_pillars:
            return []
        share = 100.0 * self.doubtful_pillars / self.pillars
        return [
            f"{share:.2g} % of the pillars have sizes beyond the library's target error, known to "
            f"{self.worst_library_error:.2g} at worst; no other size serves these phases as well"
        ]


@dataclass(frozen=True)
class Wavefront:
    """Overlap of the field behind a mask with the target wave, for x and y polarisation.

    Attributes:
        overlap: |<a u*>|^2 / <|a|^2> over sites with a pillar.
        error: statistical error of ``overlap``, as rows are sampled.
        best_overlap: overlap with continuous sizes, chosen as in the mapping.
        filled: share of the sites in the aperture that carry a pillar.
        sites: number of sampled sites with a pillar.
    """

    overlap: tuple[float, float]
    error: tuple[float, float]
    best_overlap: tuple[float, float]
    filled: float
    sites: int


@dataclass(frozen=True)
class Loss:
    """One factor of the chain.

    Attributes:
        stage: cause of the loss.
        factor: remaining share of x and of y polarised light; None if it was not measured.
    """

    stage: str
    factor: tuple[float, float] | None


@dataclass(frozen=True)
class ToleranceRow:
    """One corner compared with the nominal mask; each figure is the worst of both polarisations and all depths.

    For random faults, ``change``, ``turn_deg`` and ``depth_error_m`` are the rms over the draws, the others their mean.

    Attributes:
        corner: name of the corner or fault.
        change: relative L2 change of the irradiance.
        peak_ratio: smallest peak over the nominal peak.
        efficiency: smallest share of the power in the window.
        efficiency_change: signed change of that share of the largest modulus.
        extinction_ratio: smallest ratio of wanted over unwanted light in the window of x.
        turn_deg: signed turn of the main lobe of PSF_x of the largest modulus.
        depth_error_m: signed error of the decoded depth of the largest modulus, over finite depths; NaN where the pair
            does not turn or no trial depth agrees.
        relative_error: error of the changes over the changes, from the corner's amplitudes or the number of draws.
        draws: number of random masks; 0 for a corner of the cell.
        solved: number of cells solved for the row.
        below_error: whether the change of the PSFs is within their error, so that the row is an upper bound.
    """

    corner: str
    change: float
    peak_ratio: float
    efficiency: float
    efficiency_change: float
    extinction_ratio: float
    turn_deg: float
    depth_error_m: float
    relative_error: float
    draws: int = 0
    solved: int = 0
    below_error: bool = False


@dataclass(frozen=True)
class ToleranceTable:
    """All fabrication corners of a mask.

    Attributes:
        depth_m: shape (n_depth,), object depths.
        error: relative L2 error of any PSF; smaller changes are not significant.
        block_sites: lattice sites along the side of a pupil block.
        nominal: the mask without faults.
        rows: corners and random faults.
    """

    depth_m: FloatArray
    error: float
    block_sites: int
    nominal: ToleranceRow
    rows: tuple[ToleranceRow, ...]


@dataclass(frozen=True)
class SegmentFigures:
    """Depth and contrast of one segment; standard errors are those of photon and read noise.

    Attributes:
        number: number of the segment, from 1, as in the segment map of the image.
        pixels: pixels of the segment.
        depth_m: depth at the middle of the segment.
        slope_x_per_m: change of 1/depth per pixel along x, 1/m; 0 for a segment of one depth.
        slope_y_per_m: change of 1/depth per pixel along y, 1/m.
        error_m: standard error of ``depth_m``.
        contrast: I_x / I_y, mean over the interior of the segment.
        contrast_error: standard error of ``contrast``.
        correlation: normalised cross-correlation of the twin images at that depth, 0 to 1.
    """

    number: int
    pixels: int
    depth_m: float
    slope_x_per_m: float
    slope_y_per_m: float
    error_m: float
    contrast: float
    contrast_error: float
    correlation: float


@dataclass(frozen=True)
class DecodingFigures:
    """Figures of the decoding of a frame; None where a figure does not apply.

    From ``share_decoded`` to ``contrast_error`` they compare with the truth, and are None without one.

    Attributes:
        reason: why nothing was decoded.
        warning: why the calibration does not seem to be the camera's.
        layers: depths at which many pixels lie.
        basis_images: basis kernels that each image was filtered with.
        step_px: frame pixels from one compared pixel to the next.
        pixels: pixels of the window.
        pixels_without_signal: pixels without light.
        pixels_without_texture: lit pixels without a depth.
        pixels_broken: saturated pixels, and those that are not a number.
        contrast_standard_error: median over the pixels of the contrast's relative standard error.
        twin_mismatch: share of the twins' power that neither noise nor depth explains.
        seconds: time of decoding.
        share_decoded: of the pixels with a true depth, the share with a decoded one.
        nmae_pixel: mean |depth error| / depth of the pixels' own depths.
        psnr_x_db: peak signal-to-noise ratio of the x image; the peak is the largest true intensity.
        ssim_x: structural similarity of the x image.
        psnr_y_db: peak signal-to-noise ratio of the y image.
        ssim_y: structural similarity of the y image.
        object_error: mean over the true objects of the median relative error of depth.
        worst_object_error: the largest of these.
        contrast_error: mean relative error of the true objects' contrasts.
        changed_share: share of a film frame's pixels that were decoded again.
    """

    reason: str | None = optional()
    warning: str | None = optional()
    layers: int | None = optional()
    basis_images: int | None = optional()
    step_px: int | None = optional()
    pixels: int | None = optional()
    pixels_without_signal: int | None = optional()
    pixels_without_texture: int | None = optional()
    pixels_broken: int | None = optional()
    contrast_standard_error: float | None = optional()
    twin_mismatch: float | None = optional()
    seconds: float | None = optional()
    share_decoded: float | None = optional()
    nmae_pixel: float | None = optional()
    psnr_x_db: float | None = optional()
    ssim_x: float | None = optional()
    psnr_y_db: float | None = optional()
    ssim_y: float | None = optional()
    object_error: float | None = optional()
    worst_object_error: float | None = optional()
    contrast_error: float | None = optional()
    changed_share: float | None = optional()


@dataclass(frozen=True)
class FocusFigures:
    """Focus of a lens on the sensor, beside that of the ideal flat lens of its aperture, sharp at the focus depth.

    Widths are those of the density of electric energy in unpolarised light, the mean of both polarisations about their
    image points. Shares and the Strehl ratio are those of the flux.

    Attributes:
        depth_m: object depth, the focus depth.
        numerical_aperture: sine of half the angle of the aperture at the image point.
        fwhm_x_um: full width at half maximum along x through the maximum; likewise along y; NaN where the window is too
            narrow.
        fwhm_limit_um: that of the ideal lens, mean of both axes.
        fwhm_polarised_um: shape (2, 2), widths of x and of y polarised light along x and y.
        fwhm_polarised_limit_um: shape (2, 2), those of the ideal lens.
        strehl: maximum per transmitted power over that of the ideal lens.
        encircled_radius_um: 0.61 wavelength / NA, the radius of Airy's first dark ring.
        encircled_energy: share of the transmitted light within that radius about the maximum.
        encircled_energy_limit: that of the ideal lens.
        offset_um: shape (n,), distance from the maximum.
        section_x: shape (n,), cross-section along x over the maximum; likewise along y.
        section_limit: shape (n,), cross-section of the ideal lens along x.
        radius_um: shape (m,), radii of the next two.
        encircled: shape (m,), share of the transmitted light within the radius.
        encircled_limit: shape (m,), that of the ideal lens.
    """

    depth_m: float
    numerical_aperture: float
    fwhm_x_um: float
    fwhm_y_um: float
    fwhm_limit_um: float
    fwhm_polarised_um: tuple[tuple[float, ...], ...]
    fwhm_polarised_limit_um: tuple[tuple[float, ...], ...]
    strehl: float
    encircled_radius_um: float
    encircled_energy: float
    encircled_energy_limit: float
    offset_um: FloatArray
    section_x: FloatArray
    section_y: FloatArray
    section_limit: FloatArray
    radius_um: FloatArray
    encircled: FloatArray
    encircled_limit: FloatArray
