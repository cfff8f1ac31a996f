"""The pillars of a tile -> RECTANGLE records of OASIS, one a size with all its places, deflated.

Repetition type 11 lists displacements in steps of a grid, here the lattice. A record states only what differs
from the one before (modal width, height and layer, relative positions).

How small a tile becomes is a matter of the order in which places are listed: neighbouring sizes follow one another,
and deflate lives on their lists having stretches in common. Which order has more of them depends on how the phase
runs through the tile, so that some sizes are listed in several orders, and the shortest wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from deflate import deflate_compress
from numpy.typing import NDArray

from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask.drawing.cells import Stamp, TileCell
from metafab.mask.oasis import varints

RECTANGLE, POLYGON = 20, 21

# Info byte of RECTANGLE, SWHXYRDL from the top bit, and of POLYGON, 00PXYRDL: what is given explicitly.
W, H, X, Y, _REPETITION, DATATYPE_LAYER = 0b100_0000, 0b10_0000, 0b1_0000, 0b1000, 0b100, 0b011
_POINTS = 0b10_0000
_ARBITRARY_ON_GRID = 11

# Of libdeflate, which takes half of zlib's time for fewer bytes. docs/benchmarks.md has the bytes and seconds of
# each level: those from 10 on save another 5 % in six times the time.
_DEFLATE_LEVEL = 7


@dataclass(frozen=True)
class Scan:
    """The order in which the places of a size are listed: strip by strip, in each line by line.

    Attributes:
        along_y: whether lines run along y; else along x.
        strip_sites: length of a line; the strips lie side by side along the lines.
    """

    along_y: bool
    strip_sites: int


#: Tiles are listed by the best of these; the last takes whole rows.
SCANS = (Scan(along_y=False, strip_sites=238), Scan(along_y=True, strip_sites=238), Scan(False, strip_sites=1 << 16))

# The share of the sizes that is listed by each to find the best.
_TRIED_SHARE = 16


def deflate(data: bytes) -> bytearray:
    """Raw deflate data, as a CBLOCK holds them. Lets other threads run meanwhile."""
    return deflate_compress(data, _DEFLATE_LEVEL)


def best_scan(tile: PillarTile, lattice: Lattice, stamp: Stamp, cell: TileCell) -> Scan:
    """The scan by which a share of the sizes, neighbours in the middle of the table, deflates best."""
    count = len(stamp.size_dbu) - 1
    tried = max(1, count // _TRIED_SHARE)
    first = 1 + (count - tried) // 2
    index = tile.size_index
    # One comparison of unsigned numbers: those below ``first`` become large.
    few = PillarTile(tile.row, tile.column, np.where(index - np.uint16(first) < tried, index, np.uint16(0)))
    if not few.size_index.any():
        return SCANS[0]

    def length(scan: Scan) -> int:
        """Deflated bytes of the tried sizes."""
        return len(deflate(rectangle_records(few, lattice, stamp, cell, scan)))

    return min(SCANS, key=length)


def rectangle_records(
    tile: PillarTile,
    lattice: Lattice,
    stamp: Stamp,
    cell: TileCell,
    scan: Scan,
    *,
    absolute: bool = False,
) -> bytes:
    """The RECTANGLE (POLYGON) records of a tile, by size; not yet deflated.

    Positions are relative to the record before, or ``absolute`` where other tiles go before in the same cell. Nothing
    else is taken from before the first record.
    """
    if not HAS_NUMBA and stamp.polygons is None:
        return rectangle_records_vectorised(tile, lattice, stamp, cell, scan, absolute=absolute)
    row, column, end_of = sorted_by_size(tile.size_index, len(stamp.size_dbu), scan)
    points, points_end = _point_lists(stamp)
    # No displacement in a tile takes more than 12 bytes, no head of a record more than 64 and its points.
    out = np.empty(12 * row.size + 64 * len(stamp.size_dbu) + points.size, dtype=np.uint8)
    first_dbu = (cell.first_x_dbu, cell.first_y_dbu)
    shape = (stamp.size_dbu, stamp.corner_dbu)
    layer_datatype = (stamp.layer, stamp.datatype)
    end = _write_records(
        row, column, end_of, *shape, points, points_end,
        lattice.period_dbu, first_dbu, layer_datatype, 0 if absolute else 1, out,
    )  # fmt: skip
    return out[:end].tobytes()


def _point_lists(stamp: Stamp) -> tuple[varints.ByteArray, NDArray[np.int64]]:
    """The point lists (type 4, a displacement from each corner to the next) of all sizes, and where each one ends.

    Empty for rectangles.
    """
    if stamp.polygons is None:
        return np.empty(0, dtype=np.uint8), np.empty(0, dtype=np.int64)
    lists = [_point_list(polygon.tobytes()) for polygon in stamp.polygons]
    return np.frombuffer(b"".join(lists), dtype=np.uint8), np.cumsum([len(one) for one in lists])


@lru_cache(maxsize=1 << 16)
def _point_list(polygon: bytes) -> bytes:
    """The point list of one polygon, whose corners are the bytes of an array of shape (n, 2)."""
    steps = np.diff(np.frombuffer(polygon, dtype=np.int64).reshape(-1, 2), axis=0).tolist()
    moves = (varints.unsigned(abs(x) << 2 | (x < 0) << 1 | 1) + varints.signed(y) for x, y in steps)
    return varints.unsigned(4) + varints.unsigned(len(steps)) + b"".join(moves)


@compiled
def _write_records(
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    end_of: NDArray[np.int64],
    size_dbu: NDArray[np.int64],
    corner_dbu: NDArray[np.int64],
    points: varints.ByteArray,
    points_end: NDArray[np.int64],
    period: tuple[int, int],
    first_dbu: tuple[int, int],
    layer_datatype: tuple[int, int],
    relative: int,
    out: varints.ByteArray,
) -> int:
    grid = math.gcd(period[0], period[1])
    step_x, step_y = period[0] // grid, period[1] // grid
    end, here = 0, 0
    modal = np.array([-1, -1, 0, 0], dtype=np.int64)
    for size in range(1, len(size_dbu)):
        behind = end_of[size]
        if behind == here:
            continue
        count = behind - here
        width, length = size_dbu[size, 0], size_dbu[size, 1]
        x = first_dbu[0] + column[here] * period[0] + corner_dbu[size, 0]
        y = first_dbu[1] + row[here] * period[1] + corner_dbu[size, 1]
        info = (_REPETITION if count > 1 else 0) | (DATATYPE_LAYER if here == 0 else 0)
        changed = (W if width != modal[0] else 0) | (H if length != modal[1] else 0)
        info |= _POINTS if points.size else changed
        info |= (X if here == 0 or x != modal[2] else 0) | (Y if here == 0 or y != modal[3] else 0)
        end = varints.put(out, varints.put(out, end, POLYGON if points.size else RECTANGLE), info)
        if here == 0:
            end = varints.put(out, varints.put(out, end, layer_datatype[0]), layer_datatype[1])
        if points.size:
            end = _copy(points[points_end[size - 1] : points_end[size]], out, end)
        else:
            end = varints.put(out, end, width) if info & W else end
            end = varints.put(out, end, length) if info & H else end
        if info & X:
            end = varints.put_signed(out, end, x - relative * modal[2])
        if info & Y:
            end = varints.put_signed(out, end, y - relative * modal[3])
        modal[0], modal[1], modal[2], modal[3] = width, length, x, y
        if count > 1:
            end = varints.put(out, varints.put(out, end, _ARBITRARY_ON_GRID), count - 2)
            end = varints.put(out, end, grid)
        for pillar in range(here + 1, behind):
            right = (column[pillar] - column[pillar - 1]) * step_x
            up = (row[pillar] - row[pillar - 1]) * step_y
            end = _put_displacement(out, end, right, up)
        here = behind
    return end


@compiled
def _copy(points: varints.ByteArray, out: varints.ByteArray, end: int) -> int:
    for byte in points:
        out[end] = byte
        end += 1
    return end


@compiled
def _put_displacement(out: varints.ByteArray, end: int, right: int, up: int) -> int:
    """A g-delta: along x or y alone (form 1), or both (form 2)."""
    if up == 0:
        return varints.put(out, end, abs(right) << 4 | (4 if right < 0 else 0))
    if right == 0:
        return varints.put(out, end, abs(up) << 4 | (6 if up < 0 else 2))
    return varints.put_signed(out, varints.put(out, end, abs(right) << 2 | (right < 0) << 1 | 1), up)


def rectangle_records_vectorised(
    tile: PillarTile,
    lattice: Lattice,
    stamp: Stamp,
    cell: TileCell,
    scan: Scan,
    *,
    absolute: bool = False,
) -> bytes:
    """As :func:`rectangle_records`, in NumPy alone: every byte is an unsigned integer, ids and flags included."""
    grid = math.gcd(*lattice.period_dbu)
    step_x, step_y = (period // grid for period in lattice.period_dbu)
    row, column, end_of = sorted_by_size_vectorised(tile.size_index, len(stamp.size_dbu), scan)
    start_of = np.append(0, end_of[:-1])
    used = np.flatnonzero(end_of > start_of)
    first, count = start_of[used], (end_of - start_of)[used]

    # Each column of the head, and where it is given: layer and datatype once, lists only for two and more.
    size = stamp.size_dbu[used]
    corner = np.stack([column[first] * lattice.period_dbu[0], row[first] * lattice.period_dbu[1]], axis=1)
    corner += np.array([cell.first_x_dbu, cell.first_y_dbu]) + stamp.corner_dbu[used]
    modal = np.concatenate([size, corner], axis=1)
    before = np.concatenate([[[-1, -1, 0, 0]], modal[:-1]])
    changed = modal != before
    changed[0] = True
    opens, several = np.arange(used.size) == 0, count > 1
    info = changed @ np.array([W, H, X, Y]) + _REPETITION * several + DATATYPE_LAYER * opens
    steps = _zigzag((modal if absolute else modal - before)[:, 2:])
    constants = np.broadcast_to([RECTANGLE, stamp.layer, stamp.datatype, _ARBITRARY_ON_GRID, grid], (used.size, 5))
    head = np.column_stack(
        [constants[:, 0], info, constants[:, 1:3], size, steps, constants[:, 3], count - 2, constants[:, 4]]
    )
    always = np.ones(used.size, dtype=bool)
    given = np.column_stack([always, always, opens, opens, changed, several, several, several])

    # Displacements from the previous pillar of the same size: along x or y alone (form 1) or both (form 2).
    delta_x, delta_y = np.diff(column, prepend=0) * step_x, np.diff(row, prepend=0) * step_y
    along_x, along_y = delta_y == 0, delta_x == 0
    direction = np.where(along_x, np.where(delta_x < 0, 2, 0), np.where(delta_y < 0, 3, 1))
    form_1 = (np.abs(delta_x + delta_y) << 4) | (direction << 1)
    form_2 = (np.abs(delta_x) << 2) | ((delta_x < 0) << 1) | 1
    single = along_x | along_y

    tokens_of = np.where(single, 1, 2)
    tokens_of[first] = given.sum(axis=1)
    end = np.cumsum(tokens_of)
    start = end - tokens_of
    tokens = np.empty(int(end[-1]), dtype=np.int64)
    inner = np.ones(row.size, dtype=bool)
    inner[first] = False
    one, two = inner & single, inner & ~single
    tokens[start[one]] = form_1[one]
    tokens[start[two]] = form_2[two]
    tokens[start[two] + 1] = _zigzag(delta_y[two])
    tokens[(start[first][:, None] + np.cumsum(given, axis=1) - 1)[given]] = head[given]
    return varints.encode_vectorised(tokens.view(np.uint64))


def sorted_by_size(
    size_index: NDArray[np.uint16], sizes: int, scan: Scan
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Row and column of each pillar, by size, strip and line; and where each size ends in the list."""
    if not HAS_NUMBA:
        return sorted_by_size_vectorised(size_index, sizes, scan)
    return _sorted_by_size(size_index, sizes, scan.along_y, scan.strip_sites)


