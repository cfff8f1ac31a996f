"""Target phases as functions of (x, y, polarisation), their optimisation, and studies of their quality.

- ``terms/``     the summands of a target phase (lens, helix, hologram, ...) and their sum, the PhaseProfile
- ``optimise/``  helices with the brightest lobe, limited side lobes, or the largest depth information; bounds
- ``studies/``   lobe, bounds of depth, cost of a colour filter, choice of [L, epsilon]
- ``build``      a design's terms -> PhaseProfile
- ``formulas``   terms that need no optimiser
- ``picture``    the hologram of a picture
- ``slopes``     direction of the light, and where the lattice undersamples the phase
- ``pupil``      the pupil in normalised coordinates, rim defocus, paraxial images
- ``jones_target``  target Jones matrices of a full-Stokes lens: six states of polarisation, six places
- ``store``      ``phase.h5``: phases sampled over the aperture

In: a Design, or plain numbers. Out: a PhaseProfile for :mod:`metafab.layout`; radians, not wrapped.
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.phase.build import profile_of
from metafab.phase.optimise.blind import optimise_blind as optimise_blind
from metafab.phase.optimise.peak import optimise_peak as optimise_peak
from metafab.phase.optimise.rotation import main_lobe as main_lobe
from metafab.phase.optimise.side_lobes import limit_side_lobes as limit_side_lobes
from metafab.phase.pupil import Pupil as Pupil
from metafab.phase.store import load as load
from metafab.phase.store import save as save
from metafab.phase.studies.bandwidth import bandwidth_budget as bandwidth_budget
from metafab.phase.studies.compare import compare_masks as compare_masks
from metafab.phase.studies.propose import propose
from metafab.phase.studies.study import study
from metafab.phase.terms.carriers import AxiconPhase as AxiconPhase
from metafab.phase.terms.carriers import GratingPhase, LensPhase, SplitLensPhase
from metafab.phase.terms.helices import DoubleHelixPhase as DoubleHelixPhase
from metafab.phase.terms.helices import (
    SpiralZonesPhase,
    VortexPhase,
)
from metafab.phase.terms.helices import WaveSumPhase as WaveSumPhase
from metafab.phase.terms.hologram import ImagePlane as ImagePlane
from metafab.phase.terms.hologram import design_hologram
from metafab.phase.terms.profile import PhaseProfile
from metafab.phase.terms.sampled import SampledPhase
from metafab.phase.terms.sampled import load_array as load_array
from metafab.phase.terms.zernike import ZernikePhase

__all__ = [
    "profile_of",
    "PhaseProfile",
    "LensPhase",
    "SplitLensPhase",
    "SpiralZonesPhase",
    "GratingPhase",
    "VortexPhase",
    "ZernikePhase",
    "SampledPhase",
    "design_hologram",
    "propose",
    "study",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.information.texture": "PointSource Texture",
            "metafab.information.fisher": "twin_information",
            "metafab.phase.picture": "require_paintable",
            "metafab.phase.optimise.blind": "BlindDesign BlindInformation",
            "metafab.phase.optimise.peak": "PeakDesign",
            "metafab.phase.optimise.rotation": "MainLobe full_turn_dioptre ring_rotation rotation_deg_per_dioptre",
            "metafab.phase.optimise.side_lobes": "SideLobeDesign measured_side_lobes",
            "metafab.phase.pupil": "FocalPlane pupil_field rim_defocus_per_dioptre_rad rim_defocus_rad",
            "metafab.phase.studies.bandwidth": (
                "BandwidthBudget BandwidthTradeoff Remedy SplitImaging bandwidth_tradeoff smear_um_per_nm"
            ),
            "metafab.phase.studies.compare": "DepthBounds reference_masks",
            "metafab.phase.studies.propose": "Proposal",
            "metafab.phase.studies.study": "LobeOverDepth PhaseStudy",
            "metafab.phase.studies.study_store": "load_study save_study",
            "metafab.phase.terms.helices": "spiral_field zone_charges zone_radii",
            "metafab.phase.terms.hologram": "Hologram",
            "metafab.phase.terms.profile": "Term",
        },
    )
