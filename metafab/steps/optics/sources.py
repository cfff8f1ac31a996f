"""Light behind the pillars: of the written mask, of made or measured pillars, and of the target phases.

In all functions ``path`` is a mask file and ``copy`` the number of the lens in a file that holds several, from 1.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from metafab.core.errors import Fault, InputError
from metafab.core.parallel.executor import in_order
from metafab.core.storage.files import Latest, file_mark, fingerprint
from metafab.steps.exposure import Printed, made_mask
from metafab.steps.job import Job
from metafab.steps.library import library_path, open_library

if TYPE_CHECKING:
    from metafab.layout import PillarMap
    from metafab.library.use.oblique import ObliqueChange
    from metafab.optics import NeighbourField, Source, WrittenField
    from metafab.optics.geometry.imaging import Tangent
    from metafab.optics.sources.oblique import ObliqueField

#: Windows of a mask in which the joint effect of rows and columns is solved, and their sites along a side: 3 s of
#: processor time each. Of 16 such windows of the paper's lens four hold nearly all of it: 0.074 of the field (rms), but
#: 0.010 at the median and 0.30 at most. Nine of ten choices of eight of them give 0.02 to 0.10.
_JOINT_WINDOWS, _JOINT_SITES = 8, 3
#: The pillars that were read last, shared by the steps of a run.
_READ: Latest[PillarMap] = Latest()
#: Their field among neighbours, solved once for all steps of a run.
_AMONG: Latest[NeighbourField] = Latest()
#: Their change by the direction of the light, likewise.
_OBLIQUE: Latest[ObliqueChange | None] = Latest()
#: Its error where it is left out, likewise.
_OBLIQUE_ERROR: Latest[float | None] = Latest()


@dataclass(frozen=True)
class WrittenLens:
    """The pillars of a lens in a written file: as drawn, as the process prints them, or as they were measured."""

    path: Path  #: Mask file.
    copy: int = 1  #: Number of the lens in a file that holds several, from 1.
    printed: Printed | None = None  #: Doses with which ``[process]`` prints the pillars; None for those of the file.
    #: Table of measured sizes (:func:`metafab.optics.sources.measured.with_measured_sizes`); None likewise.
    sizes: Path | None = None


def mask_source(job: Job, path: Path, copy: int = 1, angles: int | None = None) -> WrittenField:
    """Transmitted field of the pillars of a written file.

    Consecutive steps share the pillars as long as file and design are unchanged. ``angles`` is the number of angles of
    turned pillars in half a turn; None for upright pillars. InputError if the file cannot be read, or holds shapes that
    are no pillars of the lattice.
    """
    from metafab import optics

    if path.is_file():
        key = _pillars_key(job, path, copy, angles)
        pillars = _READ.of(key, lambda: _read_pillars(job, path, copy, angles))
    else:
        pillars = _read_pillars(job, path, copy, angles)
    return optics.written_field(pillars, open_library(job))


def written_light(job: Job, path: Path, copy: int = 1) -> WrittenField | NeighbourField:
    """Transmitted field of the pillars of a written file, among their neighbours if design and library say so.

    ``[optics] neighbours`` decides; without it, the library's model is used if it has one that lowers the error.
    InputError as for :func:`mask_source`, and if the design asks for neighbours that the library has no model of.
    """
    from metafab import optics

    lone = mask_source(job, path, copy)
    asked, library = job.design.optics and job.design.optics.neighbours, open_library(job)
    pays = library.neighbours is not None and library.neighbours.pays
    if asked is False or (asked is None and not pays):
        return lone
    if job.nominal is not None:  # a library evaluated at another wavelength or angle, which no file holds
        return optics.neighbour_field(lone.pillars, library, job.work.workers)
    key = _pillars_key(job, path, copy, None), file_mark(library_path(job))
    return _AMONG.of(key, lambda: optics.neighbour_field(lone.pillars, library, job.work.workers))


def light_over_field(
    job: Job, straight: WrittenField | NeighbourField, tangents: Sequence[Tangent] = ()
) -> WrittenField | NeighbourField | ObliqueField:
    """Light of the pillars under light from each direction of the field, where design or error budget ask for it.

    ``[optics] oblique`` decides. Without it, angles are solved if they change the field by more than the library's
    model of neighbours errs, and the directions ``tangents`` lie in the field.

    InputError where the key asks for them and a direction lies beyond the field, or RCWA does not solve such pillars at
    angles.
    """
    from metafab.library.use.oblique import oblique_change, reach_of
    from metafab.optics.geometry.imaging import Imaging, field_corner
    from metafab.optics.sources.oblique import ObliqueField, require_reach

    asked, corner = job.design.optics and job.design.optics.oblique, field_corner(job.design, Imaging.of(job.design))
    if asked is False or corner is None or job.design.light or job.nominal is not None:
        return straight
    if asked is None and not _outweighs_neighbours(job, straight):
        return straight
    try:
        require_reach(tangents, reach_of(corner))
    except InputError:
        if asked is None:
            return straight
        raise
    pillars = straight.pillars

    def solved() -> ObliqueChange | None:
        return oblique_change(open_library(job), pillars.size_nm(), pillars.numbers(), corner, job.work)

    if (change := _OBLIQUE.of(_sizes_key(job, pillars), solved)) is None:
        raise InputError(job.design.name, [unsolved_angles("others, or none")])
    return ObliqueField(straight, change)


def oblique_error(job: Job, light: WrittenField | NeighbourField | ObliqueField) -> float | None:
    """Error of the pillars' light from the corner of the field; None without a field, and where it is not solved."""
    from metafab.library.use.oblique import oblique_field_error
    from metafab.optics.geometry.imaging import Imaging, field_corner
    from metafab.optics.sources.oblique import ObliqueField

    if isinstance(light, ObliqueField):
        return light.change.left
    corner, pillars = field_corner(job.design, Imaging.of(job.design)), light.pillars
    if corner is None:
        return None

    def solved() -> float | None:
        library, workers = open_library(job), job.work.workers
        return oblique_field_error(library, pillars.size_nm(), pillars.numbers(), corner, workers)

    return solved() if job.nominal is not None else _OBLIQUE_ERROR.of(_sizes_key(job, pillars), solved)


