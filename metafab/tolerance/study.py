"""PSFs, efficiency, extinction, decoded depth and focus at the corners of a written mask, against the nominal mask.

The mask is read and its pillars are summed in blocks once. A corner of the cell sums them again with other amplitudes
(:mod:`metafab.tolerance.corners`). Random faults act on the block sums themselves (:mod:`metafab.tolerance.scatter`),
so that a draw costs no more than its PSFs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.arguments import require_types
from metafab.core.errors import InputError
from metafab.core.figures import ToleranceRow, ToleranceTable
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.work import Work
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed
from metafab.library.library import Library
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.propagation.blocks import MOST_BLOCKS, require_memory
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.sources.source import WrittenField
from metafab.spec.design import Tolerances
from metafab.tolerance.corners import CornerField, corner_fields
from metafab.tolerance.mask_light import MaskOptics, PsfConditions
from metafab.tolerance.reference import Reference
from metafab.tolerance.scatter import Fault, Misplaced, Missing, Stitched

KIND = "metafab tolerance"
FORMAT = 1


def tolerance_table(
    written: WrittenField,
    library: Library,
    tolerances: Tolerances,
    conditions: PsfConditions,
    field_sites: int,
    *,
    made: Sequence[CornerField] = (),
    work: Work = Work(workers=1),
) -> ToleranceTable:
    """Compare the PSFs at the corners of a written mask with those of the nominal mask, on the axis.

    Args:
        written: mask with the amplitudes of the library.
        tolerances: deviations of the fabrication; zeros leave corners out.
        conditions: geometry, depths and numerics of every PSF.
        field_sites: sites along a side of a write field.
        made: the mask as processes make it, for the first rows of the table.
        work: processes or cluster that solve cells, and progress over the corners. The result does not depend on them.

    Raises:
        InputError: write fields without a site, slopes of rings or in a hexagonal lattice, inputs for which no PSF
            stack exists (:func:`metafab.optics.psf`), or write fields that for stitching must be divided into more
            blocks than fit into memory.
    """
    require_types(
        "tolerance",
        written=(written, WrittenField),
        library=(library, Library),
        tolerances=(tolerances, Tolerances),
        conditions=(conditions, PsfConditions),
    )
    if field_sites < 1:
        remedy = "`min(layout.field_sites(design))` is that of a design"
        raise InputError.single("tolerance", "field_sites", "at least 1 site", f"{field_sites}", remedy)
    cell = library.unit_cell.cell
    if (cell.is_hexagonal or cell.shape == "ring") and tolerances.sidewall_deg > 0.0:
        kind = "a hexagonal lattice" if cell.is_hexagonal else 'cells of the shape "ring"'
        expected, remedy = f"0 for {kind}, whose slopes are not available", "set it in `[tolerance]`"
        raise InputError.single("tolerance", "sidewall_deg", expected, f"{tolerances.sidewall_deg:g}", remedy)
    with one_blas_thread():
        optics, pupils, error = MaskOptics.of(written, conditions, work)
        block = pupils[0].carrier.block_sites
        faults = _faults(tolerances, conditions.imaging, written, field_sites)
        require_block_memory(faults, written, block)
        reference = Reference.of(optics, pupils, error)
        with work.processes() as executor:
            corners = [*made]
            corners += corner_fields(
                written, library, _deviations(tolerances), executor=executor, progress=work.progress
            )
        rows = []
        for done, corner in enumerate(corners):
            row = reference.row(corner.name, [optics.light(optics.sums(corner.field))], corner.relative_error)
            rows.append(replace(row, solved=corner.solved))
            work.progress("tolerance", done + 1, len(corners))
        rows += [_fault_row(fault, reference, optics, pupils, written, tolerances.draws) for fault in faults]
    nominal = reference.row("nominal", [reference.nominal], 0.0)
    return ToleranceTable(np.array(conditions.depths_m), error, block, nominal, tuple(rows))


def _deviations(tolerances: Tolerances) -> dict[str, float]:
    """Deviation of each axis of the cell that has one."""
    by_axis = {
        "cd_bias_nm": tolerances.cd_bias_nm,
        "height_nm": tolerances.height_nm,
        "sidewall_angle_deg": tolerances.sidewall_deg,
        "pillar_n_shift": tolerances.pillar_n,
    }
    return {axis: deviation for axis, deviation in by_axis.items() if deviation > 0.0}


def _faults(tolerances: Tolerances, imaging: Imaging, written: WrittenField, field_sites: int) -> list[Fault]:
    faults: list[Fault] = []
    if tolerances.misplacement_nm > 0.0:
        faults.append(Misplaced(imaging, tolerances.misplacement_nm))
    # Nothing is stitched where one field holds the whole lens.
    if tolerances.stitching_nm > 0.0 and max(written.lattice.shape) > field_sites:
        faults.append(Stitched(imaging, tolerances.stitching_nm, field_sites, written.lattice))
    if tolerances.missing_share > 0.0:
        faults.append(Missing(tolerances.missing_share))
    return faults


def require_block_memory(
    faults: Sequence[Fault], written: WrittenField, block_sites: int, most_blocks: int = MOST_BLOCKS
) -> None:
    """Refuse write fields that must be divided into more blocks than fit into memory, before any corner is solved.

    A block of a random fault divides the write field; ``block_sites`` are those along a side of a block without faults.
    InputError if the smaller blocks do not fit into memory.
    """
    for fault in faults:
        block = fault.block_sites(block_sites)
        if block < block_sites:
            require_memory(
                written,
                block,
                "mask.write_field_um",
                f"write fields of another number of sites, best a multiple of {block_sites},",
                "change the write field by a few sites, or leave stitching out: `tolerance.stitching_nm` = 0",
                most_blocks,
            )


def _fault_row(
    fault: Fault, reference: Reference, optics: MaskOptics, pupils: Sequence[Pupil], written: WrittenField, draws: int
) -> ToleranceRow:
    """The row of a random fault, over ``draws`` masks; the relative error of an rms over n draws is 1 / sqrt(2 n)."""
    block = fault.block_sites(pupils[0].carrier.block_sites)
    if block != pupils[0].carrier.block_sites:
        optics = optics.with_blocks(block)
        pupils = optics.sums(written)
        reference = replace(reference, nominal=optics.light(pupils))
    lights = [optics.light(fault(pupils, np.random.default_rng((draw, 1)))) for draw in range(draws)]
    return replace(reference.row(fault.name, lights, float(1.0 / np.sqrt(2.0 * draws))), draws=draws)


def save_tolerance(table: ToleranceTable, path: Path, *, mask_sha256: str) -> None:
    """Write the table with the hash of its mask; NaN becomes null."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, "mask_sha256": mask_sha256, **vars(table)})


def load_tolerance(path: Path) -> tuple[ToleranceTable, str] | None:
    """Return the table and the hash of its mask; None if the file is missing, damaged or of another kind."""
    return read_json(path, KIND, FORMAT, _table)


def _table(content: dict[str, Any]) -> tuple[ToleranceTable, str]:
    return typed(ToleranceTable, content), str(content["mask_sha256"])
