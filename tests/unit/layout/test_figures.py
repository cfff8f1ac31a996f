"""Sums over a tile: the compiled kernel agrees with NumPy, and the sums of parts add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.core.conventions import wrap_phase
from metafab.layout.figures import TileSums
from metafab.library import Library, SizeTable, build_size_table


@pytest.fixture(scope="module")
def table(smooth_library: Library) -> SizeTable:
    return build_size_table(smooth_library, database_unit_nm=0.5, cells=16)


def _block(table: SizeTable, seed: int, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Random sizes, some sites empty, and random targets of many turns."""
    random = np.random.default_rng(seed)
    size_index = random.integers(0, len(table.size_dbu), shape, dtype=np.uint16)
    size_index[random.random(shape) < 0.3] = 0
    return size_index, random.uniform(-3000.0, 3000.0, (2, *shape))


@given(seed=st.integers(0, 10**6), rows=st.integers(1, 9), columns=st.integers(1, 40))
def test_compiled_sums_agree_with_numpy(table: SizeTable, seed: int, rows: int, columns: int) -> None:
    """The polynomials err by less than 1e-12 and 3000 rad wrap to 1e-12: 360 terms of size 1.25 to 1e-9."""
    size_index, target_rad = _block(table, seed, (rows, columns))
    sums = TileSums.of(size_index, target_rad, table, np.inf)
    filled = size_index > 0
    t = table.t[size_index[filled]].T
    error = wrap_phase(np.angle(t) - target_rad[:, filled])
    assert sums.overlap == pytest.approx(np.sum(np.abs(t) * np.exp(1j * error), axis=1), rel=0.0, abs=1e-9)
    assert sums.square_error == pytest.approx(np.sum(error**2, axis=1), rel=0.0, abs=1e-9)


def test_sums_are_those_of_the_fields(table: SizeTable) -> None:
    size_index, target_rad = _block(table, 7, (12, 30))
    sums = TileSums.of(size_index, target_rad, table, 100.0)
    filled = size_index > 0
    t = table.t[size_index[filled]].T
    assert sums.pillars == np.count_nonzero(filled)
    assert sums.power == pytest.approx(np.sum(np.abs(t) ** 2, axis=1), rel=1e-12)
    assert sums.overlap == pytest.approx(np.sum(t * np.exp(-1j * target_rad[:, filled]), axis=1), abs=1e-9)
    assert sums.used[0] == 0
    assert sums.used.sum() == sums.pillars


def test_two_halves_add_up_to_the_whole(table: SizeTable) -> None:
    size_index, target_rad = _block(table, 3, (10, 20))
    whole = TileSums.of(size_index, target_rad, table, 80.0)
    halves = [
        TileSums.of(size_index[rows], target_rad[:, rows], table, gap)
        for rows, gap in ((slice(0, 4), 80.0), (slice(4, 10), 90.0))
    ]
    total = halves[0] + halves[1]
    assert (total.pillars, total.smallest_gap_dbu) == (whole.pillars, whole.smallest_gap_dbu)
    assert np.array_equal(total.used, whole.used)
    for name in ("overlap", "power", "square_error"):
        assert getattr(total, name) == pytest.approx(getattr(whole, name), abs=1e-9)


def test_an_empty_block_adds_nothing(table: SizeTable) -> None:
    """As a sample of the light among neighbours it tells nothing of the others."""
    sums = TileSums.of(np.zeros((3, 4), dtype=np.uint16), np.ones((2, 3, 4)), table, np.inf)
    assert sums.pillars == 0
    assert not sums.overlap.any()
    assert not sums.power.any()
    assert not sums.square_error.any()
    whole = TileSums.of(*_block(table, 5, (4, 6)), table, np.inf)
    none = np.zeros((2, 2))
    sample = replace(sums, among=none.astype(complex), among_power=none, among_square_error=np.zeros(2))
    assert whole.with_light_of(sample) is whole
