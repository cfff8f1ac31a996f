"""Near pairs of rectangles, found row by row, against every pair looked at."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from metafab.core.parallel.executor import SerialExecutor
from metafab.drc.rows import Rows

HEIGHT, GAP = 40, 9.5


def _every_pair(boxes: np.ndarray) -> tuple[float, list[int]]:
    """Smallest signed square of a distance, and pairs too near, overlapping or touching, equal."""
    one, other = np.triu_indices(len(boxes), 1)
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    gap = np.maximum(low[other] - high[one], low[one] - high[other])
    depth = gap.max(axis=1)
    square = np.where(depth < 0, -(depth**2), np.sum(np.maximum(gap, 0) ** 2, axis=1))
    equal = np.all(boxes[one] == boxes[other], axis=1)
    return float(square.min()), [int(np.sum(square < GAP**2)), int(np.sum(square <= 0)), int(np.sum(equal))]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("threads", [0, 2])
def test_rows_find_every_near_pair(seed: int, threads: int) -> None:
    # Several bands of 128 rows, of which one is empty; chunks overlap in height and come with a shift of their own.
    random = np.random.default_rng(seed)
    height = 128 * HEIGHT
    y = np.sort(np.concatenate([random.integers(-2 * height, 0, 900), random.integers(height, 3 * height, 900)]))
    boxes = np.column_stack([random.integers(0, 900, y.size), y, random.integers(8, 30, (y.size, 2))])
    boxes = np.concatenate([boxes, boxes[100:103]])[np.argsort(np.append(y, y[100:103]) // 3000, kind="stable")]
    shifts = random.integers(-500, 500, (12, 2))
    chunks = [
        (part - np.append(shift, [0, 0]), shift) for part, shift in zip(np.array_split(boxes, 12), shifts, strict=True)
    ]
    with ThreadPoolExecutor(threads) if threads else SerialExecutor() as executor:
        rows = Rows(HEIGHT, GAP, executor)
        for part, shift in chunks:
            rows.count(part, shift)
        found = [near for part, shift in chunks for near in rows.place(part, shift)]
        found += rows.finish()
    smallest, counts = _every_pair(boxes)
    assert counts[2] == 3 < counts[1] < counts[0]
    assert np.sum([near.counts for near in found], axis=0).tolist() == counts
    assert min(near.smallest_square for near in found) == smallest
    assert sum(len(near.one) for near in found) == counts[0]
    known = {tuple(box) for box in boxes.tolist()}
    assert all(tuple(box) in known for near in found for pair in (near.one, near.other) for box in pair.tolist())
