"""Light of a run: PSF pairs, their figures, and the figures of merit of the written mask.

- ``figures``  figures of a PSF pair
- ``sources``  light behind the pillars of the written mask, and behind the target phases
- ``pairs``    PSF pairs over depth and field; the step ``psf``
- ``merit``    focus, modulation transfer, loss chain, aberrations; the step ``merit``
- ``lights``   PSF pair and focus in each light of the design; the step ``lights``
"""

from metafab.steps.optics.figures import PairFigures, PsfFigures
from metafab.steps.optics.pairs import (
    PSF,
    calibration,
    calibration_depths,
    pair_figures,
    point_spread,
    save_psf,
    scene_pair,
)
from metafab.steps.optics.sources import WrittenLens, ideal_source, lit_source, mask_source, written_light

__all__ = [
    "PSF",
    "WrittenLens",
    "PairFigures",
    "PsfFigures",
    "calibration",
    "calibration_depths",
    "ideal_source",
    "lit_source",
    "mask_source",
    "pair_figures",
    "point_spread",
    "save_psf",
    "scene_pair",
    "written_light",
]
