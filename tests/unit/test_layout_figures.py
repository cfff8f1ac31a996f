"""Figures of a tile: the compiled sums, the vectorised ones and plain definitions agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.layout.figures import TileFigures, compare, compare_vectorised
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
def test_compiled_and_vectorised_agree(table: SizeTable, seed: int, rows: int, columns: int) -> None:
    """The polynomials err by less than 1e-12 and 3000 rad wrap to 1e-12: 360 terms of size 1.25 to 1e-9."""
    block = _block(table, seed, (rows, columns))
    for compiled, vectorised in zip(compare(*block, table), compare_vectorised(*block, table), strict=True):
        assert compiled == pytest.approx(vectorised, rel=0.0, abs=1e-9)


def test_sums_are_those_of_the_fields(table: SizeTable) -> None:
    size_index, target_rad = _block(table, 7, (12, 30))
    figures = TileFigures.of(size_index, target_rad, table, 100.0)
    filled = size_index > 0
    t = table.t[size_index[filled]].T
    assert figures.pillars == np.count_nonzero(filled)
    assert figures.power == pytest.approx(np.sum(np.abs(t) ** 2, axis=1), rel=1e-12)
    assert figures.overlap == pytest.approx(np.sum(t * np.exp(-1j * target_rad[:, filled]), axis=1), abs=1e-9)
    assert figures.used[0] == 0
    assert figures.used.sum() == figures.pillars


def test_two_halves_add_up_to_the_whole(table: SizeTable) -> None:
    size_index, target_rad = _block(table, 3, (10, 20))
    whole = TileFigures.of(size_index, target_rad, table, 80.0)
    halves = [
        TileFigures.of(size_index[rows], target_rad[:, rows], table, gap)
        for rows, gap in ((slice(0, 4), 80.0), (slice(4, 10), 90.0))
    ]
    total = halves[0] + halves[1]
    assert (total.pillars, total.smallest_gap_dbu) == (whole.pillars, whole.smallest_gap_dbu)
    assert np.array_equal(total.used, whole.used)
    for name in ("overlap", "power", "square_error"):
        assert getattr(total, name) == pytest.approx(getattr(whole, name), abs=1e-9)


def test_an_empty_block_adds_nothing(table: SizeTable) -> None:
    figures = TileFigures.of(np.zeros((3, 4), dtype=np.uint16), np.ones((2, 3, 4)), table, np.inf)
    assert figures.pillars == 0
    assert not figures.overlap.any()
    assert not figures.power.any()
    assert not figures.square_error.any()
