"""Tilted segments: planes through cells, and which segments lie on one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.planes import Cells, Plane, distinct_planes, fit_plane, ransac_planes
from metafab.decode.segmentation.segment_depth import segment_depth

NODES = np.linspace(1.5, 3.5, 13)
SHAPE = (96, 120)
#: A picture of cells for RANSAC: side of a cell, rows and columns of cells.
SIDE, ROWS, COLUMNS = 12, 13, 27
SEPARATION_PER_M, ERROR_PER_M = 0.1, 0.01


def volume_of(vergence: np.ndarray, noise: float = 0.0) -> CostVolume:
    """Twins whose correlation is 0.9 at the true vergence and falls as a parabola."""
    rho = 0.9 - 0.4 * (NODES[:, None, None] - vergence) ** 2
    rho = rho + noise * np.random.default_rng(1).normal(size=rho.shape)
    return CostVolume(NODES, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 0.5, 1.0)


def cells_of(vergence: np.ndarray, error: float) -> Cells:
    row, column = (axis.ravel().astype(float) for axis in np.mgrid[5:95:10, 5:115:10])
    count = row.size
    sums, errors = np.zeros((count, 3, 13)), np.full(count, error)
    return Cells(sums, np.full(count, 100.0), row, column, vergence, errors, sums.sum(axis=0), 100 * count)


@settings(max_examples=30, deadline=None)
@given(
    slope=st.tuples(st.floats(-3e-3, 3e-3), st.floats(-3e-3, 3e-3)),
    share=st.floats(0.0, 0.3),
    seed=st.integers(0, 99),
)
def test_a_plane_is_found_beside_another_object(slope: tuple[float, float], share: float, seed: int) -> None:
    """A patch in a corner, where it weighs most, lies elsewhere; what is left scatters as the cells say."""
    plane, error = Plane(2.4, slope, (48.0, 60.0)), 2e-3
    cells = cells_of(np.zeros(99), error)
    rng = np.random.default_rng(seed)
    vergence = plane.at(cells.row, cells.column) + error * rng.normal(size=99)
    patch = np.argsort(cells.row + cells.column)[: int(share * 99)]
    vergence[patch] += 0.1
    found = fit_plane(cells_of(vergence, error))
    rise = np.abs(slope) @ np.array([80.0, 100.0])
    if found is None:
        # Not significant: six standard errors of a slope over 70 cells are 0.01 over the picture.
        assert rise < max(0.05, 2.0 * 5e-3 * 2.4)
        return
    away = found.at(cells.row, cells.column) - plane.at(cells.row, cells.column)
    # Three parameters from 70 cells: their standard error at the corners is below an error of one cell; four of them.
    assert np.abs(away).max() < 4.0 * error


def test_one_depth_is_no_plane() -> None:
    """Of 50 flat segments none is tilted: six standard errors."""
    rng = np.random.default_rng(7)
    for _ in range(50):
        assert fit_plane(cells_of(2.4 + 5e-3 * rng.normal(size=99), 5e-3)) is None
    assert fit_plane(cells_of(np.full(99, 2.4), np.inf)) is None


def test_cells_say_the_depth_of_their_middle() -> None:
    plane = Plane(2.4, (1e-3, -2e-3), (48.0, 60.0))
    volume = volume_of(plane.over(SHAPE))
    cells = Cells.of(volume, np.ones(SHAPE, dtype=bool), 3)
    assert cells.pixels.sum() == SHAPE[0] * SHAPE[1]
    np.testing.assert_allclose(cells.vergence_per_m, plane.at(cells.row, cells.column), atol=1e-4)
    found = fit_plane(cells)
    assert found is not None
    assert found.slope_per_m == pytest.approx(plane.slope_per_m, rel=1e-3)
    # Summed along the plane, the twins agree as well as at one depth, and at the right one.
    depth = segment_depth(volume, cells.sheared(volume, found), cells.pixels.sum(), found)
    assert depth.vergence_per_m == pytest.approx(float(plane.at(*map(np.array, found.centre))), abs=1e-4)
    assert depth.correlation == pytest.approx(0.9, abs=1e-3)
    assert depth.plane.tilted


def test_the_rim_of_the_picture_counts_only_where_there_is_nothing_else() -> None:
    """Cells of 12 compared pixels along the rim lie at another depth."""
    vergence = np.full(SHAPE, 3.0)
    vergence[12:-12, 12:-12] = 2.4
    volume = volume_of(vergence)
    whole = Cells.of(volume, np.ones(SHAPE, dtype=bool), 3)
    assert whole.size == 72 * 96
    assert segment_depth(volume, whole.whole, whole.size).vergence_per_m == pytest.approx(2.4, abs=1e-3)
    assert whole.pixels.sum() == SHAPE[0] * SHAPE[1]  # a tilt is seen best at the rim
    rim = np.zeros(SHAPE, dtype=bool)
    rim[:12] = True
    assert Cells.of(volume, rim, 3).size == rim.sum()


def test_a_segment_that_goes_on_in_its_neighbour_is_no_plane_of_its_own() -> None:
    label = np.zeros((40, 60), dtype=np.int32)
    label[:, :30], label[:, 30:50], label[:, 52:] = 1, 2, 3
    road = Plane(2.4, (0.0, 2e-3), (20.0, 15.0))
    goes_on = Plane(float(road.at(np.array(20.0), np.array(40.0))))
    elsewhere = Plane(3.0)
    assert distinct_planes([road, goes_on, elsewhere], label, 0.08) == [road, elsewhere]
    assert distinct_planes([Plane(2.4), Plane(2.4), elsewhere], label, 0.08) == [Plane(2.4), Plane(2.4), elsewhere]


def grid_of_cells(vergence_per_m: np.ndarray, seed: int, error_per_m: float = ERROR_PER_M) -> Cells:
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
    found = ransac_planes(grid_of_cells(picture, seed), SIDE, SEPARATION_PER_M)
    assert len(found) == 1
    free = picture == over(true)
    assert np.abs(over(found[0]) - over(true))[free].max() < 0.3 * SEPARATION_PER_M


@pytest.mark.parametrize("seed", range(4))
def test_two_planes_are_told_apart(seed: int) -> None:
    wall = Plane(1.8, (0.0, 0.0012), (0.0, 0.0))
    road = Plane(2.1, (0.006, 0.0), (90.0, 0.0))
    picture = np.where(np.arange(ROWS)[:, None] < 8, over(wall), over(road))
    found = ransac_planes(grid_of_cells(picture, seed), SIDE, SEPARATION_PER_M)
    assert len(found) == 2
    for plane, rows in zip(found, (slice(0, 8), slice(8, None)), strict=True):
        np.testing.assert_allclose(over(plane)[rows], picture[rows], atol=0.3 * SEPARATION_PER_M)


@pytest.mark.parametrize("seed", range(4))
def test_flat_objects_side_by_side_are_no_plane(seed: int) -> None:
    steps = np.array([2.0, 2.25, 2.5, 2.75])[np.arange(COLUMNS) * 4 // COLUMNS]
    assert ransac_planes(grid_of_cells(np.broadcast_to(steps, (ROWS, COLUMNS)), seed), SIDE, SEPARATION_PER_M) == []


def test_cells_that_say_nothing_make_no_plane() -> None:
    cells = grid_of_cells(over(Plane(2.0, (0.004, 0.0))), 1, np.inf)
    assert ransac_planes(cells, SIDE, SEPARATION_PER_M) == []
    assert ransac_planes(cells.chosen(np.zeros(cells.row.size, dtype=bool)), SIDE, SEPARATION_PER_M) == []


def test_cells_along_the_rim_count_unless_the_segment_reaches_it() -> None:
    volume = CostVolume(np.linspace(1.0, 3.0, 5), np.ones((3, 5, 120, 120), dtype=np.float32), 0.5, 1.0)
    before_the_rim, beyond = np.zeros((2, 120, 120), dtype=bool)
    before_the_rim[4:116, 4:116] = True
    beyond[4:, 4:116] = True
    assert Cells.of(volume, before_the_rim, 3).size == 112 * 112
    assert Cells.of(volume, beyond, 3).size == 104 * 112  # without the last row of cells, of 12 pixels
