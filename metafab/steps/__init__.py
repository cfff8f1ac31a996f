"""The steps of the main job, each a few lines: files in, files out, and its part of the summary.

- ``library``    phase library: built or opened
- ``phase``      target phases, and their study
- ``layout``     pillars and mask files
- ``drc``        design rules of the written files
- ``optics``     PSF pairs of the written file and of the target phases
- ``merit``      figures of merit, loss chain, space variance
- ``tolerance``  corners of fabrication, where the design asks for them
- ``camera``     raw frame of the scene
- ``film``       a moving scene, frame by frame
- ``stokes``     a design's full-Stokes sibling
- ``decode``     4D image, and the calibration of a camera
- ``report``     figures and page
- ``outputs``    what several steps say of their files
- ``preflight``  faults that the design alone shows
- ``budget``     the error budget

The verification steps (``drc``, ``psf``) open the written mask; they never see the arrays of the design step.
A step imports its room when it works: a run that has nothing to do starts none of them.
"""

from metafab.steps.budget import error_budget, recorded_coupling
from metafab.steps.camera import CAPTURE, expose, expose_film
from metafab.steps.decode import DECODE, calibrate, restore
from metafab.steps.drc import DRC
from metafab.steps.film import decoded_film, film_figures
from metafab.steps.layout import LAYOUT, mask_paths, write_layout
from metafab.steps.library import LIBRARY, library_path, library_stands, open_library
from metafab.steps.merit import MERIT
from metafab.steps.optics import (
    PSF,
    calibration,
    calibration_depths,
    exact_pair,
    ideal_source,
    mask_source,
    point_spread,
    power_figures,
    psf_figures,
    save_psf,
)
from metafab.steps.phase import PHASE, STUDY
from metafab.steps.preflight import PREFLIGHT, preflight
from metafab.steps.report import report_step
from metafab.steps.stokes import full_stokes
from metafab.steps.tolerance import TOLERANCE, recorded_tolerance, tolerances

#: In the order in which they run.
STEPS = (LIBRARY, PHASE, STUDY, LAYOUT, DRC, PSF, MERIT, TOLERANCE, CAPTURE, DECODE)
#: Shows the files of all other steps.
REPORT = report_step(tuple(step.name for step in STEPS))

__all__ = [
    "PREFLIGHT",
    "REPORT",
    "STEPS",
    "calibrate",
    "calibration",
    "calibration_depths",
    "decoded_film",
    "error_budget",
    "exact_pair",
    "expose",
    "expose_film",
    "film_figures",
    "full_stokes",
    "ideal_source",
    "library_path",
    "library_stands",
    "mask_paths",
    "mask_source",
    "open_library",
    "point_spread",
    "power_figures",
    "preflight",
    "psf_figures",
    "recorded_coupling",
    "recorded_tolerance",
    "restore",
    "save_psf",
    "tolerances",
    "write_layout",
]
