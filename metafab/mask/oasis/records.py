"""Pillars of a tile -> RECTANGLE or POLYGON records of OASIS, one per size with all its places, deflated.

Repetition type 11 lists displacements in steps of a grid, here the lattice. A record states only what differs from the
record before (modal width, height and layer, relative positions).

The order of the places decides how small a tile becomes: sizes of neighbouring index follow one another, and deflate
uses the stretches that their lists have in common. Which order has more of them depends on how the phase runs through
the tile. A sample of the sizes is therefore listed in several orders, and the shortest wins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from deflate import deflate_compress
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled
from metafab.layout.pillars import Lattice, PillarTile
from metafab.mask.drawing.cells import Stamp, TileCell
from metafab.mask.drawing.scan import Scan, sorted_by_size
from metafab.mask.oasis import elements
from metafab.mask.oasis.elements import ByteArray, put, put_signed

RECTANGLE, POLYGON = 20, 21

# Info byte of RECTANGLE, SWHXYRDL from the top bit, and of POLYGON, 00PXYRDL: fields that are given explicitly.
W, H, X, Y, _REPETITION, DATATYPE_LAYER = 0b100_0000, 0b10_0000, 0b1_0000, 0b1000, 0b100, 0b011
POINTS = 0b10_0000
_ARBITRARY_ON_GRID = 11

# Level of libdeflate, which takes half of zlib's time for fewer bytes; docs/benchmarks/masks.md has the figures of
# each level: those from 10 on save another 5 % in six times the time.
_DEFLATE_LEVEL = 7

#: Orders of which the best is chosen for each tile; the last takes whole rows.
SCANS = (Scan(along_y=False, strip_sites=238), Scan(along_y=True, strip_sites=238), Scan(False, strip_sites=1 << 16))

# One size in this many is listed in each order to find the best.
_TRIED_SHARE = 16


def deflate(data: bytes) -> bytearray:
    """Compress to raw deflate data, as a CBLOCK holds them. Other threads run meanwhile."""
    return deflate_compress(data, _DEFLATE_LEVEL)


def best_scan(parts: Sequence[tuple[PillarTile, Stamp]], lattice: Lattice, cell: TileCell) -> Scan:
    """Return the order in which a sample of the sizes, neighbours in the middle of the table, deflates best."""
    count = len(parts[0][1].size_dbu) - 1
    tried = max(1, count // _TRIED_SHARE)
    first = 1 + (count - tried) // 2
    sample = []
    for tile, stamp in parts:
        # One comparison of unsigned numbers: indices below ``first`` wrap around to large numbers.
        index = np.where(tile.size_index - np.uint16(first) < tried, tile.size_index, np.uint16(0))
        if index.any():
            sample.append((PillarTile(tile.row, tile.column, index), stamp))
    if not sample:
        return SCANS[0]
    return min(SCANS, key=lambda scan: len(deflate(pillar_records(sample, lattice, cell, scan))))


def pillar_records(
    parts: Sequence[tuple[PillarTile, Stamp]], lattice: Lattice, cell: TileCell, scan: Scan, *, absolute: bool = False
) -> bytes:
    """Encode the RECTANGLE (or POLYGON) records of a cell, part by part, by size; not yet deflated.

    Args:
        parts: size indices on the sites of one tile, and the rectangle or polygon of each size.
        lattice: pitch of the sites.
        cell: place of the first site.
        scan: order of the places of a size.
        absolute: whether positions are absolute; else each is relative to the record before. Absolute ones are needed
            where other tiles precede in the same cell. The first record states all other modal variables.
    """
    modal, records = np.array([-1, -1, 0, 0], dtype=np.int64), []
    for tile, stamp in parts:
        row, column, end_of = sorted_by_size(tile.size_index, len(stamp.size_dbu), scan)
        points, points_end = _point_lists(stamp)
        # A displacement in a tile takes at most 12 bytes, the head of a record at most 64 and its points.
        out = np.empty(12 * row.size + 64 * len(stamp.size_dbu) + points.size, dtype=np.uint8)
        end = _write_records(
            (row, column, end_of),
            (stamp.size_dbu, stamp.corner_dbu),
            (points, points_end),
            lattice.period_dbu,
            (cell.first_x_dbu, cell.first_y_dbu),
            (stamp.layer, stamp.datatype),
            0 if absolute else 1,
            modal,
            out,
        )
        records.append(out[:end].tobytes())
    return b"".join(records)


def _point_lists(stamp: Stamp) -> tuple[ByteArray, NDArray[np.int64]]:
    """Point lists (type 4, a displacement from each corner to the next) of all sizes, and where each ends.

    Empty for rectangles.
    """
    if stamp.polygons is None:
        return np.empty(0, dtype=np.uint8), np.empty(0, dtype=np.int64)
    lists = [point_list(polygon.tobytes()) for polygon in stamp.polygons]
    return np.frombuffer(b"".join(lists), dtype=np.uint8), np.cumsum([len(one) for one in lists])


@lru_cache(maxsize=1 << 16)
def point_list(polygon: bytes) -> bytes:
    """Point list of one polygon, whose corners are the bytes of an int64 array of shape (n, 2)."""
    steps = np.diff(np.frombuffer(polygon, dtype=np.int64).reshape(-1, 2), axis=0).tolist()
    moves = (elements.unsigned(abs(x) << 2 | (x < 0) << 1 | 1) + elements.signed(y) for x, y in steps)
    return elements.unsigned(4) + elements.unsigned(len(steps)) + b"".join(moves)


@compiled
def _write_records(
    pillars: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]],
    rectangles: tuple[NDArray[np.int64], NDArray[np.int64]],
    polygons: tuple[ByteArray, NDArray[np.int64]],
    period: tuple[int, int],
    first_dbu: tuple[int, int],
    layer_datatype: tuple[int, int],
    relative: int,
    modal: NDArray[np.int64],
    out: ByteArray,
) -> int:
    """Write the records of all sizes to ``out``; return the number of bytes.

    ``modal``, shape (4,), is updated: width, length, x and y of the record before; -1 for none.
    """
    row, column, end_of = pillars
    size_dbu, corner_dbu = rectangles
    points, points_end = polygons
    grid = math.gcd(period[0], period[1])
    step_x, step_y = period[0] // grid, period[1] // grid
    end, here = 0, 0
    for size in range(1, len(size_dbu)):
        stop = end_of[size]
        if stop == here:
            continue
        count = stop - here
        width, length = size_dbu[size, 0], size_dbu[size, 1]
        x = first_dbu[0] + column[here] * period[0] + corner_dbu[size, 0]
        y = first_dbu[1] + row[here] * period[1] + corner_dbu[size, 1]
        info = (_REPETITION if count > 1 else 0) | (DATATYPE_LAYER if here == 0 else 0)
        changed = (W if width != modal[0] else 0) | (H if length != modal[1] else 0)
        info |= POINTS if points.size else changed
        info |= (X if here == 0 or x != modal[2] else 0) | (Y if here == 0 or y != modal[3] else 0)
        end = put(out, put(out, end, POLYGON if points.size else RECTANGLE), info)
        if here == 0:
            end = put(out, put(out, end, layer_datatype[0]), layer_datatype[1])
        if points.size:
            for byte in points[points_end[size - 1] : points_end[size]]:
                out[end] = byte
                end += 1
        else:
            end = put(out, end, width) if info & W else end
            end = put(out, end, length) if info & H else end
        if info & X:
            end = put_signed(out, end, x - relative * modal[2])
        if info & Y:
            end = put_signed(out, end, y - relative * modal[3])
        modal[0], modal[1], modal[2], modal[3] = width, length, x, y
        if count > 1:
            end = put(out, put(out, end, _ARBITRARY_ON_GRID), count - 2)
            end = put(out, end, grid)
        for pillar in range(here + 1, stop):
            right = (column[pillar] - column[pillar - 1]) * step_x
            up = (row[pillar] - row[pillar - 1]) * step_y
            end = _put_displacement(out, end, right, up)
        here = stop
    return end


@compiled
def _put_displacement(out: ByteArray, end: int, right: int, up: int) -> int:
    """Write a g-delta: along x or y alone (form 1), or both (form 2)."""
    if up == 0:
        return put(out, end, abs(right) << 4 | (4 if right < 0 else 0))
    if right == 0:
        return put(out, end, abs(up) << 4 | (6 if up < 0 else 2))
    return put_signed(out, put(out, end, abs(right) << 2 | (right < 0) << 1 | 1), up)
