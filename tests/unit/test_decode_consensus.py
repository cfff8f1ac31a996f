"""Tilted planes that cells all over a picture agree on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.segmentation.consensus import spanning_planes
from metafab.decode.segmentation.planes import Cells, Plane

SIDE, ROWS, COLUMNS = 12, 13, 27
SEPARATION_PER_M, ERROR_PER_M = 0.1, 0.01


def cells_of(vergence_per_m: np.ndarray, seed: int, error_per_m: float = ERROR_PER_M) -> Cells:
    """A cell at each place of a picture (ROWS, COLUMNS), with noise of its error."""
    row, column = ((axis.ravel() + 0.5) * SIDE for axis in np.mgrid[:ROWS, :COLUMNS].astype(float))
    noise = error_per_m * np.random.default_rng(seed).standard_normal(row.size)
    sums, pixels = np.zeros((row.size, 3, 13)), np.full(row.size, float(SIDE**2))
    errors = np.full(row.size, error_per_m)
    return Cells(sums, pixels, row, column, vergence_per_m.ravel() + noise, errors, sums.sum(axis=0), int(pixels.sum()))


def over(plane: Plane) -> np.ndarray:
    return plane.over((ROWS * SIDE, COLUMNS * SIDE))[SIDE // 2 :: SIDE, SIDE // 2 :: SIDE]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), rise=st.floats(0.3, 1.2), turn=st.floats(0.0, 6.28))
def test_a_plane_is_found_whatever_lies_before_it(seed: int, rise: float, turn: float) -> None:
    slope = rise / (ROWS * SIDE)
    true = Plane(2.2, (slope * np.sin(turn), slope * np.cos(turn)), (ROWS * SIDE / 2, COLUMNS * SIDE / 2))
    picture = over(true).copy()
    picture[2:11, 8:12] = 4.0  # a post
    picture[9:, 20:] = 3.4  # a box
    found = spanning_planes(cells_of(picture, seed), SIDE, SEPARATION_PER_M)
    assert len(found) == 1
    free = picture == over(true)
    assert np.abs(over(found[0]) - over(true))[free].max() < 0.3 * SEPARATION_PER_M


@pytest.mark.parametrize("seed", range(4))
def test_two_planes_are_told_apart(seed: int) -> None:
    wall = Plane(1.8, (0.0, 0.0012), (0.0, 0.0))
    road = Plane(2.1, (0.006, 0.0), (90.0, 0.0))
    picture = np.where(np.arange(ROWS)[:, None] < 8, over(wall), over(road))
    found = spanning_planes(cells_of(picture, seed), SIDE, SEPARATION_PER_M)
    assert len(found) == 2
    for plane, rows in zip(found, (slice(0, 8), slice(8, None)), strict=True):
        np.testing.assert_allclose(over(plane)[rows], picture[rows], atol=0.3 * SEPARATION_PER_M)


@pytest.mark.parametrize("seed", range(4))
def test_flat_objects_side_by_side_are_no_plane(seed: int) -> None:
    steps = np.array([2.0, 2.25, 2.5, 2.75])[np.arange(COLUMNS) * 4 // COLUMNS]
    assert spanning_planes(cells_of(np.broadcast_to(steps, (ROWS, COLUMNS)), seed), SIDE, SEPARATION_PER_M) == []


def test_cells_that_say_nothing_make_no_plane() -> None:
    cells = cells_of(over(Plane(2.0, (0.004, 0.0))), 1, np.inf)
    assert spanning_planes(cells, SIDE, SEPARATION_PER_M) == []
    assert spanning_planes(cells.chosen(np.zeros(cells.row.size, dtype=bool)), SIDE, SEPARATION_PER_M) == []
