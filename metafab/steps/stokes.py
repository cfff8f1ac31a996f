"""Full-Stokes sibling of a camera design: mask, PSFs of the file read back, and a decoded frame of six images."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.core.polarisation import STATES
from metafab.core.storage.files import write_json
from metafab.spec.turned import require_turnable
from metafab.steps.job import Job
from metafab.steps.layout import FileFigures
from metafab.steps.library import open_library
from metafab.steps.optics import calibration_depths, lit_source, mask_source
from metafab.steps.preflight import preflight

if TYPE_CHECKING:
    from metafab.camera.stokes import StokesFrame
    from metafab.decode.stokes import StokesErrors, StokesImage
    from metafab.mask.sidecar import WrittenMask


@dataclass(frozen=True)
class StokesRun:
    """Result of a full-Stokes run."""

    frame: StokesFrame  #: Six images of the design's scene.
    image: StokesImage  #: Depth and Stokes vectors decoded from them.
    errors: StokesErrors  #: Errors of the image against the scene.
    pillars: int  #: Number of pillars.
    distinct: int  #: Number of distinct sizes and angles.
    angles: int  #: Angles in half a turn that pillars may have.
    overlap: float  #: Overlap of the pillars' Jones matrices with the target, 0 to 1.
    states: tuple[str, ...]  #: Names of the six states.
    efficiency: FloatArray  #: Shape (6,), share of each state's power in its window, of the written pillars.
    extinction_ratio: FloatArray  #: Shape (6,), efficiency over the share of the orthogonal state.
    ideal_efficiency: FloatArray  #: Shape (6,), efficiency of perfect pillars.
    condition_number: float  #: Condition number of the instrument matrix.
    files: tuple[FileFigures, ...]  #: The mask files.
    mask: WrittenMask  #: The mask; in JSON as in ``layout.json``.

    def to_json(self) -> dict[str, Any]:
        """Contents of ``stokes.json``: all attributes but frame and image, the errors among them."""
        figures = {name: value for name, value in vars(self).items() if name not in {"frame", "image", "errors"}}
        return {**figures, "mask": self.mask.to_json(), **asdict(self.errors)}


def full_stokes(job: Job, *, row_angle_deg: float, angles: int, size_step_nm: float) -> StokesRun:
    """Write ``stokes.oas`` (or .gds) and ``stokes.json``, and photograph and decode the design's scene.

    Args:
        job: a design with a mask and a scene.
        row_angle_deg: angle between rows of images, seen from the lens.
        angles: angles of pillars in half a turn.
        size_step_nm: step of widths and lengths, rounded up to the library's size grid.

    Raises:
        InputError: the design has no mask or scene, keys that turned pillars do not support, or no room for them.
    """
    from metafab import optics
    from metafab.camera.stokes import photograph
    from metafab.decode.stokes import decode_stokes, stokes_errors
    from metafab.layout.turned import assign_turned
    from metafab.mask.sidecar import WrittenMask
    from metafab.mask.write import write_drawings
    from metafab.optics.polarisation_states import stokes_psf
    from metafab.phase.jones_target import JonesTarget

    design = job.design
    if not design.has_mask:
        raise InputError.single(design.name, "mask.formats", "'gds', 'oas' or both", "none", "name one")
    if design.scene is None:
        raise InputError.single(design.name, "scene", "a scene to photograph", "none", "add a `[scene]` table")
    require_turnable(design)
    preflight(design, turned=True)
    imaging, library, target = optics.Imaging.of(design), open_library(job), JonesTarget.of(design, row_angle_deg)
    progress = job.work.progress
    assignment = assign_turned(target, library, design, angles=angles, size_step_nm=size_step_nm, progress=progress)
    files: dict[str, Path] = {suffix: job.folder / f"stokes.{suffix}" for suffix in design.mask.formats}
    mask_figures = write_drawings(assignment.pillars, files, design, progress)
    written = mask_source(job, files[design.mask.formats[-1]], angles=angles)
    perfect = optics.ideal_field(target, written.lattice, design.device)
    depths_m, window_px = calibration_depths(design, imaging), design.verify.window_px
    psf_of = partial(stokes_psf, target=target, imaging=imaging, window_px=window_px, work=Work(progress=progress))
    ideal = psf_of(lit_source(job, perfect), depths_m=depths_m[:1])
    psf = psf_of(lit_source(job, written), depths_m=depths_m)
    frame = photograph(design.scene, psf)
    image = decode_stokes(frame, psf)
    run = StokesRun(
        frame=frame,
        image=image,
        errors=stokes_errors(image, frame),
        pillars=mask_figures.pillars,
        distinct=mask_figures.distinct_sizes,
        angles=angles,
        overlap=assignment.overlap,
        states=STATES,
        efficiency=psf.efficiency,
        extinction_ratio=psf.extinction_ratio,
        ideal_efficiency=ideal.efficiency,
        condition_number=float(np.linalg.cond(psf.instrument)),
        files=tuple(FileFigures(path.name, path.stat().st_size) for path in files.values()),
        mask=WrittenMask(design, mask_figures, files),
    )
    write_json(job.folder / "stokes.json", run.to_json())
    return run
