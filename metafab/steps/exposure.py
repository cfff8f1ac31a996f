"""Electron exposure of a written mask, and the mask with corrected doses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from metafab.core.errors import Fault, InputError
from metafab.core.parallel.progress import Progress
from metafab.core.parallel.work import Work
from metafab.core.storage.files import whole_file
from metafab.spec import Design, Dose

if TYPE_CHECKING:
    from metafab.exposure import BeamPsf, Exposure
    from metafab.layout import PillarMap


@dataclass(frozen=True)
class ExposedMask:
    """Exposure of a written mask.

    Attributes:
        drawn: pillars of the mask, with their bias.
        psf: point-spread function of the beam.
        exposure: printed sizes and doses.
    """

    drawn: PillarMap
    psf: BeamPsf
    exposure: Exposure


def expose_mask(path: Path, design: Design, correct: bool, samples: int, copy: int, work: Work) -> ExposedMask:
    """Read a mask and expose its drawn pillars.

    Args:
        path: the mask file.
        design: design of the mask, with ``[process.exposure]``.
        correct: whether the dose of each pillar is corrected.
        samples: number of random pillars to list.
        copy: lens of ``mask.copies``, counted from 1.
        work: threads and progress.

    Raises:
        InputError: the design has no ``[process.exposure]``; a key of it is not available with the exposure; or the
            file holds shapes that are no pillars of the lattice.
    """
    from metafab import exposure, mask

    process = None if design.process is None else design.process.exposure
    if process is None:
        remedy = 'add `[process.exposure]` with `preset = "hsq_sos_100kv"`, or with your own `terms`'
        raise InputError.single(design.name, "process.exposure", "a table", "none", remedy)
    faults = _unavailable(design)
    if faults:
        raise InputError(design.name, faults)
    psf = exposure.beam_psf(process)
    back = mask.read(path, design, progress=work.progress, copy=copy)
    back.require_pillars_alone("their exposure cannot be simulated; `metafab drc` lists their places")
    found = exposure.expose(
        back.pillars,
        psf,
        base_over_clearing_dose=process.base_over_clearing_dose,
        correct=correct,
        numerics=exposure.ExposureNumerics(classes=process.classes, samples=samples),
        work=work,
    )
    return ExposedMask(back.pillars, psf, found)


def write_corrected(exposed: ExposedMask, design: Design, folder: Path, progress: Progress) -> tuple[Path, ...]:
    """Write the mask with one datatype for each dose class, and ``doses.csv``.

    The table has the columns ``datatype`` and ``dose_over_base_dose``. A design with ``[mask.dose]``,
    ``by = "proximity"`` and as many classes reads the mask back.

    Args:
        exposed: the corrected exposure.
        design: design of the mask.
        folder: created if missing.
        progress: callback with the number of written sites.

    Raises:
        InputError: the exposure is not corrected.
    """
    from metafab import mask

    found = exposed.exposure
    if found.dose_class is None:
        raise InputError.single("--correct", "correct", "corrected doses in classes", "none")
    dose = Dose(by="proximity", classes=len(found.class_dose))
    # The drawn pillars hold the bias already.
    dosed = replace(design, mask=replace(design.mask, dose=dose, bias_nm=0.0))
    files = mask.write(exposed.drawn, folder, dosed, progress=progress, dose_class=found.dose_class)
    table = folder / "doses.csv"
    with whole_file(table) as part:
        rows = [f"{design.mask.datatype + k},{value:.6f}\n" for k, value in enumerate(found.class_dose)]
        part.write_text("datatype,dose_over_base_dose\n" + "".join(rows), encoding="utf-8")
    return (*(file.path for file in files), table)


def _unavailable(design: Design) -> list[Fault]:
    """Keys of a design that the exposure does not support."""
    cell, faults = design.unit_cell.cell, []
    if cell.shape != "rectangle":
        faults.append(Fault("cell.shape", "'rectangle'", repr(cell.shape), "not available with the exposure"))
    if cell.is_hexagonal:
        faults.append(Fault("cell.lattice", "'rectangular'", "'hexagonal'", "not available with the exposure"))
    if design.mask.tone != "negative":
        expected = "'negative', where the drawn pillars are exposed"
        faults.append(Fault("mask.tone", expected, repr(design.mask.tone), "not available with the exposure"))
    if any(copy.bias_nm for copy in design.mask.copies):
        expected, remedy = "copies without a bias of their own", "expose each variant as a design of its own"
        faults.append(Fault("mask.copies", expected, "biased copies", remedy))
    return faults
