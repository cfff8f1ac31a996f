"""Study of a design's target phases: the main lobe, bounds of depth, and the cost of the colour filter.

All of it is at the level of the paraxial pupil, about the axis of the split: it takes seconds, before any pillar is
placed. :mod:`metafab.optics` measures the same quantities in the written file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray, image_distance_mm, sensor_distance_um
from metafab.core.numeric.phasor import phasor
from metafab.core.parallel.executor import one_blas_thread
from metafab.information.texture import PointSource, Texture
from metafab.phase.optimise.rotation import (
    MainLobe,
    full_turn_defocus_rad,
    helix_half_width,
    main_lobe,
    rotation_deg_per_dioptre,
)
from metafab.phase.pupil import Pupil, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.studies.bandwidth import BandwidthBudget, SplitImaging, bandwidth_budget
from metafab.phase.studies.compare import DepthBounds, compare_masks, reference_masks
from metafab.phase.terms.carriers import without_carriers
from metafab.phase.terms.helices import spiral_field
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec.design import Design
from metafab.spec.terms import SpiralZones

#: Samples a side of the pupil and number of depths, for the lobe, for the bounds, and for the filter.
_LOBE_SAMPLES, _LOBE_DEPTHS = 128, 61
_BOUND_SAMPLES, _BOUND_DEPTHS = 64, 25
_FILTER_SAMPLES, _FILTER_DEPTHS = 48, 5
#: Background of the point source, electrons per pixel of the sensor.
_POINT_BACKGROUND_E = 5.0


@dataclass(frozen=True)
class LobeOverDepth:
    """The main lobe of a design and of the plain spiral of Shen 2023 (Eq. 2), over one full turn."""

    vergence_per_m: FloatArray  #: Shape (n,), vergence of the object relative to the focus: 1/depth - 1/focus depth.
    design: MainLobe  #: Measured on the design's mask, n depths.
    plain: MainLobe  #: Measured on the plain spiral, n depths.
    law_deg: FloatArray  #: Shape (n,), orientation by the law of rotation, with the mean of the design.
    #: Vergences of the farthest and the nearest depth of ``[verify]`` relative to the focus.
    range_per_m: tuple[float, float]


@dataclass(frozen=True)
class PhaseStudy:
    """Quality of a design's target phases."""

    lobe: LobeOverDepth | None  #: The rotating lobe; None for a design without spiral zones.
    bounds: DepthBounds | None  #: Bounds of depth for the design and the reference masks; None for a single depth.
    #: Cost of the colour filter; None without a filter or a split, or for a single depth.
    bandwidth: BandwidthBudget | None


@one_blas_thread()
def study(design: Design, profile: PhaseProfile) -> PhaseStudy:
    """Study the phases of a design with its own depths, electrons, noise and filter."""
    spiral = next((term for term in design.phase if isinstance(term, SpiralZones) and term.zones > 1), None)
    lobe = None if spiral is None else _lobe(design, profile, spiral)
    if len(design.depths_m) == 1:
        return PhaseStudy(lobe, None, None)
    vergence = np.linspace(1.0 / design.depths_m[-1], 1.0 / design.depths_m[0], _BOUND_DEPTHS)
    with np.errstate(divide="ignore"):  # The farthest depth may be infinite.
        depth_m = 1.0 / vergence[::-1]
    bounds = _bounds(design, profile, spiral, depth_m)
    filter_fwhm_nm = None if design.optics is None else design.optics.filter_fwhm_nm
    if filter_fwhm_nm is None or design.split_angle_deg == 0.0:
        return PhaseStudy(lobe, bounds, None)
    filter_depth_m = 1.0 / np.linspace(vergence[0], vergence[-1], _FILTER_DEPTHS)
    return PhaseStudy(lobe, bounds, _bandwidth(design, profile, filter_depth_m, filter_fwhm_nm))


def mask_field(profile: PhaseProfile, pupil: Pupil, radius_um: float) -> ComplexArray:
    """Return exp(i psi) of the profile without its carriers at the n samples of a pupil: shape (2, n), x and y."""
    axis_um = radius_um * pupil.axis
    return phasor(without_carriers(profile)(axis_um, axis_um)[:, pupil.inside])


