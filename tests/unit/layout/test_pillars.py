"""Pillars of other sizes at the sites of a mask."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.layout import Lattice, PillarMap
from metafab.layout.pillars import bands, resized


def lens(shape: tuple[int, int] = (600, 40)) -> PillarMap:
    """Three sizes, and sites without a pillar."""
    index = np.random.default_rng(2).integers(0, 4, shape).astype(np.uint16)
    table = np.array([(0, 0), (200, 300), (240, 240), (300, 200)], dtype=np.int32)
    return PillarMap.from_array(Lattice(period_dbu=(700, 700), shape=shape, database_unit_nm=0.5), table, index, 64)


def test_sizes_are_rounded_and_sites_kept() -> None:
    """One band is 512 rows; half a nanometre is the unit."""
    pillars = lens()
    rng = np.random.default_rng(3)
    wanted = rng.uniform(80.0, 200.0, (2, *pillars.lattice.shape))
    new = resized(pillars, lambda rows: wanted[:, rows])
    stand = pillars.to_array() > 0
    assert np.array_equal(new.to_array() > 0, stand)
    error = np.moveaxis(new.size_nm()[new.to_array()], -1, 0) - wanted
    assert np.abs(error[:, stand]).max() <= 0.25
    assert [band.start for band in bands(pillars.to_array())] == [0, 512]


def test_what_is_not_printed_is_missing_and_nothing_exceeds_its_cell() -> None:
    pillars = lens((3, 3))

    def sizes(rows: slice) -> FloatArray:
        found = np.full((2, 3, 3), 100.0)
        found[0, 0, :] = np.nan
        found[1, 1, :] = -5.0
        found[:, 2, :] = 1e4
        return found[:, rows]

    new = resized(pillars, sizes)
    assert not new.to_array()[:2].any()
    assert new.size_nm().max() == 350.0


def test_steps_are_doubled_until_the_sizes_fit() -> None:
    """700 x 700 sizes in steps of half a nanometre do not fit; 350 x 350 do not; 175 x 175 do."""
    side = 700
    lattice = Lattice(period_dbu=(700, 700), shape=(side, side), database_unit_nm=0.5)
    pillars = PillarMap.from_array(lattice, np.array([(0, 0), (2, 2)], np.int32), np.ones((side, side), np.uint16), 64)
    width, length = np.meshgrid(0.5 * np.arange(1, side + 1), 0.5 * np.arange(1, side + 1))
    wanted = np.stack([width, length])
    new = resized(pillars, lambda rows: wanted[:, rows])
    assert set(np.unique(new.size_dbu % 4)) == {0}
    assert len(new.size_dbu) <= 65536
    stand = new.to_array() > 0
    error = np.moveaxis(new.size_nm()[new.to_array()], -1, 0) - wanted
    assert np.abs(error[:, stand]).max() <= 1.0
    # Widths and lengths of 0.5 and 1 nm vanish: half a step of 2 nm and less.
    assert np.count_nonzero(~stand) < 4 * side
