"""Design rules by KLayout's geometry engine, which knows nothing of lattices: the independent second opinion.

The only file of metafab that imports klayout (GPL, an optional extra).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

from metafab.core.errors import InputError, MissingToolError
from metafab.core.parallel.executor import SerialExecutor, default_workers, in_order, open_executor
from metafab.core.parallel.progress import Progress, silent
from metafab.drc.report import MARKERS, DrcReport, Marker, refuse_empty, refuse_several_tops, upright_side_nm
from metafab.layout import Outline
from metafab.mask import read_shapes
from metafab.mask.read import Shapes
from metafab.mask.shapes.known import KnownShapes
from metafab.spec import Design

#: Side of the engine's tiles. Its scan lines cost more the longer they are: 50 um take two thirds of the time of 170.
_TILE_UM = 60.0

# What is computed in each tile; `raw` are shapes as drawn: overlaps stay visible to `merged`, and gaps need not be
# looked for on merged shapes, which would double the time. Nothing is cut at the tile's edge: what two tiles see at
# their seam is then equal, and counted once.
_SCRIPT = """
var raw = pillars;
raw.merged_semantics = false;
_output(overlap, raw.merged(false, 2), false);
_output(narrow, raw.width_check(feature_dbu{facing}), false);
_output(gaps, raw.isolated_check(gap_dbu), false);
"""
_FOREIGN = "_output(foreign, raw.non_rectangles, false);"
_GRID = "_output(grid, raw.grid_check(grid_dbu, grid_dbu), false);"
_SLENDER = "_output(slender, raw.width_check(upright_dbu{facing}), false);"

# A millionth of a unit is no violation.
_SLACK_DBU = 1e-6

_Boxes: TypeAlias = dict[str, set[tuple[int, int, int, int]]]


def check_polygons(
    path: Path,
    design: Design,
    workers: int | None = None,
    progress: Progress = silent,
    cluster: str | None = None,
) -> DrcReport:
    """Width, length, gap, overlap, grid and foreign shapes by KLayout, tile by tile on all cores.

    Shapes are counted by metafab's own reader, too: KLayout's drops all but one of the equal places of an OASIS
    repetition, and what it holds fewer is reported as ``duplicate``. Of pillars that are no rectangles, that reader
    tells which shapes are ``foreign``. Gaps are counted by pairs of rectangles; of other outlines, by pairs of sides.

    Args:
        path: GDSII or OASIS file.
        design: rules, layer, unit.
        workers: threads; the cores unless given.
        progress: told about rows of tiles.
        cluster: address of a Dask scheduler whose workers take the rows, each on one thread. A worker reads the file
            for itself, once.

    Raises:
        MissingToolError: KLayout is not installed.
        InputError: the file cannot be read, has several top cells, or nothing on the pillars' layer.
    """
    own = read_shapes(path, design, known=KnownShapes(Outline.of(design)))
    refuse_several_tops(path, own.top_cells)
    refuse_empty(path, design, own.count)
    rules = _RowRules(path.resolve(), design, 1 if cluster else workers or default_workers())
    opened = rules.opened
    found: _Boxes = {rule: set() for rule in rules.seen}
    with SerialExecutor() if cluster is None else open_executor(cluster=cluster) as executor:
        for done, boxes in enumerate(in_order(executor, rules, range(opened.rows), ahead=1), start=1):
            # Sets, because neighbouring tiles see violations on their seam twice.
            for rule, seen in found.items():
                seen.update(boxes[rule])
            progress("design rules", done, opened.rows)
    unit_nm = opened.unit_nm
    unseen = {"duplicate": max(0, own.count - opened.count), "foreign": _foreign(own, design, opened)}
    return DrcReport(
        file=path.name,
        engine="polygons",
        pillars=own.count,
        violations=unseen | {rule: len(boxes) + unseen.get(rule, 0) for rule, boxes in found.items()},
        markers={
            rule: tuple(Marker(*(side * unit_nm for side in box)) for box in sorted(boxes)[:MARKERS])
            for rule, boxes in found.items()
            if boxes
        },
        other_layers=own.other_layers,
    )


def _foreign(own: Shapes, design: Design, opened: _Opened) -> int:
    """Foreign shapes that no region shows: paths without width; unless pillars are rectangles, all of them."""
    if Outline.of(design).is_rectangle:
        return opened.lines
    return sum(other.count for chunk in own.chunks() for other in chunk.others)


@dataclass(frozen=True)
class _Opened:
    """A file that KLayout has read.

    Attributes:
        layout: KLayout's layout; must outlive ``pillars``.
        pillars: what is drawn on the pillars' layer.
        left_um: of the box around them; likewise ``bottom_um``.
        columns: tiles that cover the box; likewise ``rows``.
        unit_nm: database unit.
    """

    layout: Any
    pillars: Any
    left_um: float
    bottom_um: float
    columns: int
    rows: int
    unit_nm: float

    @property
    def count(self) -> int:
        """Shapes, members of arrays one by one."""
        return int(_klayout().Region(self.pillars).count())

    @property
    def lines(self) -> int:
        """Paths without width: edges, in software that knows these."""
        paths = self.pillars.dup()
        paths.shape_flags = _klayout().Shapes.SPaths
        return sum(at.shape().path_width == 0 for at in paths.each())


def _klayout() -> Any:
    try:
        import klayout.db as kdb
    except ImportError as error:
        raise MissingToolError("`--engine polygons` needs KLayout: pip install 'metafab[drc]'") from error
    return kdb


def _open(path: Path, design: Design) -> _Opened:
    kdb = _klayout()
    layout = kdb.Layout(False)  # not to be edited: arrays stay arrays, in half the memory
    try:
        layout.read(str(path))
    except RuntimeError as error:
        raise InputError.single(
            str(path), "file", "a whole GDSII or OASIS file", str(error), "write it again"
        ) from error
    tops = layout.top_cells()
    first, last = design.mask.datatypes
    layers = [layout.layer(kdb.LayerInfo(design.mask.layer, datatype)) for datatype in range(first, last + 1)]
    # Within a box, the members of arrays are counted one by one, and not each array as one.
    everything = tops[0].bbox().enlarged(1, 1)
    pillars = kdb.RecursiveShapeIterator(layout, tops[0], layers, everything, True)
    pillars.shape_flags = kdb.Shapes.SRegions  # a text is no pillar
    box = kdb.Region(pillars).bbox().to_dtype(layout.dbu)
    columns, rows = (max(1, math.ceil(length / _TILE_UM)) for length in (box.width(), box.height()))
    return _Opened(layout, pillars, box.left, box.bottom, columns, rows, layout.dbu * 1e3)


@dataclass(frozen=True)
class _RowRules:
    """The rules on one row of tiles; reads the file when it is first called in a process.

    Attributes:
        path: the file.
        design: rules, layer, unit.
        threads: of KLayout.
    """

    path: Path
    design: Design
    threads: int

    @cached_property
    def opened(self) -> _Opened:
        """The file, read."""
        return _open(self.path, self.design)

    @property
    def seen(self) -> list[str]:
        """The rules that are looked at."""
        rules = ["min_width", "min_length", "min_gap", "overlap", "grid"]
        if Outline.of(self.design).is_rectangle:
            rules.append("foreign")
        return rules if upright_side_nm(self.design) is None else [*rules, "aspect_ratio"]

    def __getstate__(self) -> tuple[Path, Design, int]:
        """What travels to another process, which reads the file for itself."""
        return self.path, self.design, self.threads

    def __setstate__(self, state: tuple[Path, Design, int]) -> None:
        for name, value in zip(("path", "design", "threads"), state, strict=True):
            object.__setattr__(self, name, value)

    def __call__(self, row: int) -> _Boxes:
        """Boxes of the violations of each rule in a row of tiles."""
        kdb, opened = _klayout(), self.opened
        unit_nm, upright_nm = opened.unit_nm, upright_side_nm(self.design)
        rules = self.design.rules
        # Across a polygon, its sides are within its tolerance of the curve; those at the axes are where they should be.
        slack_nm = 2.0 * Outline.of(self.design).tolerance_nm
        limits = {
            "gap": rules.min_gap_nm - slack_nm,
            "feature": rules.min_feature_nm - slack_nm,
            "upright": max(0.0, (upright_nm or 0.0) - slack_nm),
        }
        # An edge at n units of the file is a whole number of the design's where n is one of this fraction's lower part.
        grid = Fraction(unit_nm / self.design.mask.database_unit_nm).limit_denominator(1_000_000).denominator
        outputs = {name: kdb.Region() for name in ("foreign", "overlap")}
        outputs |= {name: kdb.EdgePairs() for name in ("grid", "narrow", "slender", "gaps")}
        processor = kdb.TilingProcessor()
        processor.tile_size(_TILE_UM, _TILE_UM)
        processor.tile_origin(opened.left_um, opened.bottom_um + row * _TILE_UM)
        processor.tiles(opened.columns, 1)
        processor.tile_border(2e-3 * max(limits.values()), 2e-3 * max(limits.values()))
        processor.threads = self.threads
        processor.input("pillars", opened.pillars)
        for name, limit_nm in limits.items():
            # Distances are whole units: below a limit between two of them is below the upper one.
            processor.var(f"{name}_dbu", max(1, math.ceil(limit_nm / unit_nm - _SLACK_DBU)))
        processor.var("grid_dbu", grid)
        for name, collection in outputs.items():
            processor.output(name, collection)
        # Whole numbers of units are on a grid of one unit, whatever they are.
        scripts = {"grid": _GRID if grid > 1 else "", "foreign": _FOREIGN, "aspect_ratio": _SLENDER}
        # A polygon narrows towards its tips: only sides that face each other, and are parallel, tell its width.
        facing = "" if Outline.of(self.design).is_rectangle else ", false, Metrics.Projection, 0.01"
        script = _SCRIPT + "".join(script for rule, script in scripts.items() if rule in self.seen)
        processor.queue(script.format(facing=facing))
        processor.execute("design rules")
        found: _Boxes = {rule: set() for rule in self.seen}
        for pair in outputs["narrow"].each():
            found["min_width" if pair.first.dx() == 0 else "min_length"].add(_box(pair.bbox()))
        pairs = {"grid": "grid", "aspect_ratio": "slender"}
        for rule, name in pairs.items():
            if rule in found:
                found[rule] |= {_box(pair.bbox()) for pair in outputs[name].each()}
        for rule in found.keys() & {"overlap", "foreign"}:
            found[rule] |= {_box(polygon.bbox()) for polygon in outputs[rule].each()}
        for pair in outputs["gaps"].each():
            between = _between(pair.first.bbox(), pair.second.bbox())
            found["min_gap"].add(between)
            if pair.distance() == 0:  # they touch: no area is common, as merging shapes would tell
                found["overlap"].add(between)
        return found


def _between(one: Any, other: Any) -> tuple[int, int, int, int]:
    """The box between two edges; one for both edge pairs of two corners, so that a pair of rectangles counts once."""
    left, right = sorted((max(one.left, other.left), min(one.right, other.right)))
    bottom, top = sorted((max(one.bottom, other.bottom), min(one.top, other.top)))
    return left, bottom, right - left, top - bottom


def _box(box: Any) -> tuple[int, int, int, int]:
    return box.left, box.bottom, box.width(), box.height()
