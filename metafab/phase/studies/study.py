"""What a design's phases are worth before anything is made of them: lobe, bounds of depth, cost of the filter.

All at the level of the paraxial pupil, about the axis of the split: seconds after the phases are known, and before
the first pillar is placed. The optics room measures the same quantities in the written file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray, image_distance_mm, sensor_distance_um
from metafab.information.twin_images import PointSource, Texture
from metafab.phase.optimise.peak import spiral_field
from metafab.phase.optimise.rotation import MainLobe, full_turn_defocus_rad, main_lobe, rotation_deg_per_dioptre
from metafab.phase.pupil import Pupil, phasor, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.studies.bandwidth import BandwidthBudget, SplitImaging, bandwidth_budget
from metafab.phase.studies.compare import DepthBounds, compare_masks, reference_masks
from metafab.phase.terms.carriers import CARRIERS
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec.design import Design
from metafab.spec.terms import SpiralZones

#: Samples a side of the pupil and depths for the lobe, for the bounds, and for the filter.
_LOBE_SAMPLES, _LOBE_DEPTHS = 128, 61
_BOUND_SAMPLES, _BOUND_DEPTHS = 64, 25
_FILTER_SAMPLES, _FILTER_DEPTHS = 48, 5


@dataclass(frozen=True)
class LobeOverDepth:
    """The main lobe of a design and of the plain spiral of Eq. 2, over one full turn.

    Attributes:
        vergence_per_m: shape (n,), of the object from the focus: 1/depth - 1/focus depth.
        design: measured on the design's mask.
        plain: measured on the plain spiral.
        law_deg: shape (n,), orientation by the law of rotation through the design's mean.
        range_per_m: vergences of the farthest and the nearest depth of ``[verify]`` from the focus.
    """

    vergence_per_m: FloatArray
    design: MainLobe
    plain: MainLobe
    law_deg: FloatArray
    range_per_m: tuple[float, float]


@dataclass(frozen=True)
class PhaseStudy:
    """What a design's phases are worth.

    Attributes:
        lobe: the rotating lobe; None for a design without spiral zones.
        bounds: what the mask tells about depth, beside the standard ones; None for a single depth.
        bandwidth: the cost of the colour filter; None where none is declared, nothing is split, or the depth is one.
    """

    lobe: LobeOverDepth | None
    bounds: DepthBounds | None
    bandwidth: BandwidthBudget | None


def study(design: Design, profile: PhaseProfile) -> PhaseStudy:
    """Study the phases of a design with its own depths, noise and filter.

    Args:
        design: depths, electrons and noise of its scene, filter of ``[optics]``.
        profile: the design's phases.
    """
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
    ends = np.linspace(vergence[0], vergence[-1], _FILTER_DEPTHS)
    return PhaseStudy(lobe, bounds, _bandwidth(design, profile, 1.0 / ends, filter_fwhm_nm))


def bandwidth_figures(budget: BandwidthBudget) -> dict[str, Any]:
    """The budget of bandwidth as a part of the summary."""
    return {
        "filter_fwhm_nm": budget.fwhm_nm,
        "dispersion_um_per_nm": budget.dispersion_um_per_nm,
        "smear_um": budget.smear_um,
        "information_kept": budget.kept,
        "depth_error_factor": math.inf if budget.kept == 0.0 else budget.kept**-0.5,
        "remedies": [
            {"change": r.change, "information_kept": r.kept, "depth_error_factor": r.relative_error}
            for r in budget.remedies
        ],
    }


def mask_field(profile: PhaseProfile, pupil: Pupil, radius_um: float) -> ComplexArray:
    """exp(i psi) of all terms that are not carriers, for x and y polarisation, shape (2, n)."""
    mask = PhaseProfile(tuple(term for term in profile.terms if not isinstance(term, CARRIERS)), {})
    axis_um = radius_um * pupil.axis
    return phasor(mask(axis_um, axis_um)[:, pupil.inside])


def _lobe(design: Design, profile: PhaseProfile, spiral: SpiralZones) -> LobeOverDepth:
    radius_um, wavelength_um = 0.5 * design.device.aperture_um, design.wavelength_um
    pupil = Pupil(_LOBE_SAMPLES, design.device.aperture_shape)
    defocus = full_turn_defocus_rad(spiral.zones, _LOBE_DEPTHS)
    field = mask_field(profile, pupil, radius_um)[0]
    own, plain = (
        main_lobe(pupil, f, defocus, 2.0 * spiral.zones + 6.0)
        for f in (field, spiral_field(pupil, spiral.zones, spiral.exponent))
    )
    vergence = defocus / rim_defocus_per_dioptre_rad(radius_um, wavelength_um)
    law = rotation_deg_per_dioptre(spiral.zones, radius_um, wavelength_um) * vergence
    focus = 1.0 / design.sensor.focus_depth_m
    farthest, nearest = 1.0 / design.verify.depths_m[-1] - focus, 1.0 / design.verify.depths_m[0] - focus
    return LobeOverDepth(vergence, own, plain, law + float(np.mean(own.phi_deg - law)), (farthest, nearest))


def _texture(design: Design) -> tuple[Texture, float]:
    """The scene's light per Nyquist pixel (a usual one's without a scene), and that pixel's area over the sensor's."""
    image_um = 1e3 * image_distance_mm(design.device.focal_length_mm, design.sensor.focus_depth_m)
    nyquist_um = design.wavelength_um * image_um / (2.0 * design.device.aperture_um)
    share = (nyquist_um / design.sensor.pixel_um) ** 2
    electrons, read_noise_e, dark_e = Texture.electrons, Texture.read_noise_e, Texture.background_e
    if (scene := design.scene) is not None:
        electrons, read_noise_e, dark_e = scene.photons_per_pixel, scene.read_noise_e, scene.dark_e
    # Variances of the pixels in one Nyquist pixel add.
    noise = {"background_e": dark_e * share, "read_noise_e": read_noise_e * share**0.5}
    return Texture(electrons * share, **noise), share


def _bounds(design: Design, profile: PhaseProfile, spiral: SpiralZones | None, depth_m: FloatArray) -> DepthBounds:
    pupil = Pupil(_BOUND_SAMPLES, design.device.aperture_shape)
    zones, exponent = (4, 0.5) if spiral is None else (spiral.zones, spiral.exponent)
    texture, share = _texture(design)
    source = PointSource(background_e=texture.background_e + 5.0 * share, read_noise_e=texture.read_noise_e)
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
        pupil,
        mask_field(profile, pupil, radius_um)[0],
        rim_defocus_rad(depth_m, focus_m, radius_um, design.wavelength_um),
        design.device.aperture_um,
        design.device.focal_length_mm,
        sensor_distance_um(design.device.focal_length_mm, design.split_angle_deg, focus_m),
        design.wavelength_um,
        _texture(design)[0],
        fwhm_nm,
    )
    return bandwidth_budget(imaging, design.split_angle_deg)
