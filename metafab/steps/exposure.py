"""Electron exposure of a written mask, and the mask with corrected doses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from metafab.core.errors import Fault, InputError
from metafab.core.parallel.progress import Progress
from metafab.core.parallel.work import Work
from metafab.core.storage.files import file_sha256
from metafab.core.storage.tables import optional
from metafab.spec import Design, Dose
from metafab.spec.mask import MOST_DATATYPES, Etch, ExposureProcess
from metafab.steps.job import Job, Step, in_folder, no_mask
from metafab.steps.layout import mask_paths
from metafab.steps.library import open_library

if TYPE_CHECKING:
    from metafab.exposure import BeamPsf, Exposure, ExposureFigures, SizeErrors
    from metafab.exposure.beside_lens import ShapesBeside
    from metafab.exposure.etch import MadePillars
    from metafab.layout import PillarMap
    from metafab.tolerance import CornerField

#: "plain": printed with one dose; "corrected": with the correction of ``[process.exposure]``.
Printed = Literal["plain", "corrected"]

#: Record of the exposure in a run folder.
FILE = "exposure.json"


@dataclass(frozen=True)
class PrintedFigures:
    """Printed less wanted sizes of the first lens of the written mask, by the design's ``[process.exposure]``.

    Pillars that do not print are counted, and left out of the sizes.
    """

    cd_error_rms_nm: float  #: Rms over widths and lengths, with one dose for all pillars.
    cd_error_max_nm: float  #: Largest magnitude, likewise.
    unprinted: int  #: Pillars that do not print, likewise.
    error: float  #: Error of an energy over the clearing energy.
    corrected_rms_nm: float | None = optional()  #: Rms after the correction; None without one; likewise the following.
    corrected_max_nm: float | None = optional()  #: Largest magnitude.
    corrected_unprinted: int | None = optional()  #: Pillars that do not print.
    dose_min: float | None = optional()  #: Smallest dose relative to the base dose.
    dose_max: float | None = optional()  #: Largest dose.
    classes: int | None = optional()  #: Number of distinct doses.


@dataclass(frozen=True)
class ExposedMask:
    """Exposure of a written mask."""

    drawn: PillarMap  #: Pillars of the mask, with their bias.
    psf: BeamPsf  #: Point-spread function of the beam.
    exposure: Exposure  #: Printed sizes and doses.
    beside: tuple[ShapesBeside, ...]  #: Shapes of the mask beside the lens.
    plain: SizeErrors | None  #: Size errors with one dose; None unless ``keep_plain``.
    lenses: Mapping[int, Exposure]  #: Exposures by number of the lens: of all lenses if their doses are corrected.


@dataclass(frozen=True)
class CopyFigures:
    """Printed sizes of one lens of ``mask.copies`` at its dose, all lenses being corrected."""

    copy: int  #: Number of the lens.
    dose: float  #: Its dose relative to the base dose, a factor on the corrected ones.
    cd_error_rms_nm: float  #: Rms of printed less wanted widths and lengths.
    cd_error_max_nm: float  #: Largest magnitude.
    unprinted: int  #: Pillars that do not print.
    dose_min: float  #: Smallest dose of a pillar relative to the base dose.
    dose_max: float  #: Largest dose.
    doses_of: int  #: First lens with the same corrected doses: another one where neither has shapes in reach.


@dataclass(frozen=True)
class MadeMask:
    """Light behind the pillars that exposure and etch make of a written mask."""

    field: CornerField  #: The made pillars with their amplitudes, compared with the drawn ones.
    made: MadePillars  #: Sizes of the pillars.
    exposure: ExposureFigures  #: Printed sizes.


def made_mask(job: Job, path: Path, printed: Printed, copy: int = 1) -> MadeMask:
    """Predict the pillars of a written mask by ``[process]``, and the light behind them.

    The amplitudes are those of the made height, sidewalls and rounded outlines, computed as for a corner of the
    tolerances (:mod:`metafab.tolerance.corners`). ``printed`` is "plain" for one dose, or "corrected" for the
    correction of ``[process.exposure]``. Errors as :func:`expose_mask`; InputError for sizes too far beyond the
    library.
    """
    from metafab import optics, tolerance
    from metafab.exposure import exposure_process
    from metafab.exposure.etch import made_pillars
    from metafab.layout.outlines import Outline

    design, work = job.design, job.work
    if design.unit_cell.cell.is_hexagonal and design.unit_cell.cell.shape == "rectangle":
        expected, remedy = "'rectangular', for the round corners of printed rectangles", "circles are available"
        raise InputError.single(design.name, "cell.lattice", expected, "'hexagonal'", remedy)
    exposed = expose_mask(path, design, work, correct=printed == "corrected", copy=copy, keep_sizes=True)
    assert design.process is not None
    figures = exposed.exposure.figures
    figures.require_printed(design.name, "process.exposure.base_over_clearing_dose")
    etch = design.process.etch or Etch()
    made = made_pillars(exposed.drawn, exposed.exposure, etch, Outline.of(design))
    is_rectangle = design.unit_cell.cell.shape == "rectangle"
    _require_standing(made, figures.corner_radius_nm if is_rectangle else 0.0, etch, design.name)
    library = open_library(job)
    corner = dict(etch.corner)
    if is_rectangle:
        corner = {"corner_radius_nm": round(figures.corner_radius_nm, 3), **corner}
    with work.processes() as executor:
        field = optics.made_field(made.pillars, library, executor)
        doses = "one dose" if printed == "plain" else f"corrected {exposure_process(design).correction}s"
        corners = [(f"printed, {doses}", corner)]
        (at,) = tolerance.fields_at(field, library, corners, executor=executor, progress=work.progress)
    # The cells have the mean radius. The area that a rounded corner lacks grows as its radius squared.
    uneven = 2.0 * at.change * figures.corner_radius_rms_nm / figures.corner_radius_nm if is_rectangle else 0.0
    return MadeMask(replace(at, error=math.hypot(at.error, uneven)), made, figures)


def _require_standing(made: MadePillars, radius_nm: float, etch: Etch, name: str) -> None:
    """Refuse an etch that leaves no pillar, or pillars narrower than the round corners that they are printed with."""
    if math.isinf(made.narrowest_nm):
        got, expected = "none is left", "an etch that leaves pillars"
    elif made.narrowest_nm < 2.0 * radius_nm:
        got = f"a narrowest one of {made.narrowest_nm:.3g} nm"
        expected = f"made pillars of {2.0 * radius_nm:.3g} nm or more, twice the radius of their printed corners"
    else:
        return
    if etch == Etch():
        raise InputError.single(name, "process.exposure", expected, got, "expose longer, or draw larger pillars")
    raise InputError.single(name, "process.etch", expected, f"{got} at a bias of {etch.bias_nm:g} nm", "etch less")


def expose_mask(
    path: Path,
    design: Design,
    work: Work,
    *,
    correct: bool = False,
    samples: int = 0,
    copy: int = 1,
    keep_sizes: bool = False,
    keep_plain: bool = False,
) -> ExposedMask:
    """Read a mask, of a design with ``[process.exposure]``, and expose its drawn pillars.

    They are corrected by its ``correction`` if ``correct``. ``samples`` random pillars are listed; ``copy`` is a lens
    of ``mask.copies``, counted from 1. ``keep_sizes`` keeps the printed sizes of all pillars, ``keep_plain`` the size
    errors with one dose beside those of the correction.

    InputError if the design has no ``[process.exposure]``, a key of it is not available with the exposure, the file
    holds shapes that are no pillars of the lattice, or pillars have doses of their own, which are not read.
    """
    from metafab import exposure
    from metafab.exposure.beside_lens import read_lenses
    from metafab.exposure.expose import base_dose_to_size
    from metafab.layout.outlines import Outline

    process = _available_process(design, correct=correct)
    outline, together = Outline.of(design), correct and process.correction == "dose"
    copies, in_focus = design.mask.copies, exposure.beam_psf(process)
    # All lenses are corrected for the focus of the one that is read.
    psf = exposure.beam_psf(process, copies[copy - 1].focus_um) if 1 <= copy <= len(copies) else in_focus
    range_nm = float(psf.range_nm.max())
    lenses, listed = read_lenses(path, design, copy, range_nm, work.progress, together=together)
    pillars, ratio = lenses[0].pillars, process.base_over_clearing_dose
    if ratio is None and psf.blur_nm != in_focus.blur_nm:  # All copies share the base dose, that of the best focus.
        ratio = base_dose_to_size(pillars, in_focus, outline, work)
    exposed = partial(exposure.expose_lenses, psf=psf, outline=outline, contrast=process.contrast, work=work)
    plain: SizeErrors | None = None
    if correct and keep_plain:
        (before,) = exposed(lenses[:1], base_over_clearing_dose=ratio)
        ratio, plain = before.figures.base_over_clearing_dose, exposure.SizeErrors.of(before)
        del before  # its doses are as large as the lens
    numerics = exposure.ExposureNumerics(
        classes=process.classes,
        most_classes=MOST_DATATYPES // len(design.mask.doses),
        samples=samples,
        keep_sizes=keep_sizes,
    )
    correction = process.correction if correct else "none"
    found = exposed(lenses, base_over_clearing_dose=ratio, correction=correction, numerics=numerics)
    if keep_plain and not correct:
        plain = exposure.SizeErrors.of(found[0])
    by_number = sorted(zip((lens.number for lens in lenses), found, strict=True))
    return ExposedMask(pillars, psf, found[0], listed, plain, dict(by_number))


def _available_process(design: Design, *, correct: bool) -> ExposureProcess:
    """``[process.exposure]`` of a design; InputError if a key of it, or of the mask, is not available with it."""
    from metafab import exposure

    further = []
    if correct and any(copy.bias_nm for copy in design.mask.copies):
        expected, remedy = "copies without a bias of their own", "correct each variant as a design of its own"
        further.append(Fault("mask.copies", expected, "biased copies", remedy))
    dose = design.mask.dose
    if dose is not None and (dose.by == "proximity" or not correct):
        got, remedy = f"classes by {dose.by}", "expose the plain mask with its own design"
        further.append(Fault("mask.dose", "one dose for all pillars: doses of classes are not read", got, remedy))
    process = exposure.exposure_process(design, further)
    if correct and process.correction == "dose" and 2 * len(design.mask.doses) > MOST_DATATYPES:
        expected = f"at most {MOST_DATATYPES // 2} different doses, as each has two classes at least"
        remedy = 'correct groups of them as designs of their own, or set `process.exposure.correction = "shape"`'
        raise InputError.single(design.name, "mask.copies", expected, f"{len(design.mask.doses)}", remedy)
    return process


def copy_figures(exposed: ExposedMask, design: Design) -> tuple[CopyFigures, ...]:
    """Figures of each lens of a corrected mask; empty for a single lens."""
    found: list[CopyFigures] = []
    first: dict[int, int] = {}
    for number, lens in exposed.lenses.items() if len(exposed.lenses) > 1 else ():
        figures = lens.figures
        found.append(
            CopyFigures(
                number,
                design.mask.copies[number - 1].dose,
                figures.cd_error_rms_nm,
                figures.cd_error_max_nm,
                figures.unprinted,
                figures.dose_min,
                figures.dose_max,
                first.setdefault(id(lens.dose_class), number),
            )
        )
    return tuple(found)


def errors_of_copies_nm(copies: Sequence[CopyFigures]) -> tuple[float, float]:
    """Rms and largest magnitude of the size errors of all lenses of which any pillar prints; NaN without one."""
    printing = [one for one in copies if not math.isnan(one.cd_error_rms_nm)]
    if not printing:
        return math.nan, math.nan
    square = sum(one.cd_error_rms_nm**2 for one in printing) / len(printing)
    return math.sqrt(square), max(one.cd_error_max_nm for one in printing)


def save_exposure(exposed: ExposedMask, mask_file: Path, design: Design, path: Path) -> None:
    """Write ``exposure.json`` for the report of the mask's run: the exposure with its ``plain`` size errors."""
    from metafab import exposure

    assert exposed.plain is not None
    found = exposed.exposure
    corrected = found.figures.rounds > 0
    record = exposure.ExposureRecord(
        file_sha256(mask_file),
        exposed.psf.source,
        exposure.exposure_process(design).correction if corrected else "none",
        exposed.plain,
        exposure.SizeErrors.of(found) if corrected else None,
    )
    exposure.save_record(record, path)