def _lobe(design: Design, profile: PhaseProfile, spiral: SpiralZones) -> LobeOverDepth:
    radius_um, wavelength_um = 0.5 * design.device.aperture_um, design.wavelength_um
    pupil = Pupil(_LOBE_SAMPLES, design.device.aperture_shape)
    defocus = full_turn_defocus_rad(spiral.zones, _LOBE_DEPTHS)
    half_width = helix_half_width(spiral.zones)
    lobe = main_lobe(pupil, mask_field(profile, pupil, radius_um)[0], defocus, half_width)
    plain = main_lobe(pupil, spiral_field(pupil, spiral.zones, spiral.exponent), defocus, half_width)
    vergence = defocus / rim_defocus_per_dioptre_rad(radius_um, wavelength_um)
    law = rotation_deg_per_dioptre(spiral.zones, radius_um, wavelength_um) * vergence
    focus = 1.0 / design.sensor.focus_depth_m
    farthest, nearest = 1.0 / design.verify.depths_m[-1] - focus, 1.0 / design.verify.depths_m[0] - focus
    return LobeOverDepth(vergence, lobe, plain, law + float(np.mean(lobe.phi_deg - law)), (farthest, nearest))


def _texture(design: Design) -> tuple[Texture, float]:
    """Light of the scene per Nyquist pixel (a default without a scene), and that pixel's area over the sensor's."""
    image_um = 1e3 * image_distance_mm(design.device.focal_length_mm, design.sensor.focus_depth_m)
    nyquist_um = design.wavelength_um * image_um / (2.0 * design.device.aperture_um)
    share = (nyquist_um / design.sensor.pixel_um) ** 2
    electrons, read_noise_e, dark_e = Texture.electrons, Texture.read_noise_e, Texture.background_e
    if (scene := design.scene) is not None:
        electrons, read_noise_e, dark_e = scene.photons_per_pixel, scene.read_noise_e, scene.dark_e
    # Variances of the pixels in one Nyquist pixel add.
    return Texture(
        electrons=electrons * share, background_e=dark_e * share, read_noise_e=read_noise_e * share**0.5
    ), share


def _bounds(design: Design, profile: PhaseProfile, spiral: SpiralZones | None, depth_m: FloatArray) -> DepthBounds:
    pupil = Pupil(_BOUND_SAMPLES, design.device.aperture_shape)
    zones, exponent = (4, 0.5) if spiral is None else (spiral.zones, spiral.exponent)
    texture, share = _texture(design)
    background_e = texture.background_e + _POINT_BACKGROUND_E * share
    source = PointSource(background_e=background_e, read_noise_e=texture.read_noise_e)
    field = mask_field(profile, pupil, 0.5 * design.device.aperture_um)
    return compare_masks(
        {"this design": field, **reference_masks(pupil, zones, exponent)},
        pupil,
        depth_m,
        focus_depth_m=design.sensor.focus_depth_m,
        aperture_um=design.device.aperture_um,
        wavelength_um=design.wavelength_um,
        source=source,
        texture=texture,
    )


def _bandwidth(design: Design, profile: PhaseProfile, depth_m: FloatArray, fwhm_nm: float) -> BandwidthBudget:
    pupil = Pupil(_FILTER_SAMPLES, design.device.aperture_shape)
    radius_um, focus_m = 0.5 * design.device.aperture_um, design.sensor.focus_depth_m
    imaging = SplitImaging(
        pupil=pupil,
        mask=mask_field(profile, pupil, radius_um)[0],
        defocus_rad=rim_defocus_rad(depth_m, focus_m, radius_um, design.wavelength_um),
        aperture_um=design.device.aperture_um,
        focal_length_mm=design.device.focal_length_mm,
        sensor_distance_um=sensor_distance_um(design.device.focal_length_mm, design.split_angle_deg, focus_m),
        wavelength_um=design.wavelength_um,
        texture=_texture(design)[0],
        reference_fwhm_nm=fwhm_nm,
    )
    return bandwidth_budget(imaging, design.split_angle_deg)
