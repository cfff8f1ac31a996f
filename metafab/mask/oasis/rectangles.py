"""Runs of RECTANGLE records of OASIS, which hold nearly all of a mask -> rectangles, by a compiled loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.mask.oasis.records import RECTANGLE
from metafab.mask.oasis.stream import read_displacement, read_unsigned
from metafab.mask.shapes.hierarchy import IntArray

#: Rectangles that are handed on together at most; longer repetitions are left to the reader of single records.
LARGEST_CHUNK = 1 << 21
#: Rectangles of a run, which stay in the cache. Pieces of one size, handed back, serve the next.
RUN = 1 << 16

_REGULAR = 3  # copies at equal steps, no list


@compiled
def read_rectangles(
    data: NDArray[np.uint8],
    position: int,
    state: NDArray[np.int64],
    wanted: tuple[int, int, int],
    out: IntArray,
    capacity: int,
) -> tuple[int, int]:
    """RECTANGLE records from ``position`` on -> (position behind the last taken, rectangles).

    Stops at any other record, at another layer, at a repetition that repeats an earlier one, when ``out`` is full,
    and where the data end; ``state`` is then as before the record that was not taken.
    """
    count = 0
    now = state.copy()
    while position + 1 < len(data) and data[position] == RECTANGLE:
        info = data[position + 1]
        _set(now, state)
        here = _read_fields(data, position + 2, info, now)
        if here < 0 or now[0] != wanted[0] or now[1] < wanted[1] or now[1] > wanted[2]:
            break
        copies, columns, grid, form = 1, 1, 1, _REGULAR
        fast_x, fast_y, slow_x, slow_y = 0, 0, 0, 0
        if info & 4:
            now[6] = here
            copies, columns, grid, form, fast_x, fast_y, slow_x, slow_y, here = _read_repetition(data, here)
        if here < 0 or count + copies > capacity:
            break
        x, y = now[2], now[3]
        for copy in range(copies):
            if form == _REGULAR:
                x = now[2] + copy % columns * fast_x + copy // columns * slow_x
                y = now[3] + copy % columns * fast_y + copy // columns * slow_y
            elif copy:
                step_x, step_y, here = read_displacement(data, here, form)
                if here < 0:
                    return position, count
                x += grid * step_x
                y += grid * step_y
            if len(out):
                place = count + copy
                out[place, 0], out[place, 1], out[place, 2], out[place, 3] = x, y, now[4], now[5]
        count += copies
        position = here
        _set(state, now)
    return position, count


@compiled
def _set(target: NDArray[np.int64], source: NDArray[np.int64]) -> None:
    """``target[:] = source``, whose check of the shapes takes seconds to compile."""
    for i in range(len(target)):
        target[i] = source[i]


@compiled
def _read_fields(data: NDArray[np.uint8], here: int, info: int, state: NDArray[np.int64]) -> int:
    """Layer, datatype, width, height, x and y of a RECTANGLE, as ``info`` says; the position behind, or -1."""
    for bit, field_of_state in ((1, 0), (2, 1), (64, 4), (32, 5)):
        if here >= 0 and info & bit and not (bit == 32 and info & 128):
            state[field_of_state], here = read_unsigned(data, here)
    if info & 128:
        state[5] = state[4]
    for bit, field_of_state in ((16, 2), (8, 3)):
        if here >= 0 and info & bit:
            value, here = read_unsigned(data, here)
            step = -(value >> 1) if value & 1 else value >> 1
            state[field_of_state] = state[field_of_state] + step if state[7] else step
    return here


@compiled
def _read_repetition(data: NDArray[np.uint8], here: int) -> tuple[int, int, int, int, int, int, int, int, int]:
    """What a repetition says of its copies, up to where a list begins.

    Returns:
        Copies, columns, grid, form of a list's displacements (as :func:`read_displacement`) or ``_REGULAR``, the
        steps (x, y) along and between columns, and the position behind; that is -1 where the data end, where the
        repetition is an earlier one's, and where it has more copies than a chunk holds.
    """
    kind, here = read_unsigned(data, here)
    first, second, grid = 0, 0, 1
    if kind < 1 or kind > 11:
        return 1, 1, 1, _REGULAR, 0, 0, 0, 0, -1
    if here >= 0:
        first, here = read_unsigned(data, here)
    columns, rows = first + 2, 1
    if here >= 0 and kind in (1, 8):
        second, here = read_unsigned(data, here)
        rows = second + 2
    if columns > LARGEST_CHUNK or rows > LARGEST_CHUNK:
        return 1, 1, 1, _REGULAR, 0, 0, 0, 0, -1
    if kind in (4, 5, 6, 7, 10, 11):
        if here >= 0 and kind in (5, 7, 11):
            grid, here = read_unsigned(data, here)
        form = 2 if kind >= 10 else kind // 6
        return columns, columns, grid, form, 0, 0, 0, 0, here
    form = 0 if kind in (1, 2) else 1 if kind == 3 else 2
    fast_x, fast_y, slow_x, slow_y = 0, 0, 0, 0
    if here >= 0:
        fast_x, fast_y, here = read_displacement(data, here, form)
    if here >= 0 and rows > 1:
        slow_x, slow_y, here = read_displacement(data, here, 1 if kind == 1 else 2)
    return columns * rows, columns, 1, _REGULAR, fast_x, fast_y, slow_x, slow_y, here