def corrected_folder(folder: Path, mask_file: Path) -> Path:
    """Return where a corrected mask goes: ``folder``, or a folder in it where the plain mask or a run would be lost."""
    holds_mask = folder.is_dir() and folder.samefile(mask_file.parent)
    return folder / "corrected" if holds_mask or (folder / "summary.json").is_file() else folder


def write_corrected(
    exposed: ExposedMask, design: Design, folder: Path, progress: Progress, *, dose_datatypes: bool = False
) -> tuple[Path, ...]:
    """Write the corrected mask; with corrected doses one datatype for each class, and tables of their doses.

    Each lens of ``mask.copies`` has doses of its own, in common classes. The table has the columns ``datatype``,
    ``dose_over_base_dose`` and, for several lenses, ``copies``, the numbers of those that use the datatype. With
    ``dose_datatypes``, ``doses.gds`` has the doses in thousandths as datatypes. The same design reads the mask back.
    """
    from metafab import mask

    found = exposed.exposure
    # The drawn pillars hold the bias already.
    plain = replace(design, mask=replace(design.mask, bias_nm=0.0))
    if found.dose_class is None:
        return tuple(file.path for file in mask.write(found.drawn, folder, plain, progress=progress))
    dosed = replace(plain, mask=replace(plain.mask, dose=Dose(by="proximity", classes=len(found.class_dose))))
    of_site = [lens.dose_class for lens in exposed.lenses.values() if lens.dose_class is not None]
    files = mask.write(
        found.drawn,
        folder,
        dosed,
        progress=progress,
        dose_class=of_site,
        class_dose=found.class_dose,
        dose_datatypes=dose_datatypes,
    )
    return tuple(file.path for file in files)


