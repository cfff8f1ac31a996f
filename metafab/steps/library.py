"""The phase library: built when it is missing, loaded otherwise."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from metafab.core.errors import InputError
from metafab.core.figures import BuildStatistics, CornerStatistics, LineStatistics, Quality
from metafab.core.storage.files import Latest, file_mark
from metafab.core.storage.tables import optional
from metafab.spec import Design
from metafab.steps.job import Job, Step, no_mask, relative_to

if TYPE_CHECKING:
    from metafab.library import Library


#: The library that was opened last, shared by the steps of a run.
_OPENED: Latest[Library] = Latest()
#: Figures of the library that was judged last, for runs of several designs in one process.
_JUDGED: Latest[LibraryFigures] = Latest()


@dataclass(frozen=True, kw_only=True)
class LibraryFigures(BuildStatistics, Quality):
    """Quality of a library, statistics of its build, and those of its models of neighbours and corners."""

    file: str  #: Path of the library, relative to the run folder.
    index_phase_error_rad: float | None  #: See :func:`metafab.library.index_phase_error_rad`.
    neighbours: LineStatistics | None = optional()  #: None without a model of neighbours; likewise corners.
    corners: CornerStatistics | None = optional()

    @classmethod
    def of(cls, library: Library, file: str, workers: int | None = None) -> LibraryFigures:
        """Compute the figures of a library by up to ``workers`` processes; ``file`` is its path from the run folder."""
        from metafab.library import index_phase_error_rad, quality

        return cls(
            file=file,
            index_phase_error_rad=index_phase_error_rad(library, workers=workers),
            neighbours=None if library.neighbours is None else library.neighbours.overall,
            corners=None if library.corners is None else library.corners.statistics,
            **(vars(library.statistics) | vars(quality(library))),
        )


def library_path(job: Job) -> Path:
    """Path of the built library: beside its unit-cell file, or in the run folder if that place is read-only.

    A library with every size solved stands in the run folder under a name of its own, one at another wavelength under
    a name with the wavelength.
    """
    source = job.design.library
    if job.nominal is not None and not _is_swept(job.nominal, job.design):
        source = source.with_stem(f"{source.stem}_{job.design.unit_cell.illumination.wavelength_nm:.12g}nm")
    if source.suffix == ".h5":
        return source
    if not job.skips:
        return job.folder / f"{source.stem}_every_size.h5"
    built = source.with_suffix(".h5")
    return built if os.access(source.parent, os.W_OK) else job.folder / built.name


def library_is_current(job: Job) -> bool:
    """Whether the library of the design exists and was built from its unit cell."""
    from metafab import library

    return job.design.library.suffix == ".h5" or library.is_current(library_path(job), job.design.unit_cell)


def open_library(job: Job) -> Library:
    """Load the library of the design; build it first if it is missing or was built from another unit cell.

    At another wavelength than the unit cell's, or an angle, a library that was swept over this axis is evaluated there.

    Raises:
        InputError: another wavelength is asked of a built library without that axis.
    """
    from metafab import library

    if job.nominal is not None:
        wavelength_nm = job.design.unit_cell.illumination.wavelength_nm
        if _is_swept(job.nominal, job.design):
            axes = {} if job.light is None else job.light.angles_deg
            if wavelength_nm != job.nominal.unit_cell.illumination.wavelength_nm:
                axes = {**axes, "wavelength_nm": wavelength_nm}
            return open_library(replace(job, design=job.nominal, nominal=None, light=None)).at(**axes)
        if job.design.library.suffix == ".h5":
            remedy = "name the unit-cell file in its place; libraries at other wavelengths are then built from it"
            expected = f"a library swept over the wavelength up to {wavelength_nm:g} nm (`sweep.axes.wavelength_nm`)"
            raise InputError.single(job.design.name, "library", expected, job.design.library.name, remedy)
    path = library_path(job)
    if not library_is_current(job):
        with job.work.processes() as executor:
            return library.build_file(
                job.design.unit_cell, path, executor=executor, progress=job.work.progress, every_size=not job.skips
            )
    return _OPENED.of(file_mark(path), lambda: library.load(path))


def neighbour_warning(library: Library, use: str) -> str | None:
    """Sentence about a model of neighbours that does not pay, and what uses it all the same; None for others."""
    if library.neighbours is None or library.neighbours.warning is None:
        return None
    return f"{library.neighbours.warning}; raise `neighbours.rows` in the unit cell, or remove {use}"


def libraries(job: Job) -> list[Library]:
    """Load the libraries of all lights of the design, in their order; none for a design with one light."""
    return [open_library(job.at_light(light)) for light in job.design.light]


def _is_swept(nominal: Design, design: Design) -> bool:
    """Whether the library of ``nominal`` gives the wavelength of ``design``: its own, or one of an axis."""
    axes, own_nm = nominal.unit_cell.sweep.axes, nominal.unit_cell.illumination.wavelength_nm
    low, high = (axes and axes.wavelength_nm) or (own_nm, own_nm)
    return low <= design.unit_cell.illumination.wavelength_nm <= high


def _library(job: Job) -> LibraryFigures:
    library, path = open_library(job), library_path(job)
    mark = file_mark(path), library.inputs_sha256
    figures = _JUDGED.of(mark, lambda: LibraryFigures.of(library, "", job.work.workers))
    libraries(job)
    return replace(figures, file=relative_to(job.folder, path))


def _library_files(job: Job) -> tuple[Path, ...]:
    """The library of the unit cell, and those of other lights."""
    return tuple(dict.fromkeys([library_path(job), *(library_path(job.at_light(each)) for each in job.design.light)]))


LIBRARY = Step(
    name="library",
    rooms=("spec", "materials", "cell", "library"),
    after=(),
    inputs=lambda d: (d.unit_cell, d.library if d.library.suffix == ".h5" else None, d.light),
    outputs=_library_files,
    work=_library,
    figures=LibraryFigures,
    not_needed=no_mask,
)
