"""Design rules on the rectangles of a file, whatever lattice they came from.

Rectangles go into rows as high as a period and the smallest gap, each row sorted along x; then a rectangle can be too
near only to those that follow it in its own row within its width and the gap, and to a few in the row above. The file
is read twice, to count and to place, so that 12 bytes a rectangle are all that is kept.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.executor import default_workers, in_order
from metafab.core.numerics import compiled
from metafab.core.progress import Progress, silent
from metafab.drc.report import MARKERS, DrcReport, Marker, upright_side_nm
from metafab.mask import read_shapes
from metafab.mask.hierarchy import Chunk, IntArray, Other
from metafab.spec import Design

# Pairs too near; of these overlapping or touching; of these equal.
_PAIR_RULES = ("min_gap", "overlap", "duplicate")

_BANDS = 64
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
        InputError: the file cannot be read.
    """
    shapes = read_shapes(path, design, progress)
    limits = _Limits.of(design, shapes.unit_nm)
    found = _Found(dict.fromkeys(_rules(design), 0))
    rows = _Rows(limits)
    for chunk in shapes.chunks():
        rows.count(_moved(chunk))
        for other in chunk.others:
            found.add("foreign", _box_of(other), other.count)
    rows.allocate()
    for chunk in shapes.chunks():
        boxes = _moved(chunk)
        _check_each(boxes, limits, found)
        rows.place(boxes)
        progress("placing", rows.placed, rows.total)
    smallest = rows.check_pairs(found, workers or default_workers(), progress)
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
        pillars=rows.total,
        violations=found.counts,
        markers=markers,
        min_gap_nm=smallest * shapes.unit_nm if np.isfinite(smallest) else None,
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

    def small(self, boxes: IntArray) -> NDArray[np.bool_]:
        """Which rectangles the rows take; others, such as a frame on the pillars' layer, are few."""
        return np.asarray(np.all(boxes[:, 2:] < min(self.row - self.gap, 2**16), axis=1))


