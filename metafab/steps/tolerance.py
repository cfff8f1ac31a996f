"""Effect of fabrication errors on the PSFs of the written mask."""

from __future__ import annotations

from pathlib import Path

from metafab.core.figures import ToleranceTable
from metafab.core.storage.files import file_sha256
from metafab.spec import Design
from metafab.spec.design import Tolerances
from metafab.steps.exposure import Printed, made_mask
from metafab.steps.job import Job, Step, in_folder, no_mask
from metafab.steps.layout import mask_paths
from metafab.steps.library import open_library
from metafab.steps.optics import mask_source
from metafab.steps.optics.merit import lens_focus

FILE = "tolerance.json"


def tolerances(job: Job, path: Path, *, copy: int = 1) -> ToleranceTable:
    """Compute the corners of a written file, for the design's ``[tolerance]`` or default faults.

    A design with ``[process.exposure]`` adds the printed pillars, with one dose and corrected.
    """
    from metafab import layout, optics, tolerance

    design = job.design
    written, made = mask_source(job, path, copy), []
    if design.process is not None and design.process.exposure is not None:
        kinds: tuple[Printed, ...] = ("plain", "corrected")
        made = [made_mask(job, path, printed, copy).field.against(written) for printed in kinds]
    imaging = optics.Imaging.of(design)
    conditions = tolerance.PsfConditions(
        imaging,
        design.verify.depths_m,
        optics.PsfNumerics.of(design),
        transmission=optics.Apodisation.of(design),
        lens=lens_focus(design, imaging) if design.is_lens else None,
    )
    return tolerance.tolerance_table(
        written,
        open_library(job),
        design.tolerance or Tolerances(),
        conditions,
        min(layout.field_sites(design)),
        made=made,
        work=job.work,
    )


def recorded_tolerance(job: Job) -> ToleranceTable | None:
    """Figures that ``metafab tolerance`` stored for a mask of this run; None if there are none."""
    if not (job.folder / FILE).is_file():
        return None

    from metafab import tolerance

    stored = tolerance.load_tolerance(job.folder / FILE)
    if stored is None or all(file_sha256(path) != stored[1] for path in reversed(mask_paths(job))):
        return None
    return stored[0]


def _tolerance(job: Job) -> ToleranceTable:
    from metafab import tolerance

    path = mask_paths(job)[-1]
    table = tolerances(job, path)
    tolerance.save_tolerance(table, job.folder / FILE, mask_sha256=file_sha256(path))
    return table


def _not_requested(design: Design) -> str | None:
    return no_mask(design) or (
        None if design.tolerance is not None else "the design has no [tolerance]; `metafab tolerance` makes the table"
    )


TOLERANCE = Step(
    name="tolerance",
    rooms=("mask", "cell", "library", "exposure", "optics", "tolerance"),
    after=("library", "layout"),
    inputs=lambda d: (d.tolerance, d.process, d.sensor, d.verify, d.optics, d.substrate, d.mask.write_field_um),
    outputs=in_folder(FILE),
    work=_tolerance,
    figures=ToleranceTable,
    not_needed=_not_requested,
)
