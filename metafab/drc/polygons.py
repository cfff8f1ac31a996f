"""Design rules by KLayout's geometry engine, which knows nothing of lattices: the independent second opinion.

The only file of metafab that imports klayout (GPL, an optional extra).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.core.executor import default_workers
from metafab.core.progress import Progress, silent
from metafab.drc.report import MARKERS, DrcReport, Marker, upright_side_nm
from metafab.mask.read import format_of
from metafab.spec import Design

#: Side of the engine's tiles. Its scan lines cost more the longer they are: 50 um take two thirds of the time of 170.
_TILE_UM = 60.0

# What is computed in each tile; `raw` are shapes as drawn: overlaps stay visible to `merged`, and gaps need not be
# looked for on merged shapes, which would double the time. Nothing is cut at the tile's edge: what two tiles see at
# their seam is then equal, and counted once.
_SCRIPT = """
var raw = pillars;
raw.merged_semantics = false;
_output(foreign, raw.non_rectangles, false);
_output(overlap, raw.merged(false, 2), false);
_output(narrow, raw.width_check(feature_dbu), false);
_output(gaps, raw.isolated_check(gap_dbu), false);
"""
_GRID = "_output(grid, raw.grid_check(grid_dbu, grid_dbu), false);"
_SLENDER = "_output(slender, raw.width_check(upright_dbu), false);"


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
    layout = kdb.Layout(False)  # not to be edited: arrays stay arrays, in half the memory
    try:
        layout.read(str(path))
    except RuntimeError as error:
        raise InputError.single(
            str(path), "file", "a whole GDSII or OASIS file", str(error), "write it again"
        ) from error
    tops = layout.top_cells()
    if len(tops) != 1:
        raise InputError.single(str(path), "cells", "one top cell", str(len(tops)), "write the mask again")
    first, last = design.mask.datatypes
    layers = [layout.layer(kdb.LayerInfo(design.mask.layer, datatype)) for datatype in range(first, last + 1)]
    # Within a box, the members of arrays are counted one by one, and not each array as one.
    everything = tops[0].bbox().enlarged(1, 1)
    pillars = kdb.RecursiveShapeIterator(layout, tops[0], layers, everything, True)
    found = _run(kdb, layout, pillars, design, workers or default_workers(), progress)
    counts = {rule: len(boxes) for rule, boxes in found.items()}
    unit_nm = layout.dbu * 1e3
    return DrcReport(
        file=path.name,
        engine="polygons",
        pillars=kdb.Region(pillars).count(),
        violations=counts,
        markers={
            rule: tuple(Marker(*(side * unit_nm for side in box)) for box in sorted(boxes)[:MARKERS])
            for rule, boxes in found.items()
            if boxes
        },
    )


def _run(
    kdb: Any, layout: Any, pillars: Any, design: Design, workers: int, progress: Progress
) -> dict[str, set[tuple[int, int, int, int]]]:
    """Boxes of the violations of each rule; sets, because neighbouring tiles see those on their seam twice."""
    unit_nm = layout.dbu * 1e3
    upright_nm = upright_side_nm(design)
    limits = {"gap": design.rules.min_gap_nm, "feature": design.rules.min_feature_nm, "upright": upright_nm or 0.0}
    found: dict[str, set[tuple[int, int, int, int]]] = {
        rule: set() for rule in ("min_width", "min_length", "min_gap", "overlap", "grid", "foreign")
    }
    if upright_nm is not None:
        found["aspect_ratio"] = set()
    box = kdb.Region(pillars).bbox().to_dtype(layout.dbu)
    columns, rows = (max(1, math.ceil(length / _TILE_UM)) for length in (box.width(), box.height()))
    grid = max(1, round(design.mask.database_unit_nm / unit_nm))
    # Whole numbers of units are on a grid of one unit, whatever they are.
    script = _SCRIPT + (_GRID if grid > 1 else "") + (_SLENDER if upright_nm is not None else "")
    for row in range(rows):
        outputs = {name: kdb.Region() for name in ("foreign", "overlap")}
        outputs |= {name: kdb.EdgePairs() for name in ("grid", "narrow", "slender", "gaps")}
        processor = kdb.TilingProcessor()
        processor.tile_size(_TILE_UM, _TILE_UM)
        processor.tile_origin(box.left, box.bottom + row * _TILE_UM)
        processor.tiles(columns, 1)
        processor.tile_border(2e-3 * max(limits.values()), 2e-3 * max(limits.values()))
        processor.threads = workers
        processor.input("pillars", pillars)
        for name, limit_nm in limits.items():
            processor.var(f"{name}_dbu", max(1, round(limit_nm / unit_nm)))
        processor.var("grid_dbu", grid)
        for name, collection in outputs.items():
            processor.output(name, collection)
        processor.queue(script)
        processor.execute("design rules")
        for pair in outputs["narrow"].each():
            found["min_width" if pair.first.dx() == 0 else "min_length"].add(_box(pair.bbox()))
        if upright_nm is not None:
            found["aspect_ratio"] |= {_box(pair.bbox()) for pair in outputs["slender"].each()}
        found["min_gap"] |= {_box(pair.bbox()) for pair in outputs["gaps"].each()}
        found["grid"] |= {_box(pair.bbox()) for pair in outputs["grid"].each()}
        found["overlap"] |= {_box(polygon.bbox()) for polygon in outputs["overlap"].each()}
        found["foreign"] |= {_box(polygon.bbox()) for polygon in outputs["foreign"].each()}
        progress("design rules", row + 1, rows)
    return found


def _box(box: Any) -> tuple[int, int, int, int]:
    return box.left, box.bottom, box.width(), box.height()
