"""Design rules by KLayout's geometry engine, which knows nothing of lattices: the independent second opinion.

The only file of metafab that imports klayout (GPL, an optional extra).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.core.executor import default_workers
from metafab.core.progress import Progress, silent
from metafab.drc.report import MARKERS, DrcReport, Marker
from metafab.layout import lattice_of, tile_sites
from metafab.mask.read import format_of
from metafab.spec import Design

# What is computed in each tile; `pillars` are raw shapes, so that overlaps stay visible to `merged`.
_SCRIPT = """
var raw = pillars;
raw.merged_semantics = false;
_output(foreign, raw.non_rectangles, true);
_output(overlap, raw.merged(false, 2), true);
_output(grid, raw.grid_check(grid_dbu, grid_dbu), true);
_output(narrow, raw.width_check(feature_dbu), true);
_output(gaps, pillars.isolated_check(gap_dbu), true);
"""


def check_polygons(path: Path, design: Design, workers: int | None = None, progress: Progress = silent) -> DrcReport:
    """Width, length, gap, overlap, grid and foreign shapes by KLayout, tile by tile on all cores.

    Args:
        path: GDSII or OASIS file.
        design: rules, layer, unit.
        workers: threads; the cores unless given.
        progress: told about tiles.

    Raises:
        MissingToolError: KLayout is not installed.
        InputError: the file cannot be read.
    """
    try:
        import klayout.db as kdb
    except ImportError as error:
        raise MissingToolError("`--engine polygons` needs KLayout: pip install 'metafab[drc]'") from error
    format_of(path)
    layout = kdb.Layout()
    layer = kdb.LayerInfo(design.mask.layer, design.mask.datatype)
    try:
        layout.read(str(path))
    except RuntimeError as error:
        raise InputError.single(
            str(path), "file", "a whole GDSII or OASIS file", str(error), "write it again"
        ) from error
    tops = layout.top_cells()
    if len(tops) != 1:
        raise InputError.single(str(path), "cells", "one top cell", str(len(tops)), "write the mask again")
    found = _run(kdb, layout, tops[0], layout.layer(layer), design, workers or default_workers(), progress)
    counts = {rule: len(boxes) for rule, boxes in found.items()}
    unit_nm = layout.dbu * 1e3
    return DrcReport(
        file=path.name,
        engine="polygons",
        pillars=kdb.Region(tops[0].begin_shapes_rec(layout.layer(layer))).count(),
        violations=counts,
        markers={
            rule: tuple(Marker(*(side * unit_nm for side in box)) for box in sorted(boxes)[:MARKERS])
            for rule, boxes in found.items()
            if boxes
        },
    )


def _run(
    kdb: Any, layout: Any, top: Any, layer: int, design: Design, workers: int, progress: Progress
) -> dict[str, set[tuple[int, int, int, int]]]:
    """Boxes of the violations of each rule; sets, because neighbouring tiles see those on their seam twice."""
    unit_nm = layout.dbu * 1e3
    limits = {"gap": design.rules.min_gap_nm, "feature": design.rules.min_feature_nm}
    outputs = {
        "foreign": kdb.Region(),
        "overlap": kdb.Region(),
        "grid": kdb.EdgePairs(),
        "narrow": kdb.EdgePairs(),
        "gaps": kdb.EdgePairs(),
    }
    period = lattice_of(design).period_dbu[0] * design.mask.database_unit_nm / unit_nm
    side_um = tile_sites(design) * period * layout.dbu
    processor = kdb.TilingProcessor()
    processor.tile_size(side_um, side_um)
    processor.tile_border(2e-3 * max(limits.values()), 2e-3 * max(limits.values()))
    processor.threads = workers
    processor.input("pillars", layout, top.cell_index(), layer)
    for name, limit_nm in limits.items():
        processor.var(f"{name}_dbu", round(limit_nm / unit_nm))
    processor.var("grid_dbu", max(1, round(design.mask.database_unit_nm / unit_nm)))
    for name, collection in outputs.items():
        processor.output(name, collection)
    processor.queue(_SCRIPT)
    processor.execute("design rules")
    width: set[tuple[int, int, int, int]] = set()
    length: set[tuple[int, int, int, int]] = set()
    for pair in outputs["narrow"].each():
        (width if pair.first.dx() == 0 else length).add(_box(pair.bbox()))
    return {
        "min_width": width,
        "min_length": length,
        "min_gap": {_box(pair.bbox()) for pair in outputs["gaps"].each()},
        "overlap": {_box(polygon.bbox()) for polygon in outputs["overlap"].each()},
        "grid": {_box(pair.bbox()) for pair in outputs["grid"].each()},
        "foreign": {_box(polygon.bbox()) for polygon in outputs["foreign"].each()},
    }


def _box(box: Any) -> tuple[int, int, int, int]:
    return box.left, box.bottom, box.width(), box.height()