@compiled
def _sorted_by_size(
    size_index: NDArray[np.uint16], sizes: int, along_y: bool, strip_sites: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Row and column of each pillar, by size, strip and line; and where each size ends in the list."""
    n_y, n_x = size_index.shape
    end_of = np.zeros(sizes, dtype=np.int64)
    for i in range(n_y):
        for j in range(n_x):
            if size_index[i, j]:
                end_of[size_index[i, j]] += 1
    following = np.zeros(sizes, dtype=np.int64)  # Loops: cumsum and append take a second to compile.
    for size in range(1, sizes):
        end_of[size] += end_of[size - 1]
        following[size] = end_of[size - 1]
    row, column = np.empty(end_of[-1], dtype=np.int32), np.empty(end_of[-1], dtype=np.int32)
    slow, fast = (n_x, n_y) if along_y else (n_y, n_x)
    for strip in range(0, fast, strip_sites):
        for i in range(slow):
            for j in range(strip, min(strip + strip_sites, fast)):
                size = size_index[j, i] if along_y else size_index[i, j]
                if size:
                    place = following[size]
                    row[place], column[place] = (j, i) if along_y else (i, j)
                    following[size] = place + 1
    return row, column, end_of


def sorted_by_size_vectorised(
    size_index: NDArray[np.uint16], sizes: int, scan: Scan
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """As the compiled sorting, in NumPy alone."""
    places: NDArray[np.int32] = np.arange(size_index.size, dtype=np.int32).reshape(size_index.shape)
    scanned = places.T if scan.along_y else places
    strips = [scanned[:, k : k + scan.strip_sites].ravel() for k in range(0, scanned.shape[1], scan.strip_sites)]
    place = np.concatenate(strips)
    size = size_index.ravel()[place]
    count = np.bincount(size, minlength=sizes)
    order = np.argsort(size, kind="stable")[count[0] :]
    count[0] = 0
    row, column = np.divmod(place[order], np.int32(size_index.shape[1]))
    return row, column, np.cumsum(count)


def _zigzag(value: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((np.abs(value) << 1) | (value < 0))
