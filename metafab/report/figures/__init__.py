"""Figure functions: each takes results and axes, draws, and returns the axes. Nothing is computed or shown here.

- ``library``    maps of phase, transmittance, sensitivity and error over pillar size; coverage of both phases
- ``phases``     phases over the aperture
- ``hologram``   a hologram's picture, wanted and painted
- ``study``      the lobe over a turn, bounds of depth, the cost of the filter, proposed helices
- ``mask``       the written pillars at three zooms
- ``psf``        the pair over depth and field, orientation, peak, modulation transfer
- ``image``      raw frame, decoded intensities, contrast, depth, depth against truth
- ``comparison``  depth and sharpness beside other cameras
- ``fullwave``   fields of a patch: Meep's, the library's, and their difference
- ``accounts``   loss chain, error budget, seconds, error against time

In: results of the other rooms. Out: the axes that were drawn on.
"""

from metafab.report.figures.accounts import (
    error_against_photons,
    error_against_time,
    error_budget,
    loss_chain,
    seconds,
    with_error_and_time,
)
from metafab.report.figures.comparison import rival_depth_errors, rival_sharpness
from metafab.report.figures.fullwave import patch_amplitude, patch_phase
from metafab.report.figures.hologram import painted_picture, wanted_picture
from metafab.report.figures.image import confidence, contrast, depth, depth_against_truth, intensity, raw_frame
from metafab.report.figures.library import coverage, error_map, phase_map, sensitivity_map, transmittance_map
from metafab.report.figures.mask import fill_map, pillar_outlines
from metafab.report.figures.phases import aperture_phase
from metafab.report.figures.psf import (
    depth_bias,
    depth_text,
    distortion,
    lit_half_px,
    modulation,
    orientation,
    over_field,
    pair_over_depth,
    peak,
    shown_depths,
)
from metafab.report.figures.study import (
    depth_bounds,
    filter_orientation,
    filter_tradeoff,
    lobe_orientation,
    lobe_peak,
    proposals,
    proposed_orientation,
)

__all__ = [
    "aperture_phase",
    "confidence",
    "contrast",
    "coverage",
    "depth",
    "depth_against_truth",
    "depth_bias",
    "depth_bounds",
    "depth_text",
    "distortion",
    "error_against_photons",
    "error_against_time",
    "error_budget",
    "error_map",
    "fill_map",
    "filter_orientation",
    "filter_tradeoff",
    "intensity",
    "lit_half_px",
    "lobe_orientation",
    "lobe_peak",
    "loss_chain",
    "modulation",
    "orientation",
    "over_field",
    "painted_picture",
    "pair_over_depth",
    "patch_amplitude",
    "patch_phase",
    "peak",
    "phase_map",
    "pillar_outlines",
    "proposals",
    "proposed_orientation",
    "raw_frame",
    "rival_depth_errors",
    "rival_sharpness",
    "seconds",
    "sensitivity_map",
    "shown_depths",
    "transmittance_map",
    "wanted_picture",
    "with_error_and_time",
]
