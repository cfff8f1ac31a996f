"""OASIS records of a tile: the compiled encoder writes the bytes that the standard asks for, pillar by pillar."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from metafab.layout import Lattice, PillarTile
from metafab.mask.drawing.cell_writer import Drawing
from metafab.mask.drawing.cells import Stamp, tile_cell
from metafab.mask.drawing.scan import Scan
from metafab.mask.oasis.elements import signed, unsigned
from metafab.mask.oasis.records import SCANS, best_scan, deflate, pillar_records
from metafab.mask.oasis.writer import OasisEncoder

SIZES = np.array([[0, 0], [20, 30], [50, 20], [20, 50], [52, 50], [700, 64]], dtype=np.int64)
# Not centred: any rectangle near a site may be drawn.
CORNERS = np.array([[0, 0], [-10, -15], [-25, -10], [-10, 40], [-26, -25], [-350, -32]], dtype=np.int64)
TILES = arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.integers(0, 5))


def _records(tile: PillarTile, lattice: Lattice, stamp: Stamp, scan: Scan, absolute: bool) -> bytes:
    """RECTANGLE records (20) with explicit fields SWHXYRDL where they differ from the record before."""
    cell, grid = tile_cell(lattice, tile, stamp), math.gcd(*lattice.period_dbu)
    step = np.array(lattice.period_dbu) // grid
    out, before = b"", None
    for size in range(1, len(stamp.size_dbu)):
        rows, columns = np.nonzero(tile.size_index == size)
        if not rows.size:
            continue
        along, across = (rows, columns) if scan.along_y else (columns, rows)
        order = np.lexsort((along, across, along // scan.strip_sites))
        sites = np.stack([columns, rows], axis=1)[order]
        corner = sites[0] * lattice.period_dbu + [cell.first_x_dbu, cell.first_y_dbu] + stamp.corner_dbu[size]
        now = [*stamp.size_dbu[size].tolist(), *corner.tolist()]
        changed = [before is None or value != last for value, last in zip(now, before or now, strict=True)]
        origin = (0, 0) if absolute or before is None else before[2:]
        head = [0b100_0000, 0b10_0000, 0b1_0000, 0b1000]
        info = sum(bit for bit, given in zip(head, changed, strict=True) if given)
        info |= (0b100 if len(sites) > 1 else 0) | (0b11 if before is None else 0)
        out += unsigned(20) + unsigned(info)
        out += unsigned(stamp.layer) + unsigned(stamp.datatype) if before is None else b""
        fields = [unsigned(now[0]), unsigned(now[1]), signed(now[2] - origin[0]), signed(now[3] - origin[1])]
        out += b"".join(value for value, given in zip(fields, changed, strict=True) if given)
        if len(sites) > 1:
            out += unsigned(11) + unsigned(len(sites) - 2) + unsigned(grid)
            out += b"".join(_displacement(*move) for move in (np.diff(sites, axis=0) * step).tolist())
        before = now
    return out


def _displacement(x: int, y: int) -> bytes:
    """A g-delta: form 1 along an axis (east 0, north 1, west 2, south 3), else form 2."""
    if x == 0 or y == 0:
        direction = (0 if x >= 0 else 2) if y == 0 else (1 if y > 0 else 3)
        return unsigned(abs(x + y) << 4 | direction << 1)
    return unsigned(abs(x) << 2 | (x < 0) << 1 | 1) + signed(y)


@given(
    index=TILES.filter(np.any),
    row=st.integers(0, 300),
    periods=st.sampled_from([(700, 700), (700, 600)]),
    scan=st.builds(Scan, along_y=st.booleans(), strip_sites=st.integers(1, 50)),
    absolute=st.booleans(),
)
def test_records_are_those_of_the_standard(
    index: np.ndarray, row: int, periods: tuple[int, int], scan: Scan, absolute: bool
) -> None:
    lattice, tile, stamp = (
        Lattice(period_dbu=periods, shape=(400, 400), database_unit_nm=0.5),
        PillarTile(row, 17, index),
        Stamp(SIZES, CORNERS, 1, 300),
    )
    compiled = pillar_records([(tile, stamp)], lattice, tile_cell(lattice, tile, stamp), scan, absolute=absolute)
    assert compiled == _records(tile, lattice, stamp, scan, absolute)


@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("shape", [(476, 300), (239, 714), (40, 238)])
def test_records_of_tiles_wider_than_a_strip(shape: tuple[int, int], scan: Scan) -> None:
    index = np.random.default_rng(7).integers(0, 6, shape).astype(np.uint16)
    lattice, tile, stamp = (
        Lattice(period_dbu=(700, 600), shape=(800, 800), database_unit_nm=0.5),
        PillarTile(3, 17, index),
        Stamp(SIZES, CORNERS, 1, 0),
    )
    compiled = pillar_records([(tile, stamp)], lattice, tile_cell(lattice, tile, stamp), scan)
    assert compiled == _records(tile, lattice, stamp, scan, absolute=False)


@pytest.mark.parametrize("centre", [(0, 0), (0, 1900), (1900, 0), (1300, 1300), (2400, 600), (600, 2400)])
def test_the_better_scan_is_found_from_few_sizes(centre: tuple[int, int]) -> None:
    """At the last centre the worse of the two scans takes a third more."""
    tile, lattice, stamp = _tile_of_a_lens(centre)
    arguments = ([(tile, stamp)], lattice, tile_cell(lattice, tile, stamp))
    lengths = {scan: len(deflate(pillar_records(*arguments, scan))) for scan in SCANS}
    assert lengths[best_scan(*arguments)] < 1.06 * min(lengths.values())


def test_dose_classes_of_a_tile_share_a_cell_and_a_block() -> None:
    """One class for a few pillars of a size: deflated together they take 0.88 of what each takes by itself."""
    tile, lattice, stamp = _tile_of_a_lens((0, 1900))
    away = np.hypot(*np.indices(tile.size_index.shape)).astype(int) // 11
    classes = np.clip(away + np.random.default_rng(7).integers(-1, 2, away.shape), 0, 63)
    parts = []
    for number in range(64):
        part = replace(tile, size_index=np.where(classes == number, tile.size_index, np.uint16(0)))
        parts.append((part, replace(stamp, datatype=number)))
    encoder = OasisEncoder(Drawing(lattice, "T"))
    (joined,), apart = encoder(parts), [encoder([part])[0] for part in parts]
    assert {one.cell for one in apart} == {joined.cell}
    assert joined.content[0].size < 0.9 * sum(one.content[0].size for one in apart)


def _tile_of_a_lens(centre: tuple[int, int]) -> tuple[PillarTile, Lattice, Stamp]:
    """Tile of a lens that splits along x, at sites from its axis."""
    sizes = np.array([[0, 0], *([200 + 4 * w, 200 + 4 * k] for w in range(40) for k in range(40))], dtype=np.int64)
    row, column = (np.arange(-238, 238) + at for at in centre)
    lens = -7.7e-6 * (column[None, :] ** 2 + row[:, None] ** 2)
    width, length = (np.floor((lens + turn * column) % 1.0 * 40).astype(np.int64) for turn in (0.061, -0.061))
    lattice, stamp = (
        Lattice(period_dbu=(700, 700), shape=(5714, 5714), database_unit_nm=0.5),
        Stamp(sizes, -(sizes // 2), 1, 0),
    )
    return PillarTile(0, 0, (1 + 40 * width + length).astype(np.uint16)), lattice, stamp
