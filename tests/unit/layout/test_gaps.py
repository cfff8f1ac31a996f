"""Gaps between neighbours: the compiled kernels agree with NumPy and with Shapely."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shapely.geometry import box

from metafab.layout import Lattice, smallest_gap
from tests.gaps_by_numpy import gaps_by_numpy

LATTICE = Lattice(period_dbu=(70, 60), shape=(6, 7), database_unit_nm=5.0)
SIZES = np.array([[0, 0], [20, 20], [50, 20], [20, 50], [50, 50], [70, 60]], dtype=np.int32)
BLOCKS = arrays(np.uint16, (6, 7), elements=st.integers(0, len(SIZES) - 1))


def _by_shapely(block: np.ndarray, limit: float) -> tuple[float, int, int]:
    """Smallest distance, pairs below the limit, pairs that touch, among all pairs of the block."""
    rows, columns = np.nonzero(block)
    pillars = [
        box(70 * c - w / 2, 60 * r - h / 2, 70 * c + w / 2, 60 * r + h / 2)
        for r, c in zip(rows, columns, strict=True)
        for w, h in [SIZES[block[r, c]]]
    ]
    distances = [a.distance(b) for i, a in enumerate(pillars) for b in pillars[:i]]
    return min(distances, default=np.inf), sum(d < limit for d in distances), sum(d == 0.0 for d in distances)


@given(block=BLOCKS, limit=st.sampled_from([15.0, 20.0, 31.0, 40.0]))
def test_all_pairs_are_judged_as_by_plain_geometry(block: np.ndarray, limit: float) -> None:
    found = smallest_gap(block, SIZES, LATTICE, limit)
    smallest, below, touching = _by_shapely(block, limit)
    assert (found.below, found.overlapping) == (below, touching)
    assert len(found.too_small) == below
    if smallest < min(LATTICE.period_dbu):  # beyond, the nearest pair need not be neighbours
        # Shapely's distance is a rounded root, ours the root of an exact square.
        assert max(found.smallest_dbu, 0.0) == pytest.approx(smallest, rel=1e-15)


@given(block=BLOCKS, limit=st.sampled_from([-1.0, 20.0, 31.0]), rows=st.integers(1, 6))
def test_compiled_and_vectorised_agree(block: np.ndarray, limit: float, rows: int) -> None:
    compiled = smallest_gap(block, SIZES, LATTICE, limit, rows)
    vectorised = gaps_by_numpy(block, SIZES, LATTICE, limit, rows)
    assert compiled.smallest_dbu == vectorised.smallest_dbu
    assert (compiled.below, compiled.overlapping) == (vectorised.below, vectorised.overlapping)
    assert np.array_equal(compiled.too_small, vectorised.too_small)
    assert np.array_equal(compiled.neighbour, vectorised.neighbour)


@given(block=BLOCKS, cut=st.integers(1, 5))
def test_bands_see_every_pair_once(block: np.ndarray, cut: int) -> None:
    whole = smallest_gap(block, SIZES, LATTICE, 31.0)
    below = smallest_gap(block[: cut + 1], SIZES, LATTICE, 31.0, cut)
    above = smallest_gap(block[cut:], SIZES, LATTICE, 31.0)
    assert whole.below == below.below + above.below
    assert whole.smallest_dbu == min(below.smallest_dbu, above.smallest_dbu)


@pytest.mark.parametrize(("pair", "gap"), [(0, 20.0), (1, 10.0), (2, np.hypot(20, 10)), (3, np.hypot(20, 10))])
def test_each_kind_of_neighbour_is_seen(pair: int, gap: float) -> None:
    block = np.zeros((2, 3), dtype=np.uint16)
    down, right = LATTICE.pairs[pair]
    block[0, 1] = block[down, 1 + right] = 4
    found = smallest_gap(block, SIZES, LATTICE, gap + 1e-9)
    assert found.smallest_dbu == pytest.approx(gap, rel=1e-15)
    assert (found.too_small.tolist(), found.neighbour.tolist()) == ([1], [pair])
    assert smallest_gap(block, SIZES, LATTICE, gap - 1e-9).below == 0
