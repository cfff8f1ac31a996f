"""Table of measured sizes -> process file of later designs, by :mod:`metafab.exposure.fit`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import Fault, InputError, SpecError
from metafab.core.parallel.work import Work
from metafab.core.storage.files import whole_file
from metafab.exposure.beside_lens import read_lenses
from metafab.exposure.electrons.process import beam_psf, exposure_process
from metafab.exposure.fit import ProcessFit, fit_process
from metafab.exposure.size_model import MeasuredLens, Parameter
from metafab.layout.outlines import Outline
from metafab.mask.measured import MeasuredTable, read_measured
from metafab.spec import Design, UnitCell, canonical_toml
from metafab.spec.mask import Etch, ExposureProcess, Process

#: Columns of the table whose means become properties of the etch.
_ETCHED = ("height_nm", "sidewall_angle_deg", "corner_radius_nm")


@dataclass(frozen=True)
class FittedProcess:
    """A fit and the specs that follow from it."""

    fit: ProcessFit  #: Parameters with their errors.
    process: Process  #: ``[process]`` of later designs.
    #: Unit cell with the measured height, sidewalls and corners; None if the table has none of them.
    unit_cell: UnitCell | None


def fitted_process(
    table: Path, mask_file: Path, design: Design, free: Sequence[Parameter], copy: int, work: Work
) -> FittedProcess:
    """Fit the process of a design to measured sizes of pillars of a written mask.

    Args:
        table: .csv with x_um, y_um (from the axis of the lens), width_nm, length_nm; further columns where they are
            known: copy (lens of ``mask.copies``), dose (relative to that of the copy), focus_um (added to that of the
            copy), height_nm, sidewall_angle_deg, corner_radius_nm.
        mask_file: the mask that was exposed.
        design: its design, with ``[process.exposure]`` as the start.
        free: parameters that are fitted.
        copy: lens of ``mask.copies`` where the table has no such column, counted from 1.
        work: threads and progress.

    Raises:
        InputError: the design has no ``[process.exposure]``, or keys that the fit does not support; a table that cannot
            be read, with places without a pillar, doses that are not positive or means that no pillar has; or sizes
            that do not determine the parameters.
    """
    start = exposure_process(design, _unfit(design))
    measured = read_measured(table, ("copy", "dose", "focus_um", *_ETCHED))
    # Widths and lengths of round pillars may differ: both are measured.
    design.unit_cell.cell.require_sides(table, measured.has_diameters)
    means: dict[str, Any] = {
        name: round(float(np.mean(values)), 3) for name, values in measured.further.items() if name in _ETCHED
    }
    etch, unit_cell = _etched(design, means, table)
    lenses, rows = _measured_lenses(measured, mask_file, design, start, copy, work)
    fit = fit_process(lenses, start, free, etch, work)
    fit = replace(fit, far=tuple(replace(size, row=int(rows[size.row - 1]) + 1) for size in fit.far))
    known = "" if start.source == "assumption" else f"{start.source}; "
    source = f"{known}fit of {', '.join(free)} to {fit.sizes} sizes of {table.name} at {fit.doses} doses"
    changes = {"bias_nm": round(fit.bias_nm.value, 4), "microloading_nm": round(fit.microloading_nm.value, 4)}
    process = Process(exposure=_exposure(start, fit, source), etch=replace(etch, **changes, source=source))
    return FittedProcess(fit, process, unit_cell)


def _unfit(design: Design) -> list[Fault]:
    """Keys of a design that the fit does not support."""
    mask, shape, unavailable = design.mask, design.unit_cell.cell.shape, "not available with the fit"
    faults = []
    if mask.dose is not None:
        faults.append(Fault("mask.dose", "one dose for all pillars", "dose classes", "fit a mask without them"))
    if Outline.of(design).shape == "rounded":
        faults.append(Fault("mask.draw_corners", "rectangles with sharp corners", "true", unavailable))
    if shape in {"circle", "ellipse"}:
        faults.append(Fault("cell.shape", "'rectangle'", repr(shape), unavailable))
    return faults


def _measured_lenses(
    measured: MeasuredTable, mask_file: Path, design: Design, start: ExposureProcess, copy: int, work: Work
) -> tuple[list[MeasuredLens], NDArray[np.int64]]:
    """Rows of a table by lens of the mask and by focus, each with its dose; and their numbers from 0, in that order."""
    rows = len(measured.size_nm)
    numbers = measured.further.get("copy", np.full(rows, float(copy)))
    doses = measured.further.get("dose", np.ones(rows))
    # A lens without a stated focus is in the best one, as in :func:`metafab.steps.exposure.expose_mask`.
    stated_um = 0.0 if design.mask.copies else start.best_focus_um
    focuses = measured.further.get("focus_um", np.full(rows, stated_um))
    if (doses <= 0.0).any() or (numbers != np.rint(numbers)).any():
        expected = "positive doses, and whole numbers of copies"
        raise InputError.single(str(measured.path), "rows", expected, f"dose {doses.min():g}, copy {numbers.min():g}")
    lenses, order, range_nm = [], [], float(beam_psf(start).range_nm.max())
    for number in np.unique(numbers).astype(int).tolist():
        (read,), _ = read_lenses(mask_file, design, number, range_nm, work.progress)
        focus_of_lens_um = design.mask.copies[number - 1].focus_um if design.mask.copies else 0.0
        around = read.beside and read.beside.per_dose(read.dose)
        for focus_um in np.unique(focuses[numbers == number]).tolist():
            here = (numbers == number) & (focuses == focus_um)
            part = measured.part(here)
            sites = part.sites(read.pillars)
            part.require_each_once(sites, doses[here])
            exposed = doses[here] * read.dose, part.size_nm, focus_of_lens_um + focus_um
            lenses.append(MeasuredLens(read.pillars, sites, *exposed, beside=around))
            order.append(np.flatnonzero(here))
    return lenses, np.concatenate(order)


def process_files(path: Path, fitted: FittedProcess) -> tuple[Path, ...]:
    """Return the files of :func:`save_process`."""
    return (path,) if fitted.unit_cell is None else (path, path.with_name(f"{path.stem}_cell.toml"))


def save_process(fitted: FittedProcess, path: Path) -> tuple[Path, ...]:
    """Write the process file, and beside it NAME_cell.toml with the unit cell of the made pillars if there is one."""
    fit = fitted.fit
    lines = [
        f"# {name}: {value.value:.6g}" + (f" +- {value.error:.2g}" if value.error is not None else " (not fitted)")
        for name, value in (
            ("base_over_clearing_dose", fit.base_over_clearing_dose),
            ("backscatter_ratio", fit.backscatter_ratio),
            ("blur_nm", fit.blur_nm),
            ("bias_nm", fit.bias_nm),
            ("microloading_nm", fit.microloading_nm),
            ("convergence_mrad", fit.convergence_mrad),
            ("best_focus_um", fit.best_focus_um),
        )
        if value is not None
    ]
    lines += [f"# far from the fit: {size}" for size in fit.far]
    files = process_files(path, fitted)
    texts = ["\n".join([*lines, ""]) + canonical_toml(fitted.process, path.parent)]
    if fitted.unit_cell is not None:
        texts.append(canonical_toml(fitted.unit_cell, path.parent))
    for name, text in zip(files, texts, strict=True):
        with whole_file(name) as part:
            part.write_text(text, encoding="utf-8")
    return files


def _etched(design: Design, means: dict[str, Any], table: Path) -> tuple[Etch, UnitCell | None]:
    """Etch and unit cell with ``means`` of the columns of a table; no unit cell if there are none."""
    etch = design.process.etch if design.process is not None and design.process.etch is not None else Etch()
    if not means:
        return etch, None
    try:
        made = replace(etch, **means)
        return made, replace(design.unit_cell, cell=replace(design.unit_cell.cell, **means))
    except SpecError as error:
        listed = ", ".join(f"{name} {value:g}" for name, value in means.items())
        faults = [
            replace(fault, field=fault.field if fault.field in means else ", ".join(means), got=f"a mean of {listed}")
            for fault in error.faults
        ]
        raise InputError(str(table), faults) from error


def _exposure(start: ExposureProcess, fit: ProcessFit, source: str) -> ExposureProcess:
    """The beam and dose of a fit; a fitted ratio applies to the function of the start."""
    ratio = start.backscatter_ratio if fit.backscatter_ratio.error is None else round(fit.backscatter_ratio.value, 6)
    return replace(
        start,
        blur_nm=round(fit.blur_nm.value, 6),
        convergence_mrad=None if fit.convergence_mrad is None else round(fit.convergence_mrad.value, 6),
        best_focus_um=round(fit.best_focus_um.value, 6),
        backscatter_ratio=ratio,
        base_over_clearing_dose=round(fit.base_over_clearing_dose.value, 6),
        source=source,
    )
