"""The phase library: built when it is missing, opened when it stands."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.storage.latest import Latest, file_mark
from metafab.steps.job import Job, Step
from metafab.steps.outputs import no_mask

if TYPE_CHECKING:
    from metafab.library import Library


#: Steps share it, and with it the continuous functions of size that it grows.
_OPENED: Latest[Library] = Latest()


def library_path(job: Job) -> Path:
    """Where the built library lives: beside its unit-cell file, or in the run folder if that is read-only."""
    source = job.design.library
    if source.suffix == ".h5":
        return source
    built = source.with_suffix(".h5")
    return built if os.access(source.parent, os.W_OK) else job.folder / built.name


def library_stands(job: Job) -> bool:
    """Whether the design's library is there; if not, it is built before anything that needs it."""
    from metafab import library

    return job.design.library.suffix == ".h5" or library.is_current(library_path(job), job.design.unit_cell)


def open_library(job: Job) -> Library:
    """The design's library, built first when it is missing or was built from another unit cell."""
    from metafab import library
    from metafab.core.parallel.executor import open_executor

    path = library_path(job)
    if not library_stands(job):
        with open_executor(job.workers, job.cluster) as executor:
            return library.build_file(job.design.unit_cell, path, executor=executor, progress=job.progress)
    return _OPENED.of(file_mark(path), lambda: library.load(path))


def _library(job: Job) -> dict[str, Any]:
    from metafab import library

    opened = open_library(job)
    return {
        "file": str(library_path(job)),
        **library.quality(opened),
        "index_phase_error_rad": library.index_phase_error_rad(opened),
        **opened.details,
    }


LIBRARY = Step(
    "library", ("spec", "materials", "cell", "library"), (),
    lambda d: (d.unit_cell, d.library if d.library.suffix == ".h5" else None),
    lambda job: (library_path(job),), _library, no_mask,
)  # fmt: skip