def _printed(job: Job) -> PrintedFigures:
    """Expose the written mask with one dose and corrected; write the record for the report."""
    path = mask_paths(job)[-1]
    # Copies with a bias, or at too many doses, are predicted; their correction is refused.
    mask = job.design.mask
    correct = not any(copy.bias_nm for copy in mask.copies) and 2 * len(mask.doses) <= MOST_DATATYPES
    exposed = expose_mask(path, job.design, job.work, correct=correct, keep_plain=True)
    save_exposure(exposed, path, job.design, job.folder / FILE)
    assert exposed.plain is not None
    plain, found = exposed.plain.figures, exposed.exposure.figures
    printed = PrintedFigures(plain.cd_error_rms_nm, plain.cd_error_max_nm, plain.unprinted, found.error)
    if not correct:
        return printed
    return replace(
        printed,
        corrected_rms_nm=found.cd_error_rms_nm,
        corrected_max_nm=found.cd_error_max_nm,
        corrected_unprinted=found.unprinted,
        dose_min=found.dose_min,
        dose_max=found.dose_max,
        classes=found.classes,
    )


def _not_predicted(design: Design) -> str | None:
    """Return why the exposure of a design's mask is not predicted; None if it is."""
    process = None if design.process is None else design.process.exposure
    if process is None:
        return "the design has no [process.exposure]"
    if design.mask.dose is not None:
        return "the mask has dose classes; `metafab expose` reads the mask of one dose"
    from metafab.exposure.electrons.process import unavailable_keys

    if faults := unavailable_keys(design):
        return f"`{faults[0].field}` = {faults[0].got} is {faults[0].remedy}"
    focus_um = design.mask.copies[0].focus_um if design.mask.copies else process.best_focus_um
    if focus_um != process.best_focus_um and process.convergence_mrad is None:
        return "the first lens is out of focus, and `process.exposure.convergence_mrad` is not stated"
    return no_mask(design)


EXPOSURE = Step(
    name="exposure",
    rooms=("mask", "exposure"),
    after=("layout",),
    inputs=lambda design: (design.process, design.mask, design.unit_cell.cell),
    outputs=in_folder(FILE),
    work=_printed,
    figures=PrintedFigures,
    not_needed=_not_predicted,
)
