"""Every repetition of OASIS: the compiled loop over rectangles and the reader of single records, by the standard."""

from __future__ import annotations

import tracemalloc
from itertools import accumulate
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from metafab.mask.oasis.elements import signed, string, unsigned
from metafab.mask.oasis.reader import OasisReader
from metafab.mask.oasis.records import RECTANGLE
from metafab.mask.oasis.writer import CELL, END, MAGIC, START
from metafab.mask.shapes.hierarchy import IntArray
from metafab.mask.shapes.recover import KnownShapes, rectangle_of

Step = tuple[int, int]

COUNTS = st.integers(0, 5)
SPACE = st.integers(0, 5000)
STEP = st.tuples(st.integers(-900, 900), st.integers(-900, 900))


class _OneByOne(KnownShapes):
    """Rectangles, but not so that the reader takes its compiled loop."""

    @property
    def are_rectangles(self) -> bool:
        return False

    def __call__(self, ring: IntArray, unit_nm: float) -> IntArray | None:
        return rectangle_of(ring)


def _delta(step: Step) -> bytes:
    x, y = step
    return unsigned(abs(x) << 2 | (x < 0) << 1 | 1) + signed(y)


def _grid(columns: int, rows: int, fast: Step, slow: Step) -> list[Step]:
    return [(c * fast[0] + r * slow[0], c * fast[1] + r * slow[1]) for r in range(rows) for c in range(columns)]


def _list(steps: list[Step], grid: int) -> list[Step]:
    return [(0, 0), *accumulate(((grid * x, grid * y) for x, y in steps), lambda a, b: (a[0] + b[0], a[1] + b[1]))]


@st.composite
def repetitions(draw: st.DrawFn) -> tuple[bytes, list[Step]]:
    """A repetition of any type from 1 to 11, and the offsets of its copies, written out by the standard."""
    kind, count, rows = draw(st.integers(1, 11)), draw(COUNTS), draw(COUNTS)
    spaces, steps = [draw(SPACE) for _ in range(count + 1)], [draw(STEP) for _ in range(count + 1)]
    other_space, other_step, grid = draw(SPACE), draw(STEP), draw(st.integers(1, 700))
    head = unsigned(kind) + unsigned(count)
    if kind in {1, 8}:
        fast, slow = ((spaces[0], 0), (0, other_space)) if kind == 1 else (steps[0], other_step)
        tail = unsigned(spaces[0]) + unsigned(other_space) if kind == 1 else _delta(fast) + _delta(slow)
        return head + unsigned(rows) + tail, _grid(count + 2, rows + 2, fast, slow)
    if kind in {2, 3, 9}:
        fast = {2: (spaces[0], 0), 3: (0, spaces[0]), 9: steps[0]}[kind]
        return head + (_delta(fast) if kind == 9 else unsigned(spaces[0])), _grid(count + 2, 1, fast, (0, 0))
    on_grid = kind in {5, 7, 11}
    head += unsigned(grid) if on_grid else b""
    if kind < 10:
        steps = [(space, 0) if kind < 6 else (0, space) for space in spaces]
        tail = b"".join(unsigned(space) for space in spaces)
    else:
        tail = b"".join(_delta(step) for step in steps)
    return head + tail, _list(steps, grid if on_grid else 1)


def _file(path: Path, records: bytes) -> Path:
    """An OASIS file of one cell."""
    head = MAGIC + bytes([START]) + string("1.0") + b"\x00" + unsigned(2000) + bytes(13)
    end = bytes([END]) + unsigned(252) + bytes(253)
    path.write_bytes(head + bytes([CELL]) + string("T") + records + end)
    return path


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lists=st.lists(repetitions(), min_size=1, max_size=4), again=st.booleans())
def test_compiled_and_single_records_follow_the_standard(
    lists: list[tuple[bytes, list[Step]]], again: bool, tmp_path: Path
) -> None:
    """With ``again``, the last rectangle repeats the repetition before it (type 0), which the loop leaves alone."""
    records, expected = b"", []
    for place, (repetition, offsets) in enumerate([*lists, *([(b"\0", lists[-1][1])] if again else [])]):
        records += bytes([RECTANGLE, 0b0111_1111, 1, 0]) + unsigned(7 + place) + unsigned(9)
        records += signed(-40 * place) + signed(3 - place) + repetition
        expected += [(x - 40 * place, y + 3 - place, 7 + place, 9) for x, y in offsets]
    path = _file(tmp_path / "repetitions.oas", records)
    for known in (KnownShapes(), _OneByOne()):
        cell = OasisReader(path, (1, 0, 0), known=known).cells["T"]
        boxes = np.concatenate([chunk.rectangles for chunk in cell.shapes()])
        assert cell.shape_count == len(boxes)
        assert boxes.tolist() == [list(box) for box in expected]


def test_many_short_runs_take_the_memory_of_their_rectangles(tmp_path: Path) -> None:
    """Rectangles of another layer end each run after one; 2 MB were kept for each, 1.2 GB in all."""
    pair = b"".join(bytes([RECTANGLE, 0b0111_1011, layer, 0, 7, 9, 2, 2]) for layer in (1, 2))
    path = _file(tmp_path / "runs.oas", pair * 600)
    tracemalloc.start()
    cell = OasisReader(path, (1, 0, 0), known=KnownShapes()).cells["T"]
    boxes = np.concatenate([chunk.rectangles for chunk in cell.shapes()])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(boxes) == 600
    assert peak < 20e6
