"""Every repetition of OASIS: the compiled loop over rectangles against the reader of single records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from metafab.mask.oasis import reader as oasis_reader
from metafab.mask.oasis import varints
from metafab.mask.oasis.reader import OasisReader
from metafab.mask.oasis.writer import CELL, END, MAGIC, RECTANGLE, START

COUNTS = st.integers(0, 5)
SPACE = st.integers(0, 5000)
STEP = st.tuples(st.integers(-900, 900), st.integers(-900, 900))


def _delta(step: tuple[int, int]) -> bytes:
    x, y = step
    return varints.unsigned(abs(x) << 2 | (x < 0) << 1 | 1) + varints.signed(y)


@st.composite
def repetitions(draw: st.DrawFn) -> bytes:
    """A repetition of any type from 1 to 11, written out by the standard."""
    kind, count, rows = draw(st.integers(1, 11)), draw(COUNTS), draw(COUNTS)
    head = varints.unsigned(kind) + varints.unsigned(count)
    space = [varints.unsigned(draw(SPACE)) for _ in range(count + 1)]
    steps = [_delta(draw(STEP)) for _ in range(count + 1)]
    grid = varints.unsigned(draw(st.integers(1, 700)))
    return head + {
        1: lambda: varints.unsigned(rows) + space[0] + varints.unsigned(draw(SPACE)),
        2: lambda: space[0], 3: lambda: space[0],
        4: lambda: b"".join(space), 5: lambda: grid + b"".join(space),
        6: lambda: b"".join(space), 7: lambda: grid + b"".join(space),
        8: lambda: varints.unsigned(rows) + steps[0] + _delta(draw(STEP)),
        9: lambda: steps[0],
        10: lambda: b"".join(steps), 11: lambda: grid + b"".join(steps),
    }[kind]()  # fmt: skip


@pytest.mark.skipif(not oasis_reader.HAS_NUMBA, reason="compares with compiled code")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lists=st.lists(repetitions(), min_size=1, max_size=4), again=st.booleans())
def test_compiled_and_single_records_agree(lists: list[bytes], again: bool, tmp_path: Path) -> None:
    """With ``again``, the last rectangle repeats the repetition before it (type 0), which the loop leaves alone."""
    records = b""
    for place, repetition in enumerate([*lists, *([b"\0"] if again else [])]):
        records += bytes([RECTANGLE, 0b0111_1111, 1, 0]) + varints.unsigned(7 + place) + varints.unsigned(9)
        records += varints.signed(-40 * place) + varints.signed(3 - place) + repetition
    head = MAGIC + bytes([START]) + varints.string("1.0") + b"\x00" + varints.unsigned(2000) + bytes(13)
    path = tmp_path / "repetitions.oas"
    end = bytes([END]) + varints.unsigned(252) + bytes(253)
    path.write_bytes(head + bytes([CELL]) + varints.string("T") + records + end)
    found = []
    with pytest.MonkeyPatch.context() as patch:
        for compiled in (True, False):
            patch.setattr(oasis_reader, "HAS_NUMBA", compiled)
            cell = OasisReader(path, (1, 0, 0)).cells["T"]
            boxes = [chunk.rectangles for chunk in cell.shapes()]
            found.append((cell.shape_count, np.concatenate(boxes)))
    assert found[0][0] == found[1][0] == len(found[1][1])
    assert np.array_equal(found[0][1], found[1][1])
