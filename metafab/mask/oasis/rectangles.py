"""Compiled loop over runs of OASIS RECTANGLE records, which hold nearly all shapes of a mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.mask.oasis.elements import REGULAR, ByteArray, read_displacement, read_repetition, read_unsigned
from metafab.mask.oasis.records import RECTANGLE
from metafab.mask.shapes.hierarchy import IntArray

#: Largest number of rectangles in a chunk; longer repetitions are left to the reader of single records.
LARGEST_CHUNK = 1 << 21
#: Rectangles of a run, few enough for the cache. All runs use arrays of this size, whose memory is used again.
RUN = 1 << 16


@compiled
def read_rectangles(
    data: ByteArray, position: int, state: NDArray[np.int64], wanted: tuple[int, int, int], out: IntArray, capacity: int
) -> tuple[int, int]:
    """Read RECTANGLE records; return the position after the last one read, and the number of rectangles.

    Stops at any other record, at another layer, at a repetition that repeats an earlier one, when ``capacity`` is
    reached, and where the data end; ``state`` is then as before the record that was not read.

    ``state``, shape (8,), is updated: modal layer, datatype, x, y, width, height, position of the last repetition (-1
    for none), and whether positions are relative. ``wanted`` is (layer, first datatype, last datatype). ``out``, shape
    (capacity, 4), is filled with x, y, width, height; shape (0, 4) to count only.
    """
    count = 0
    now = state.copy()
    while position + 1 < len(data) and data[position] == RECTANGLE:
        info = data[position + 1]
        _copy(now, state)
        here = _read_fields(data, position + 2, info, now)
        if here < 0 or now[0] != wanted[0] or now[1] < wanted[1] or now[1] > wanted[2]:
            break
        copies, columns, grid, form = 1, 1, 1, REGULAR
        fast_x, fast_y, slow_x, slow_y = 0, 0, 0, 0
        if info & 4:
            now[6] = here
            copies, columns, grid, form, fast_x, fast_y, slow_x, slow_y, here = read_repetition(data, here)
        if here < 0 or count + copies > capacity:
            break
        x, y = now[2], now[3]
        for copy in range(copies):
            if form == REGULAR:
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
        _copy(state, now)
    return position, count


@compiled
def _copy(target: NDArray[np.int64], source: NDArray[np.int64]) -> None:
    """Set ``target[:] = source``, whose check of the shapes would take seconds to compile."""
    for i in range(len(target)):
        target[i] = source[i]


@compiled
def _read_fields(data: ByteArray, here: int, info: int, state: NDArray[np.int64]) -> int:
    """Read the fields that the bits SWHXYRDL of ``info`` announce; return the position after them, or -1."""
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
