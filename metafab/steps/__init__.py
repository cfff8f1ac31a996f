"""Steps of the pipeline, in their order: each reads and writes files of the run folder and returns its figures.

- ``job``        Job and Step
- ``records``    what steps left: states of files, figures, times
- ``preflight``  checks of the design alone
- ``library``    phase library: built or loaded
- ``phase``      target phases and their study
- ``layout``     pillars, mask files and their design-rule check
- ``exposure``   electron exposure of a written mask, corrected doses
- ``optics``     PSF pairs of the written mask and of the target phases, figures of merit, each light of a design
- ``orders``     diffraction orders of a mask whose pattern repeats
- ``tolerance``  effect of fabrication errors
- ``images``     raw frames, 4D images, films, camera calibration
- ``stokes``     full-Stokes camera of a design
- ``summary``    figures of all steps, error budget, work left out, ``summary.json``

The steps ``drc``, ``psf``, ``orders``, ``merit`` and ``lights`` read the written mask, never the arrays of the layout
step. A step imports the rooms it uses when it runs, so that a run without stale steps imports none of them.
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.steps.exposure import EXPOSURE
from metafab.steps.images import CAPTURE, DECODE
from metafab.steps.job import Job, Step
from metafab.steps.layout import DRC, LAYOUT, write_layout
from metafab.steps.library import LIBRARY, open_library
from metafab.steps.optics import PSF, calibration, mask_source, point_spread
from metafab.steps.optics.lights import LIGHTS
from metafab.steps.optics.merit import MERIT
from metafab.steps.orders import ORDERS
from metafab.steps.phase import PHASE, STUDY
from metafab.steps.preflight import preflight
from metafab.steps.summary import RunSummary
from metafab.steps.tolerance import TOLERANCE

#: All steps that make results, in the order in which they run.
RESULT_STEPS = (LIBRARY, PHASE, STUDY, LAYOUT, DRC, EXPOSURE, PSF, ORDERS, MERIT, LIGHTS, TOLERANCE, CAPTURE, DECODE)

__all__ = [
    "RESULT_STEPS",
    "Job",
    "RunSummary",
    "Step",
    "calibration",
    "mask_source",
    "open_library",
    "point_spread",
    "preflight",
    "write_layout",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.steps.images": "calibrate decoded_film",
            "metafab.steps.layout": "mask_paths",
            "metafab.steps.library": "library_path",
            "metafab.steps.orders": "recorded_coupling",
            "metafab.steps.optics": "calibration_depths ideal_source save_psf",
            "metafab.steps.preflight": "PREFLIGHT",
            "metafab.steps.stokes": "full_stokes",
            "metafab.steps.summary": "error_budget",
            "metafab.steps.tolerance": "recorded_tolerance tolerances",
        },
    )
