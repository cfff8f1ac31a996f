"""Design rules by KLayout's geometry engine, which uses no lattice: an independent check.

The only file of metafab that imports klayout (GPL, an optional extra).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from metafab.core.errors import InputError, MissingToolError
from metafab.core.parallel.executor import SerialExecutor, default_workers, in_order, open_executor
from metafab.core.parallel.work import Work
from metafab.drc.report import MARKERS, DrcReport, Findings
from metafab.drc.rules import RULES, SLACK_DBU, require_one_top, require_shapes, rules_in, upright_side_nm
from metafab.layout import Outline
from metafab.mask import read_shapes
from metafab.mask.read import Shapes
from metafab.mask.shapes.recover import KnownShapes
from metafab.spec import Design

#: Side of KLayout's tiles. Its scan lines cost more the longer they are: 50 um take two thirds of the time of 170.
TILE_UM = 60.0

# Script for each tile. `raw` are the shapes as drawn: `merged` still sees their overlaps, and gaps are not searched on
# merged shapes, which would double the time. Nothing is cut at the edge of a tile, so that two tiles see equal
# violations at their seam, which are counted once.
_SCRIPT = """
var raw = pillars;
raw.merged_semantics = false;
_output(overlap, raw.merged(false, 2), false);
_output(narrow, {walls}.width_check(feature_dbu{facing}), false);
_output(gaps, raw.isolated_check(gap_dbu), false);
"""
_FOREIGN = "_output(foreign, raw.non_rectangles, false);"
_GRID = "_output(grid, raw.grid_check(grid_dbu, grid_dbu), false);"
_SLENDER = "_output(slender, {walls}.width_check(upright_dbu{facing}), false);"
# Merged, a ring has a hole in place of the slit that joins its outer side to it.
_HOLES = "_output(holes, raw.merged.notch_check(gap_dbu{facing}), false);"

_VISIBLE = {"min_width", "min_length", "aspect_ratio", "min_gap", "overlap", "grid", "foreign"}

# x, y, width, height in units of the file, by rule.
_Boxes: TypeAlias = dict[str, set[tuple[int, int, int, int]]]


def check_polygons(path: Path, design: Design, work: Work = Work(), tile_um: float = TILE_UM) -> DrcReport:
    """Check width, length, gap, overlap, grid and foreign shapes by KLayout, tile by tile on all cores.

    Shapes are counted by metafab's own reader as well: KLayout's drops all but one of the equal places of an OASIS
    repetition, and the difference is reported as ``duplicate``. If pillars are not rectangles, that reader determines
    the ``foreign`` shapes. Gaps of rectangles are counted by pairs of pillars, gaps of other outlines by pairs of
    sides.

    The workers of a cluster take rows of tiles, each on one thread and with the file read once.

    Raises:
        MissingToolError: KLayout is not installed.
        InputError: the file cannot be read, has several top cells, or nothing on the pillar layer.
    """
    shapes = read_shapes(path, design, known=KnownShapes(Outline.of(design)))
    require_one_top(path, shapes.top_cells)
    require_shapes(path, design, shapes.count)
    threads = 1 if work.cluster else work.workers or default_workers()
    rules = _RowRules(path.resolve(), design, shapes.datatypes, threads, tile_um)
    opened = rules.opened
    violations: _Boxes = {rule: set() for rule in rules.checked}
    with SerialExecutor() if work.cluster is None else open_executor(None, work.cluster, work.progress) as executor:
        for done, boxes in enumerate(in_order(executor, rules, range(opened.rows), ahead=1), start=1):
            # Sets, because neighbouring tiles both see a violation on their seam.
            for rule, places in violations.items():
                places.update(boxes[rule])
            work.progress("design rules", done, opened.rows)
    findings = Findings({"duplicate", "foreign"} | violations.keys())
    findings.counts["duplicate"] += max(0, shapes.count - opened.count)
    findings.counts["foreign"] += _invisible_foreign(shapes, design, opened)
    for rule, places in violations.items():
        findings.add(rule, np.array(sorted(places)[:MARKERS], dtype=np.int64).reshape(-1, 4), len(places))
    return DrcReport(
        file=path.name,
        engine="polygons",
        pillars=shapes.count,
        violations={rule: findings.counts[rule] for rule in RULES if rule in findings.counts},
        markers={rule: places for rule, places in findings.markers(opened.unit_nm).items() if places},
        other_layers=shapes.other_layers,
    )


def _invisible_foreign(shapes: Shapes, design: Design, opened: _Opened) -> int:
    """Number of foreign shapes that a region does not show: paths without width; all, if pillars are not rectangles."""
    if Outline.of(design).is_rectangle:
        return opened.lines
    return sum(other.count for chunk in shapes.chunks() for other in chunk.others)


@dataclass(frozen=True)
class _Opened:
    """A file that KLayout has read."""

    layout: Any  #: KLayout's layout; must outlive ``pillars``.
    pillars: Any  #: Shapes on the pillar layer.
    left_um: float  #: Left edge of their bounding box.
    bottom_um: float  #: Lower edge of their bounding box.
    columns: int  #: Tiles along x that cover the box.
    rows: int  #: Tiles along y that cover the box.
    unit_nm: float  #: Database unit.

    @property
    def count(self) -> int:
        """Number of shapes, members of arrays one by one."""
        return int(_klayout().Region(self.pillars).count())

    @property
    def lines(self) -> int:
        """Number of paths without width, as which some software writes edges."""
        paths = self.pillars.dup()
        paths.shape_flags = _klayout().Shapes.SPaths
        return sum(at.shape().path_width == 0 for at in paths.each())


def _klayout() -> Any:
    try:
        import klayout.db as kdb
    except ImportError as error:
        raise MissingToolError("`--engine polygons` needs KLayout: pip install 'metafab[drc]'") from error
    return kdb


def _open(path: Path, layer: int, datatypes: tuple[int, int], tile_um: float) -> _Opened:
    kdb = _klayout()
    layout = kdb.Layout(False)  # Not editable: arrays stay arrays, in half the memory.
    try:
        layout.read(str(path))
    except RuntimeError as error:
        expected = "a whole GDSII or OASIS file"
        raise InputError.single(str(path), "file", expected, str(error), "write it again") from error
    tops = layout.top_cells()
    first, last = datatypes
    layers = [layout.layer(kdb.LayerInfo(layer, datatype)) for datatype in range(first, last + 1)]
    # With a box, the members of arrays are counted one by one.
    everything = tops[0].bbox().enlarged(1, 1)
    pillars = kdb.RecursiveShapeIterator(layout, tops[0], layers, everything, True)
    pillars.shape_flags = kdb.Shapes.SRegions  # Without texts.
    box = kdb.Region(pillars).bbox().to_dtype(layout.dbu)
    columns, rows = max(1, math.ceil(box.width() / tile_um)), max(1, math.ceil(box.height() / tile_um))
    return _Opened(layout, pillars, box.left, box.bottom, columns, rows, layout.dbu * 1e3)


@dataclass(frozen=True)
class _RowRules:
    """The rules on one row of tiles; reads the file when it is first called in a process."""

    path: Path  #: The file.
    design: Design  #: Rules, layer, unit.
    datatypes: tuple[int, int]  #: First and last datatype of the pillars.
    threads: int  #: Threads of KLayout.
    tile_um: float  #: Side of the tiles.

    @cached_property
    def opened(self) -> _Opened:
        """The file, read once."""
        return _open(self.path, self.design.mask.layer, self.datatypes, self.tile_um)

    @property
    def checked(self) -> list[str]:
        """The rules that are checked."""
        rules = rules_in(self.design, _VISIBLE)
        return rules if Outline.of(self.design).is_rectangle else [rule for rule in rules if rule != "foreign"]

    def __getstate__(self) -> dict[str, Any]:
        """Attributes that travel to another process, which reads the file itself."""
        return {name: value for name, value in vars(self).items() if name != "opened"}

    def __call__(self, row: int) -> _Boxes:
        """Boxes of the violations of each rule in a row of tiles."""
        kdb, opened = _klayout(), self.opened
        unit_nm, upright_nm = opened.unit_nm, upright_side_nm(self.design)
        rules = self.design.rules
        # Two sides of a polygon are each within the tolerance of the curve; those at the axes are exact.
        slack_nm = 2.0 * Outline.of(self.design).tolerance_nm
        limits = {
            "gap": rules.min_gap_nm - slack_nm,
            "feature": rules.min_feature_nm - slack_nm,
            "upright": max(0.0, (upright_nm or 0.0) - slack_nm),
        }
        # An edge at n file units lies on the design's grid if n is a multiple of the denominator of this fraction.
        grid = Fraction(unit_nm / self.design.mask.database_unit_nm).limit_denominator(1_000_000).denominator
        outputs = {name: kdb.Region() for name in ("foreign", "overlap")}
        outputs |= {name: kdb.EdgePairs() for name in ("grid", "narrow", "slender", "gaps", "holes")}
        processor = kdb.TilingProcessor()
        processor.tile_size(self.tile_um, self.tile_um)
        processor.tile_origin(opened.left_um, opened.bottom_um + row * self.tile_um)
        processor.tiles(opened.columns, 1)
        processor.tile_border(2e-3 * max(limits.values()), 2e-3 * max(limits.values()))
        processor.threads = self.threads
        processor.input("pillars", opened.pillars)
        for name, limit_nm in limits.items():
            # Distances are whole units, so that the limit can be rounded up.
            processor.var(f"{name}_dbu", max(1, math.ceil(limit_nm / unit_nm - SLACK_DBU)))
        processor.var("grid_dbu", grid)
        for name, collection in outputs.items():
            processor.output(name, collection)
        # Every edge is on a grid of one unit.
        scripts = {"grid": _GRID if grid > 1 else "", "foreign": _FOREIGN, "aspect_ratio": _SLENDER}
        # A polygon narrows towards its tips: its width is measured between parallel sides that face each other.
        outline = Outline.of(self.design)
        facing = "" if outline.is_rectangle else ", false, Metrics.Projection, 0.01"
        script = _SCRIPT + "".join(script for rule, script in scripts.items() if rule in self.checked)
        script, walls = (script + _HOLES, "raw.merged") if outline.shape == "ring" else (script, "raw")
        processor.queue(script.format(facing=facing, walls=walls))
        processor.execute("design rules")
        boxes: _Boxes = {rule: set() for rule in self.checked}
        for pair in outputs["narrow"].each():
            boxes["min_width" if pair.first.dx() == 0 else "min_length"].add(_box(pair.bbox()))
        pairs = {"grid": "grid", "aspect_ratio": "slender"}
        for rule, name in pairs.items():
            if rule in boxes:
                boxes[rule] |= {_box(pair.bbox()) for pair in outputs[name].each()}
        for rule in boxes.keys() & {"overlap", "foreign"}:
            boxes[rule] |= {_box(polygon.bbox()) for polygon in outputs[rule].each()}
        for pair in outputs["gaps"].each():
            between = _between(pair.first.bbox(), pair.second.bbox())
            boxes["min_gap"].add(between)
            if pair.distance() == 0:  # They touch, but have no area in common, which `merged` would show.
                boxes["overlap"].add(between)
        boxes["min_gap"] |= {_between(pair.first.bbox(), pair.second.bbox()) for pair in outputs["holes"].each()}
        return boxes


def _between(one: Any, other: Any) -> tuple[int, int, int, int]:
    """Box between two edges; equal for both edge pairs of two corners, so that a pair of rectangles counts once."""
    left, right = sorted((max(one.left, other.left), min(one.right, other.right)))
    bottom, top = sorted((max(one.bottom, other.bottom), min(one.top, other.top)))
    return left, bottom, right - left, top - bottom


def _box(box: Any) -> tuple[int, int, int, int]:
    return box.left, box.bottom, box.width(), box.height()
