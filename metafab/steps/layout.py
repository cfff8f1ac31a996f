"""Phases and library -> pillars -> mask files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metafab.core.errors import InputError
from metafab.core.parallel.executor import open_threads
from metafab.steps.job import Job, Step
from metafab.steps.library import open_library
from metafab.steps.outputs import in_folder, no_mask


def write_layout(job: Job) -> dict[str, Any]:
    """Map the target phases to pillars and write the mask files.

    Raises:
        InputError: the design asks for no file.
    """
    from metafab import layout, mask

    if not job.design.has_mask:
        remedy = 'set it to ["oas"]; `metafab run` does without a mask'
        raise InputError.single(job.design.name, "mask.formats", "'gds', 'oas' or both", "none", remedy)
    with open_threads(job.workers, job.cluster) as executor:
        assignment = layout.assign(job.profile, open_library(job), job.design, executor=executor, progress=job.progress)
        files = mask.write(
            assignment.pillars,
            job.folder,
            job.design,
            executor=executor,
            progress=job.progress,
            mapping=assignment.to_json(),
        )
    return {**assignment.to_json(), "files": [{"name": file.path.name, "bytes": file.bytes} for file in files]}


def mask_paths(job: Job) -> tuple[Path, ...]:
    """The mask files that the design asks for."""
    return tuple(job.folder / f"layout.{suffix}" for suffix in job.design.mask.formats)


LAYOUT = Step(
    "layout", ("layout", "mask"), ("library", "phase"),
    lambda d: (d.name, d.rules, d.mask, d.device, d.numerics),
    lambda job: (*mask_paths(job), *in_folder("layout.lyp", "layout.json")(job)), write_layout,
    no_mask,
)  # fmt: skip
