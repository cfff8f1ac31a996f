"""Corners of fabrication: what they do to the PSFs of the written file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.storage.files import file_sha256
from metafab.spec import Design
from metafab.spec.design import Tolerances
from metafab.steps.job import Job, Step
from metafab.steps.layout import mask_paths
from metafab.steps.library import open_library
from metafab.steps.optics import filter_fwhm_nm, mask_source
from metafab.steps.outputs import in_folder, no_mask

if TYPE_CHECKING:
    from metafab.tolerance import ToleranceTable

FILE = "tolerance.json"


def tolerances(job: Job, path: Path, *, copy: int = 1) -> ToleranceTable:
    """The table of corners of a written file, by the design's ``[tolerance]`` or the usual values."""
    from metafab import layout, optics, tolerance
    from metafab.core.parallel.executor import open_executor

    design = job.design
    written, library = mask_source(job, path, copy), open_library(job)
    with open_executor(job.workers, job.cluster) as executor:
        return tolerance.tolerance_table(
            written,
            library,
            optics.Imaging.of(design),
            design.verify.depths_m,
            design.tolerance or Tolerances(),
            min(layout.field_sites(design)),
            window_px=design.verify.window_px,
            target_error=design.verify.target_error,
            transmission=optics.Apodisation.of(design),
            filter_fwhm_nm=filter_fwhm_nm(design),
            executor=executor,
            progress=job.progress,
        )


def recorded_tolerance(job: Job) -> dict[str, Any]:
    """What ``metafab tolerance`` found on a mask of this run, {} if nothing."""
    if not (job.folder / FILE).is_file():
        return {}

    from metafab import tolerance

    found = tolerance.load_tolerance(job.folder / FILE)
    if found is None or all(file_sha256(path) != found[1] for path in reversed(mask_paths(job))):
        return {}
    return tolerance.tolerance_figures(found[0])


def _tolerance(job: Job) -> dict[str, Any]:
    from metafab import tolerance

    path = mask_paths(job)[-1]
    table = tolerances(job, path)
    tolerance.save_tolerance(table, job.folder / FILE, mask_sha256=file_sha256(path))
    return tolerance.tolerance_figures(table)


def _not_asked(design: Design) -> str | None:
    return no_mask(design) or (
        None if design.tolerance is not None else "the design has no [tolerance]; `metafab tolerance` makes the table"
    )


TOLERANCE = Step(
    "tolerance", ("mask", "cell", "library", "optics", "tolerance"), ("library", "layout"),
    lambda d: (d.tolerance, d.sensor, d.verify, d.optics, d.mask.write_field_um), in_folder(FILE), _tolerance,
    _not_asked,
)  # fmt: skip
