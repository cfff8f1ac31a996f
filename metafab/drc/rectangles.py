"""Design rules on the rectangles of a file, whatever lattice they came from; pairs by :mod:`metafab.drc.rows`."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np

from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.progress import Progress, silent
from metafab.drc.report import MARKERS, DrcReport, Marker, refuse_empty, refuse_several_tops, upright_side_nm
from metafab.drc.rows import Near, Rows
from metafab.layout import Outline
from metafab.mask import read_shapes
from metafab.mask.shapes.hierarchy import Chunk, IntArray, Other
from metafab.spec import Design

# Pairs too near; of these overlapping or touching; of these equal.
_PAIR_RULES = ("min_gap", "overlap", "duplicate")

_SLACK_DBU = 1e-6


@dataclass
class _Found:
    """Violations: counts, and places of the first, in file units."""

    counts: dict[str, int]
    boxes: dict[str, list[IntArray]] = field(default_factory=dict)

    def add(self, rule: str, boxes: IntArray, count: int | None = None) -> None:
        """Count violations of a rule, as many as boxes unless told, and keep the first places."""
        self.counts[rule] += len(boxes) if count is None else count
        self.boxes.setdefault(rule, []).append(boxes[:MARKERS])


def check_rectangles(path: Path, design: Design, workers: int | None = None, progress: Progress = silent) -> DrcReport:
    """Width, length, aspect ratio, gap (diagonals included), overlap, duplicates, grid and foreign shapes.

    Args:
        path: GDSII or OASIS file.
        design: rules, layers, unit; of its lattice only the period, as the scale of the search.
        workers: threads; the cores unless given.
        progress: told about bytes, rectangles and rows.

    Raises:
        InputError: the file cannot be read, has several top cells or nothing on the pillars' layer, or the design's
            pillars are no rectangles.
    """
    outline = Outline.of(design)
    if not outline.is_rectangle:
        expected, remedy = "'lattice' or 'polygons'", "rectangles are all that it knows"
        raise InputError.single(
            "--engine", "engine", f"{expected} for pillars of another shape", "'rectangles'", remedy
        )
    shapes = read_shapes(path, design, progress)
    refuse_several_tops(path, shapes.top_cells)
    refuse_empty(path, design, shapes.count)
    limits = _Limits.of(design, shapes.unit_nm)
    found = _Found(dict.fromkeys(_rules(design), 0))
    with ThreadPoolExecutor(workers or default_workers()) as threads:
        rows, total, large = Rows(limits.row, limits.gap, threads), 0, [np.empty((0, 4), dtype=np.int64)]
        for chunk in shapes.chunks():
            small, others = limits.divide(chunk)
            rows.count(small, chunk.shift)
            large.append(others)
            total += len(chunk.rectangles)
            for other in chunk.others:
                found.add("foreign", _box_of(other), other.count)
        pairs, done = _Pairs(found, np.concatenate(large), limits.gap), 0
        for chunk in shapes.chunks():
            _check_each(chunk, limits, found)
            small, _ = limits.divide(chunk)
            pairs.add_large(small, chunk.shift)
            for near in rows.place(small, chunk.shift):
                pairs.add(near)
            done += len(chunk.rectangles)
            progress("rules", done, total)
        for near in rows.finish():
            pairs.add(near)
    markers = {
        rule: tuple(
            Marker(*(side * shapes.unit_nm for side in box)) for box in np.concatenate(boxes)[:MARKERS].tolist()
        )
        for rule, boxes in found.boxes.items()
        if found.counts[rule]
    }
    return DrcReport(
        file=path.name,
        engine="rectangles",
        pillars=total,
        violations=found.counts,
        markers=markers,
        # Beyond the rule pairs are not looked for: a nearer one than was seen by the way may stand there.
        min_gap_nm=pairs.smallest * shapes.unit_nm if pairs.smallest <= math.ceil(limits.gap) else None,
        other_layers=shapes.other_layers,
    )


@dataclass(frozen=True)
class _Limits:
    """The rules in file units; a gap and a side are violated below their limit.

    Attributes:
        side: smallest width and length.
        upright: smallest of the shorter side; None without the rule.
        gap: smallest distance.
        row: height of a row of the search, above every small rectangle and its gap.
        grid: edges times the first must be multiples of the second.
    """

    side: float
    upright: float | None
    gap: float
    row: int
    grid: tuple[int, int]

    @classmethod
    def of(cls, design: Design, unit_nm: float) -> _Limits:
        """The rules of ``design``; a millionth of a unit is no violation."""
        upright_nm = upright_side_nm(design)
        gap = design.rules.min_gap_nm / unit_nm - _SLACK_DBU
        ratio = Fraction(unit_nm / design.mask.database_unit_nm).limit_denominator(1_000_000)
        return cls(
            design.rules.min_feature_nm / unit_nm - _SLACK_DBU,
            None if upright_nm is None else upright_nm / unit_nm - _SLACK_DBU,
            gap,
            int(max(design.unit_cell.cell.period_nm) / unit_nm + gap) + 2,
            (ratio.numerator, ratio.denominator),
        )

    def divide(self, chunk: Chunk) -> tuple[IntArray, IntArray]:
        """The rectangles that the rows take, not yet moved, and the others, moved, such as a frame: these are few."""
        boxes, limit = chunk.rectangles, min(self.row - self.gap, 2**16)
        if boxes[:, 2:].max(initial=0) < limit:
            return boxes, np.empty((0, 4), dtype=np.int64)  # no view, which would keep them all
        small = np.all(boxes[:, 2:] < limit, axis=1)
        return boxes[small], _moved(boxes[~small], chunk.shift)


class _Pairs:
    """Adds up what was found of pairs; rectangles too large for the rows are few, and compared with all others.

    Args:
        found: where violations are added.
        large: shape (n, 4).
        gap: smallest distance.
    """

    def __init__(self, found: _Found, large: IntArray, gap: float) -> None:
        self._found, self._large, self._gap = found, large, gap
        self._smallest_square = np.inf
        for index in range(len(large)):
            self._compare(large[index], large[index + 1 :])

    @property
    def smallest(self) -> float:
        """Smallest distance in file units, negative for overlaps; infinite without any pair."""
        return float(np.sign(self._smallest_square) * np.sqrt(abs(self._smallest_square)))

    def add(self, near: Near) -> None:
        """Count pairs and keep the boxes around the first of them."""
        self._smallest_square = min(self._smallest_square, near.smallest_square)
        for level, rule in enumerate(_PAIR_RULES):
            if near.counts[level]:
                kept = near.kind >= level
                self._found.add(rule, _joint(near.one[kept], near.other[kept]), int(near.counts[level]))

    def add_large(self, boxes: IntArray, shift: IntArray) -> None:
        """Compare some of the others, moved by ``shift``, with those that are too large for the rows."""
        for box in self._large:
            self._compare(box, _moved(boxes, shift))

    def _compare(self, box: IntArray, others: IntArray) -> None:
        gap = np.maximum(others[:, :2] - box[:2] - box[2:], box[:2] - others[:, :2] - others[:, 2:])
        depth = gap.max(axis=1)
        square = np.where(depth < 0, -(depth**2), np.sum(np.maximum(gap, 0) ** 2, axis=1)).astype(np.float64)
        near = np.flatnonzero(square < self._gap**2)
        kind = np.where(square[near] > 0, 0, np.where(np.all(others[near] == box, axis=1), 2, 1))
        counts = np.array([np.count_nonzero(kind >= level) for level in range(3)])
        self.add(
            Near(float(square.min(initial=np.inf)), counts, np.broadcast_to(box, (near.size, 4)), others[near], kind)
        )


def _rules(design: Design) -> list[str]:
    rules = ["min_width", "min_length", *_PAIR_RULES, "grid", "foreign"]
    return rules if design.rules.max_aspect_ratio is None else [*rules, "aspect_ratio"]


def _moved(boxes: IntArray, shift: IntArray) -> IntArray:
    return np.asarray(boxes + np.append(shift, [0, 0]))


def _box_of(other: Other) -> IntArray:
    return np.empty((0, 4), dtype=np.int64) if other.box is None else other.box[None]


def _joint(one: IntArray, other: IntArray) -> IntArray:
    low = np.minimum(one[:, :2], other[:, :2])
    high = np.maximum(one[:, :2] + one[:, 2:], other[:, :2] + other[:, 2:])
    return np.concatenate([low, high - low], axis=1)


def _check_each(chunk: Chunk, limits: _Limits, found: _Found) -> None:
    """Rules of single rectangles."""
    boxes = chunk.rectangles
    smallest = boxes[:, 2:].min(axis=0, initial=2**62)
    for rule, column in (("min_width", 0), ("min_length", 1)):
        if smallest[column] < limits.side:
            found.add(rule, _moved(boxes[boxes[:, 2 + column] < limits.side], chunk.shift))
    if limits.upright is not None and smallest.min() < limits.upright:
        found.add("aspect_ratio", _moved(boxes[boxes[:, 2:].min(axis=1) < limits.upright], chunk.shift))
    times, of = limits.grid
    if of > 1:
        moved = _moved(boxes, chunk.shift)
        off = np.any(moved * times % of != 0, axis=1)
        if off.any():
            found.add("grid", moved[off])
