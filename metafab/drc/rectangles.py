"""Design rules on the rectangles of a file, of any lattice; near pairs are found by :mod:`metafab.drc.rows`."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import numpy as np

from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.drc.report import DrcReport, Findings, spanning_boxes
from metafab.drc.rows import Near, Rows
from metafab.drc.rules import Limits, require_one_top, require_shapes, rules_in
from metafab.layout import Outline
from metafab.mask import read_shapes
from metafab.mask.read import Shapes
from metafab.mask.shapes.hierarchy import Chunk, IntArray
from metafab.spec import Design

# Rules of pairs, each for some of the pairs of the one before: too near, overlapping or touching, equal.
_PAIR_RULES = ("min_gap", "overlap", "duplicate")
_VISIBLE = {"min_width", "min_length", "aspect_ratio", "grid", "foreign", *_PAIR_RULES}


def check_rectangles(path: Path, design: Design, work: Work = Work()) -> DrcReport:
    """Check width, length, aspect ratio, gap (diagonals included), overlap, duplicates, grid and foreign shapes.

    Of the design's lattice only the period counts, as the scale of the search. InputError if the file cannot be read,
    has several top cells or nothing on the pillar layer; the design's pillars are not rectangles; or a cluster is asked
    for.
    """
    if work.cluster is not None:
        expected, remedy = "'lattice' or 'polygons' with a cluster", "it runs on one machine: leave the cluster out"
        raise InputError.single("drc", "engine", expected, "'rectangles'", remedy)
    if not Outline.of(design).is_rectangle:
        expected = "'lattice' or 'polygons' for pillars of another shape"
        raise InputError.single("drc", "engine", expected, "'rectangles'", "it takes only rectangles")
    shapes = read_shapes(path, design, work.progress)
    require_one_top(path, shapes.top_cells)
    require_shapes(path, design, shapes.count)
    findings = Findings(rules_in(design, _VISIBLE))
    total, smallest = _check_shapes(shapes, design, work, findings)
    return DrcReport(
        file=path.name,
        engine="rectangles",
        pillars=total,
        violations=findings.counts,
        markers=findings.markers(shapes.unit_nm),
        min_gap_nm=None if smallest is None else smallest * shapes.unit_nm,
        other_layers=shapes.other_layers,
    )


def _check_shapes(shapes: Shapes, design: Design, work: Work, findings: Findings) -> tuple[int, float | None]:
    """Add the violations; return the number of rectangles and the smallest distance, if it is at or below the rule."""
    limits = Limits.of(design, shapes.unit_nm)
    row_height = int(max(design.unit_cell.cell.period_nm) / shapes.unit_nm + limits.gap) + 2
    # Sides below this fit into a row together with the gap, and into 16 bits.
    small_side = min(row_height - limits.gap, 2**16)
    grid = Fraction(shapes.unit_nm / design.mask.database_unit_nm).limit_denominator(1_000_000)
    with work.threads() as threads:
        rows, total, large = Rows(row_height, limits.gap, threads), 0, [np.empty((0, 4), dtype=np.int64)]
        for chunk in shapes.chunks():
            small, others = _divided(chunk, small_side)
            rows.count(small, chunk.shift)
            large.append(others)
            total += len(chunk.rectangles)
            for other in chunk.others:
                findings.add("foreign", other.boxes, other.count)
        pairs, done = _Pairs(findings, np.concatenate(large), limits.gap), 0
        for chunk in shapes.chunks():
            _check_each(chunk, limits, grid, findings)
            small, _ = _divided(chunk, small_side)
            pairs.add_large(small, chunk.shift)
            for near in rows.place(small, chunk.shift):
                pairs.add(near)
            done += len(chunk.rectangles)
            work.progress("rules", done, total)
        for near in rows.finish():
            pairs.add(near)
    smallest = float(np.sign(pairs.smallest_square) * np.sqrt(abs(pairs.smallest_square)))
    # Pairs beyond the rule are not searched: one of them may be nearer than the nearest that was compared.
    return total, smallest if smallest <= math.ceil(limits.gap) else None


def _divided(chunk: Chunk, small_side: float) -> tuple[IntArray, IntArray]:
    """Rectangles that the rows take, not yet moved, and larger ones such as a frame, moved; shape (n, 4) each."""
    boxes = chunk.rectangles
    if boxes[:, 2:].max(initial=0) < small_side:
        return boxes, np.empty((0, 4), dtype=np.int64)  # Not a view, which would keep all boxes in memory.
    small = np.all(boxes[:, 2:] < small_side, axis=1)
    return boxes[small], _moved(boxes[~small], chunk.shift)


class _Pairs:
    """Violations of pairs. Rectangles too large for the rows are few, and compared with all others.

    Args:
        findings: where violations are added.
        large: shape (n, 4).
        gap: smallest distance.

    Attributes:
        smallest_square: smallest signed square of a distance; infinite without a pair.
    """

    def __init__(self, findings: Findings, large: IntArray, gap: float) -> None:
        self._findings, self._large, self._gap = findings, large, gap
        self.smallest_square = np.inf
        for index in range(len(large)):
            self._compare(large[index], large[index + 1 :])

    def add(self, near: Near) -> None:
        """Count pairs and keep the boxes of the first of them."""
        self.smallest_square = min(self.smallest_square, near.smallest_square)
        for level, rule in enumerate(_PAIR_RULES):
            if near.counts[level]:
                kept = near.kind >= level
                boxes = spanning_boxes(near.one[kept], near.other[kept])
                self._findings.add(rule, boxes, int(near.counts[level]))

    def add_large(self, boxes: IntArray, shift: IntArray) -> None:
        """Compare boxes, shape (n, 4), moved by ``shift``, with those that are too large for the rows."""
        for box in self._large:
            self._compare(box, _moved(boxes, shift))

    def _compare(self, box: IntArray, others: IntArray) -> None:
        gap = np.maximum(others[:, :2] - box[:2] - box[2:], box[:2] - others[:, :2] - others[:, 2:])
        depth = gap.max(axis=1)
        square = np.where(depth < 0, -(depth**2), np.sum(np.maximum(gap, 0) ** 2, axis=1)).astype(np.float64)
        near = np.flatnonzero(square < self._gap**2)
        kind = np.where(square[near] > 0, 0, np.where(np.all(others[near] == box, axis=1), 2, 1))
        counts = np.array([np.count_nonzero(kind >= level) for level in range(3)])
        one = np.broadcast_to(box, (near.size, 4))
        self.add(Near(float(square.min(initial=np.inf)), counts, one, others[near], kind))


def _moved(boxes: IntArray, shift: IntArray) -> IntArray:
    return np.asarray(boxes + np.append(shift, [0, 0]))


def _check_each(chunk: Chunk, limits: Limits, grid: Fraction, findings: Findings) -> None:
    """Check the rules of single rectangles; edges times ``grid`` must be whole numbers."""
    boxes = chunk.rectangles
    smallest = boxes[:, 2:].min(axis=0, initial=2**62)
    for rule, column in (("min_width", 0), ("min_length", 1)):
        if smallest[column] < limits.side:
            findings.add(rule, _moved(boxes[boxes[:, 2 + column] < limits.side], chunk.shift))
    if limits.upright is not None and smallest.min() < limits.upright:
        findings.add("aspect_ratio", _moved(boxes[boxes[:, 2:].min(axis=1) < limits.upright], chunk.shift))
    if grid.denominator > 1:
        moved = _moved(boxes, chunk.shift)
        findings.add("grid", moved[np.any(moved * grid.numerator % grid.denominator != 0, axis=1)])
