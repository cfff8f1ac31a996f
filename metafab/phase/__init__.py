"""Target phases as functions of (x, y, polarisation), and the search for better ones.

- ``profile``   Term (a summand) and PhaseProfile (their sum), evaluated tile by tile
- ``carriers``  lens, split lens (Eqs. 3 and 4), grating, axicon
- ``helices``   spiral zones (Eq. 2), the optimised mask as a sum of waves, vortex, double helix
- ``angle``     angles of many complex numbers, fast
- ``panels``    angles of a sum of separable waves on a tile, faster
- ``zernike``   Zernike polynomials
- ``sampled``   phases given by samples: a user's file
- ``hologram``  the phase that paints a picture
- ``pupil``     the pupil in normalised coordinates, rim defocus, images on the focal plane
- ``rotation``  the law of rotation, and the main lobe measured in a PSF
- ``peak``      the main lobe made as bright as it can be while it turns (the paper's IFTA step)
- ``bound``     how bright any mask's lobe can be, proven
- ``side_lobes``  the brightest helix whose side lobes keep a limit
- ``information``  what a twin image of unknown texture can tell about depth
- ``blind``     the helix that tells most: gradient ascent of that information
- ``estimate``  depth read from simulated twin images, against the bound
- ``propose``   which [L, epsilon] suits a depth range and its noise
- ``bandwidth`` what the width of the colour filter costs
- ``compare``   what masks tell about depth at equal aperture and light
- ``build``     a design's terms -> PhaseProfile
- ``study``     what a design's phases are worth: lobe, bounds of depth, cost of the filter
- ``store``     ``phase.h5``: phases sampled over the aperture
- ``study_store``  ``phase_study.h5``: the study

In: a Design (or plain numbers). Out: a PhaseProfile for the layout room; radians, not wrapped.
"""

from metafab.information.twin_images import PointSource, Texture, twin_information
from metafab.phase.build import profile_of, pupil_field, require_paintable
from metafab.phase.optimise.blind import BlindDesign, BlindInformation, optimise_blind
from metafab.phase.optimise.peak import PeakDesign, optimise_peak, spiral_field
from metafab.phase.optimise.rotation import (
    MainLobe,
    full_turn_dioptre,
    main_lobe,
    ring_rotation,
    rotation_deg_per_dioptre,
)
from metafab.phase.optimise.side_lobes import SideLobeDesign, limit_side_lobes, measured_side_lobes
from metafab.phase.pupil import FocalPlane, Pupil, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.store import load, save
from metafab.phase.studies.bandwidth import (
    BandwidthBudget,
    BandwidthTradeoff,
    Remedy,
    SplitImaging,
    bandwidth_budget,
    bandwidth_tradeoff,
    smear_um_per_nm,
)
from metafab.phase.studies.compare import DepthBounds, compare_masks, reference_masks
from metafab.phase.studies.estimate import most_likely_defocus, twin_images
from metafab.phase.studies.propose import Proposal, propose
from metafab.phase.studies.study import LobeOverDepth, PhaseStudy, bandwidth_figures, study
from metafab.phase.studies.study_store import load_study, save_study
from metafab.phase.terms.carriers import AxiconPhase, GratingPhase, LensPhase, SplitLensPhase
from metafab.phase.terms.helices import (
    DoubleHelixPhase,
    SpiralZonesPhase,
    VortexPhase,
    WaveSumPhase,
    zone_charges,
    zone_radii,
)
from metafab.phase.terms.hologram import Hologram, design_hologram
from metafab.phase.terms.profile import PhaseProfile, Term
from metafab.phase.terms.sampled import SampledPhase, load_array
from metafab.phase.terms.zernike import ZernikePhase

__all__ = [
    "AxiconPhase",
    "BandwidthBudget",
    "BandwidthTradeoff",
    "BlindDesign",
    "BlindInformation",
    "DepthBounds",
    "DoubleHelixPhase",
    "FocalPlane",
    "GratingPhase",
    "Hologram",
    "LensPhase",
    "LobeOverDepth",
    "MainLobe",
    "PeakDesign",
    "PhaseProfile",
    "PhaseStudy",
    "PointSource",
    "Proposal",
    "Pupil",
    "Remedy",
    "SampledPhase",
    "SideLobeDesign",
    "SpiralZonesPhase",
    "SplitImaging",
    "SplitLensPhase",
    "Term",
    "Texture",
    "VortexPhase",
    "WaveSumPhase",
    "ZernikePhase",
    "bandwidth_budget",
    "bandwidth_figures",
    "bandwidth_tradeoff",
    "compare_masks",
    "design_hologram",
    "full_turn_dioptre",
    "limit_side_lobes",
    "load",
    "load_array",
    "load_study",
    "main_lobe",
    "measured_side_lobes",
    "most_likely_defocus",
    "optimise_blind",
    "optimise_peak",
    "profile_of",
    "propose",
    "pupil_field",
    "reference_masks",
    "require_paintable",
    "rim_defocus_per_dioptre_rad",
    "rim_defocus_rad",
    "ring_rotation",
    "rotation_deg_per_dioptre",
    "save",
    "save_study",
    "smear_um_per_nm",
    "spiral_field",
    "study",
    "twin_images",
    "twin_information",
    "zone_charges",
    "zone_radii",
]