class _Rows:
    """Rectangles in rows: first counted, then placed, then compared with their neighbours."""

    def __init__(self, limits: _Limits) -> None:
        self._limits = limits
        self._number: dict[int, int] = {}
        self._large: list[IntArray] = []
        self.placed = 0

    def count(self, boxes: IntArray) -> None:
        """Note how many rectangles belong to each row."""
        small = self._limits.small(boxes)
        self._large.append(boxes[~small])
        row = boxes[small, 1] // self._limits.row
        if row.size:
            lowest = int(row.min())
            for offset, number in enumerate(np.bincount(row - lowest).tolist()):
                if number:
                    self._number[lowest + offset] = self._number.get(lowest + offset, 0) + number

    def allocate(self) -> None:
        """Make room for all of them."""
        self._first = min(self._number, default=0)
        numbers = [self._number.get(row, 0) for row in range(self._first, max(self._number, default=-1) + 1)]
        self._start = np.append(0, np.cumsum(numbers)).astype(np.int64)
        self._following = self._start[:-1].copy()
        in_rows = int(self._start[-1])
        self._corner = np.empty((in_rows, 2), dtype=np.int32)
        self._size = np.empty((in_rows, 2), dtype=np.uint16)
        self._others = np.concatenate([np.empty((0, 4), dtype=np.int64), *self._large])
        self.total = in_rows + len(self._others)

    def place(self, boxes: IntArray) -> None:
        """Put the small ones into their rows."""
        small = self._limits.small(boxes)
        inside = boxes if small.all() else boxes[small]
        _place(inside, self._limits.row, self._first, self._following, self._corner, self._size)
        self.placed += len(boxes)

    def check_pairs(self, found: _Found, workers: int, progress: Progress) -> float:
        """Gaps and overlaps of all pairs; returns the smallest distance, negative for overlaps."""
        rows = self._start.size - 1
        bands = [(k * rows // _BANDS, (k + 1) * rows // _BANDS) for k in range(_BANDS)]
        bands = [band for band in bands if band[0] < band[1]]
        smallest = np.inf
        with ThreadPoolExecutor(workers) as threads:
            list(threads.map(self._sort, bands))
            jobs = in_order(threads, self._sweep, bands)
            for done, (square, pairs, counts) in enumerate(jobs, start=1):
                smallest = min(smallest, square)
                self._add(found, self._both(pairs), counts)
                progress("rules", done, len(bands))
        for index, box in enumerate(self._others):
            smallest = min(smallest, self._check_large(index, box, found))
        return float(np.sign(smallest) * np.sqrt(abs(smallest)))

    def _sort(self, band: tuple[int, int]) -> None:
        _sort(self._start, band[0], band[1], self._corner, self._size)

    def _sweep(self, band: tuple[int, int]) -> tuple[float, IntArray, IntArray]:
        pairs, counts = np.empty((MARKERS, 3), dtype=np.int64), np.zeros(3, dtype=np.int64)
        square = _sweep(self._start, band[0], band[1], self._corner, self._size, self._limits.gap, pairs, counts)
        return square, pairs[: min(int(counts[0]), MARKERS)], counts

    def _both(self, pairs: IntArray) -> tuple[IntArray, IntArray]:
        """Bounding boxes of listed pairs, and how far each is from harm: 0 too near, 1 overlapping, 2 equal."""
        one, other = (np.concatenate([self._corner[pairs[:, k]], self._size[pairs[:, k]]], axis=1) for k in (0, 1))
        return _joint(one.astype(np.int64), other.astype(np.int64)), pairs[:, 2]

    @staticmethod
    def _add(found: _Found, listed: tuple[IntArray, IntArray], counts: IntArray) -> None:
        boxes, kind = listed
        for level, rule in enumerate(_PAIR_RULES):
            if counts[level]:
                found.add(rule, boxes[kind >= level], int(counts[level]))

    def _check_large(self, index: int, box: IntArray, found: _Found) -> float:
        """One large rectangle against every small one and the large ones after it."""
        smalls = np.concatenate([self._corner, self._size], axis=1, dtype=np.int64)
        others = np.concatenate([smalls, self._others[index + 1 :]])
        gap = np.maximum(others[:, :2] - box[:2] - box[2:], box[:2] - others[:, :2] - others[:, 2:])
        depth = gap.max(axis=1)
        apart = np.sum(np.maximum(gap, 0) ** 2, axis=1)
        square = np.where(depth < 0, -(depth**2), apart).astype(np.float64)
        near = np.flatnonzero(square < self._limits.gap**2)
        kind = np.where(square[near] > 0, 0, np.where(np.all(others[near] == box, axis=1), 2, 1))
        counts = np.array([np.count_nonzero(kind >= level) for level in range(3)])
        self._add(found, (_joint(np.broadcast_to(box, (near.size, 4)), others[near]), kind), counts)
        return float(square.min(initial=np.inf))


def _rules(design: Design) -> list[str]:
    rules = ["min_width", "min_length", *_PAIR_RULES, "grid", "foreign"]
    return rules if design.rules.max_aspect_ratio is None else [*rules, "aspect_ratio"]


def _moved(chunk: Chunk) -> IntArray:
    return np.asarray(chunk.rectangles + np.append(chunk.shift, [0, 0]))


def _box_of(other: Other) -> IntArray:
    return np.empty((0, 4), dtype=np.int64) if other.box is None else other.box[None]


def _joint(one: IntArray, other: IntArray) -> IntArray:
    low = np.minimum(one[:, :2], other[:, :2])
    high = np.maximum(one[:, :2] + one[:, 2:], other[:, :2] + other[:, 2:])
    return np.concatenate([low, high - low], axis=1)


def _check_each(boxes: IntArray, limits: _Limits, found: _Found) -> None:
    """Rules of single rectangles."""
    smallest = boxes[:, 2:].min(axis=0, initial=2**62)
    for rule, column in (("min_width", 0), ("min_length", 1)):
        if smallest[column] < limits.side:
            found.add(rule, boxes[boxes[:, 2 + column] < limits.side])
    if limits.upright is not None and smallest.min() < limits.upright:
        found.add("aspect_ratio", boxes[boxes[:, 2:].min(axis=1) < limits.upright])
    times, of = limits.grid
    if of > 1:
        off = np.any(boxes * times % of != 0, axis=1)
        if off.any():
            found.add("grid", boxes[off])


@compiled
def _place(
    boxes: IntArray, height: int, first: int, following: IntArray, corner: NDArray[np.int32], size: NDArray[np.uint16]
) -> None:
    for i in range(len(boxes)):
        row = boxes[i, 1] // height - first
        place = following[row]
        corner[place, 0], corner[place, 1] = boxes[i, 0], boxes[i, 1]
        size[place, 0], size[place, 1] = boxes[i, 2], boxes[i, 3]
        following[row] = place + 1


@compiled
def _sort(start: IntArray, row: int, end_row: int, corner: NDArray[np.int32], size: NDArray[np.uint16]) -> None:
    """Sort the rectangles of each row by their left edge."""
    for one in range(row, end_row):
        begin, end = start[one], start[one + 1]
        order = np.argsort(corner[begin:end, 0])
        corner[begin:end] = corner[begin:end][order]
        size[begin:end] = size[begin:end][order]


@compiled
def _signed_square(gap_x: int, gap_y: int) -> float:
    """Squared distance of two rectangles with these gaps along the axes; minus the squared depth where they overlap."""
    depth = max(gap_x, gap_y)
    return float(-depth * depth) if depth < 0 else float(max(gap_x, 0) ** 2 + max(gap_y, 0) ** 2)


@compiled
def _sweep(
    start: IntArray,
    row: int,
    end_row: int,
    corner: NDArray[np.int32],
    size: NDArray[np.uint16],
    gap: float,
    pairs: IntArray,
    counts: IntArray,
) -> float:
    """Compare near pairs of the rows; returns the smallest signed square of a distance.

    ``counts`` becomes the pairs too near, of these overlapping, of these equal; ``pairs`` lists the first.
    """
    reach = int(gap) + 2  # pairs exactly at the limit are seen, too: they may be the nearest
    smallest = np.inf
    for one in range(row, end_row):
        above, above_end = start[one + 1], start[one + 1]
        if one + 2 < len(start):
            above_end = start[one + 2]
        widest = np.int64(size[above:above_end, 0].max()) if above_end > above else np.int64(0)
        for i in range(start[one], start[one + 1]):
            left, low = np.int64(corner[i, 0]), np.int64(corner[i, 1])
            width, length = np.int64(size[i, 0]), np.int64(size[i, 1])
            while above < above_end and corner[above, 0] + widest + reach < left:
                above += 1
            for beside in range(2):
                j = i + 1 if beside == 0 else above
                end = start[one + 1] if beside == 0 else above_end
                while j < end and corner[j, 0] < left + width + reach:
                    x, y = np.int64(corner[j, 0]), np.int64(corner[j, 1])
                    gap_x = max(x - left - width, left - x - np.int64(size[j, 0]))
                    gap_y = max(y - low - length, low - y - np.int64(size[j, 1]))
                    square = _signed_square(int(gap_x), int(gap_y))
                    smallest = min(smallest, square)
                    if square < gap * gap:
                        equal = x == left and y == low and size[j, 0] == width and size[j, 1] == length
                        kind = 2 if equal else int(square <= 0.0)
                        if counts[0] < len(pairs):
                            pairs[counts[0], 0], pairs[counts[0], 1], pairs[counts[0], 2] = i, j, kind
                        for level in range(kind + 1):
                            counts[level] += 1
                    j += 1
    return smallest