def joint_error(job: Job, light: WrittenField | NeighbourField | None) -> float | None:
    """Rms joint effect of rows and columns on windows of the mask, relative to their field.

    The light of a mask among neighbours leaves it out. None for other light, and where it is not solved.
    """
    from metafab.library.neighbours import joint_share
    from metafab.optics import NeighbourField
    from metafab.optics.sources.neighbours import filled_windows

    if not isinstance(light, NeighbourField):
        return None
    library, windows = open_library(job), filled_windows(light.pillars, _JOINT_WINDOWS, _JOINT_SITES)
    if library.is_continuous:
        _ = library.surface  # made once here, not by each worker
    shares: list[float] = []
    with job.work.processes() as executor:
        for found in in_order(executor, partial(joint_share, library), windows):
            if found is None:
                return None
            shares += found.tolist()
            job.work.progress("joint effect of neighbours", len(shares) // 2, len(windows))
    return math.sqrt(sum(share**2 for share in shares) / len(shares)) if shares else None


def _outweighs_neighbours(job: Job, straight: WrittenField | NeighbourField) -> bool:
    """Whether light at angles changes the field by more than the model of neighbours errs, as the budget has both."""
    from metafab.optics import NeighbourField

    neighbours = open_library(job).neighbours
    if not isinstance(straight, NeighbourField) or neighbours is None:
        return False
    return (oblique_error(job, straight) or 0.0) > neighbours.overall.error_alike


def unsolved_angles(got: str) -> Fault:
    """The fault of ``[optics] oblique`` with pillars that RCWA does not solve under oblique light."""
    expected = "upright rectangles on a clear isotropic substrate"
    return Fault("optics.oblique", expected, got, "remove `oblique` from `[optics]`")


def ideal_source(job: Job) -> Source:
    """Transmitted field of the target phases, without a mask."""
    from metafab import layout, optics

    design = job.design
    lattice = layout.lattice_of(design) if design.has_mask else layout.sampling_lattice(job.profile, design)
    return optics.ideal_field(job.profile, lattice, design.device)


def lit_source(job: Job, source: Source) -> Source:
    """Apply the stop and the apodisation of the design to a source."""
    from metafab import optics

    return optics.apodised(source, optics.Apodisation.of(job.design))


def source_of(job: Job, lens: WrittenLens | None, *, tangents: Sequence[Tangent] = ()) -> tuple[Source, float]:
    """Light of a lens, or of the target phases (None); relative error of printed pillars' amplitudes, NaN for others.

    ``tangents`` are the directions from which light is needed, by default those of the scene's field. The light of made
    and of measured pillars is the same from all directions.
    """
    if lens is None:
        return lit_source(job, ideal_source(job)), math.nan
    if lens.sizes is not None:
        return lit_source(job, _measured_field(job, lens.path, lens.copy, lens.sizes)), math.nan
    if lens.printed is not None:
        made = made_mask(job, lens.path, lens.printed, lens.copy).field
        return lit_source(job, made.field), made.error
    pillars, is_on_axis = written_light(job, lens.path, lens.copy), set(tangents) == {(0.0, 0.0)}
    return lit_source(job, pillars if is_on_axis else light_over_field(job, pillars, tangents)), math.nan


def empty_share(job: Job, lens: WrittenLens) -> float:
    """Share of the sites in the design's aperture at which a file has no pillar; below 0 if it has others besides."""
    from metafab.layout import Aperture

    pillars = mask_source(job, lens.path, lens.copy).pillars
    return 1.0 - int(pillars.numbers().sum()) / Aperture.of(job.design).count


def _measured_field(job: Job, path: Path, copy: int, sizes: Path) -> WrittenField:
    """Field of the pillars of a file with measured sizes."""
    from metafab.optics.sources.measured import with_measured_sizes
    from metafab.optics.sources.source import made_field

    library = open_library(job)
    return made_field(with_measured_sizes(mask_source(job, path, copy).pillars, sizes, library), library)


def _sizes_key(job: Job, pillars: PillarMap) -> Hashable:
    """Key of the sizes of a mask and of the library that solves them."""
    return fingerprint(job.design), pillars.numbers().tobytes(), file_mark(library_path(job))


def _pillars_key(job: Job, path: Path, copy: int, angles: int | None) -> Hashable:
    """Key of the pillars of a written file: file, design, number of the lens, and angles of turned pillars."""
    return file_mark(path), fingerprint(job.design), copy, angles


def _read_pillars(job: Job, path: Path, copy: int, angles: int | None) -> PillarMap:
    """Pillars of a file, without the bias with which they are drawn."""
    from metafab import mask
    from metafab.mask.turned import read_turned

    progress = job.work.progress
    if angles is None:
        back = mask.read_shared(path, job.design, progress, copy)
    else:
        back = read_turned(path, job.design, angles, progress=progress, copy=copy)
    back.require_pillars_alone("their light cannot be simulated; `metafab drc` lists their places")
    return mask.biased(back.pillars, -job.design.mask.bias_nm)
