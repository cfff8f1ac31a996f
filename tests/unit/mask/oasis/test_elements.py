"""OASIS integers, written many at a time and read one at a time."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from metafab.mask.oasis import elements
from metafab.mask.oasis.elements import Stream, read_displacements

TOKENS = arrays(np.uint64, st.integers(0, 40), elements=st.integers(0, 2**63 - 1))


@given(tokens=TOKENS)
def test_compiled_and_plain_integers_are_equal(tokens: np.ndarray) -> None:
    one_by_one = b"".join(elements.unsigned(int(token)) for token in tokens)
    out, end = np.empty(10 * tokens.size, dtype=np.uint8), 0
    for token in tokens:
        end = elements.put(out, end, int(token))
    assert out[:end].tobytes() == one_by_one
    stream = Stream(out[:end])
    assert [stream.unsigned() for _ in tokens] == tokens.tolist()


@given(value=st.integers(-(2**61), 2**61))
def test_signed_round_trip(value: int) -> None:
    assert Stream(np.frombuffer(elements.signed(value), dtype=np.uint8)).signed() == value


@given(
    steps=st.lists(
        st.tuples(st.integers(0, 7), st.integers(0, 10**6)) | st.tuples(st.integers(-999, 999), st.integers(-999, 999)),
        max_size=20,
    ),
    diagonal=st.booleans(),
)
def test_displacements_of_both_forms(steps: list[tuple[int, int]], diagonal: bool) -> None:
    """Form 1 (direction, length) and form 2 (x, y), against the standard's definition written out."""
    directions = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
    data, moves = b"", []
    for first, second in steps:
        if diagonal and 0 <= first < 8 and second >= 0:
            data += elements.unsigned(second << 4 | first << 1)
            moves.append((directions[first][0] * second, directions[first][1] * second))
        else:
            data += elements.unsigned(abs(first) << 2 | (first < 0) << 1 | 1) + elements.signed(second)
            moves.append((first, second))
    offsets = np.zeros((len(steps) + 1, 2), dtype=np.int64)
    end = read_displacements(np.frombuffer(data, dtype=np.uint8), 0, 2, offsets)
    assert end == len(data)
    assert np.array_equal(offsets[1:], np.cumsum(np.array(moves, dtype=np.int64).reshape(-1, 2), axis=0))
