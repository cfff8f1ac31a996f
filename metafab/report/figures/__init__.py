"""Figure functions: each takes results and axes, draws, and returns the axes. No physics is computed here.

- ``library``   maps of phase, transmittance, sensitivity and error over pillar size; coverage of both phases
- ``phases``    phases over the aperture, picture of a hologram
- ``study``     main lobe over one turn, depth bounds, colour filter, proposals, comparison with other cameras
- ``mask``      the written mask at three zooms, fields of a simulated patch
- ``exposure``  printed sizes: maps, histogram, process window
- ``psf``       the pair over depth and field, orientation, peak, modulation transfer
- ``image``     raw frame, decoded intensities, contrast, depth, depth against truth
- ``accounts``  loss chain, error budget, error against time
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.report.figures.accounts": "error_against_photons error_against_time error_budget loss_chain",
            "metafab.report.figures.exposure": "process_window size_histogram size_map",
            "metafab.report.figures.image": "confidence contrast depth depth_against_truth intensity raw_frame",
            "metafab.report.figures.library": "coverage error_map phase_map sensitivity_map transmittance_map",
            "metafab.report.figures.mask": "fill_map neighbour_map patch_amplitude patch_phase pillar_outlines",
            "metafab.report.figures.phases": "aperture_phase painted_picture wanted_picture",
            "metafab.report.figures.psf": (
                "depth_bias distortion modulation orientation over_field pair_over_depth peak wavefront_map"
            ),
            "metafab.report.figures.study": (
                "depth_bounds filter_orientation filter_tradeoff lobe_orientation lobe_peak proposed_orientation "
                "rival_depth_errors rival_sharpness"
            ),
        },
    )
