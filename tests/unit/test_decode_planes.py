"""Tilted segments: planes through cells, and which segments lie on one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Cells, Plane, distinct_planes, fitted_plane
from metafab.decode.segmentation.regions import Regions, _planes, layer_step_per_m
from metafab.decode.segmentation.segment import SegmentDepth, segment_depth

NODES = np.linspace(1.5, 3.5, 13)
SHAPE = (96, 120)


def volume_of(vergence: np.ndarray, noise: float = 0.0) -> Volume:
    """Twins whose correlation is 0.9 at the true vergence and falls as a parabola."""
    rho = 0.9 - 0.4 * (NODES[:, None, None] - vergence) ** 2
    rho = rho + noise * np.random.default_rng(1).normal(size=rho.shape)
    return Volume(NODES, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 0.5, 1.0)


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
    found = fitted_plane(cells_of(vergence, error))
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
        assert fitted_plane(cells_of(2.4 + 5e-3 * rng.normal(size=99), 5e-3)) is None
    assert fitted_plane(cells_of(np.full(99, 2.4), np.inf)) is None


def test_cells_say_the_depth_of_their_middle() -> None:
    plane = Plane(2.4, (1e-3, -2e-3), (48.0, 60.0))
    volume = volume_of(plane.over(SHAPE))
    cells = Cells.of(volume, np.ones(SHAPE, dtype=bool), 3)
    assert cells.pixels.sum() == SHAPE[0] * SHAPE[1]
    np.testing.assert_allclose(cells.vergence_per_m, plane.at(cells.row, cells.column), atol=1e-4)
    found = fitted_plane(cells)
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


def test_bands_of_a_tilted_segment_hold_its_depth() -> None:
    label = np.ones((40, 60), dtype=np.int32)
    label[:, 40:] = 2
    road, wall = Plane(2.4, (5e-3, 0.0), (20.0, 20.0)), Plane(3.0)
    depths = tuple(SegmentDepth(p.vergence_per_m, 1e-3, 0.9, 1.0, p) for p in (road, wall))
    regions = Regions(2, depths, label, label, label)
    bands, vergence = regions.bands(label, 0.04)
    assert np.abs(vergence[bands - 1] - regions.vergence_per_m(label)).max() <= 0.02 + 1e-12
    assert vergence.size == 7  # 0.2 over 40 rows, and the wall
    flat = Regions(1, depths[1:], label, label, label)
    np.testing.assert_array_equal(flat.bands(label, 0.04)[0], label)


def test_stripes_of_one_surface_become_a_plane_and_what_stands_before_it_stays() -> None:
    surface = Plane(2.4, (6e-3, 1e-3), (48.0, 60.0))
    picture = surface.over(SHAPE).copy()
    picture[30:70, 70:100] = 3.2
    volume = volume_of(picture, noise=1e-3)
    step = layer_step_per_m(volume)
    stripes = np.unique(np.round(picture / (2.0 * step)), return_inverse=True)
    label = (stripes[1].reshape(SHAPE) + 1).astype(np.int32)
    depths = tuple(
        SegmentDepth(float(at), 1e-3, 0.9, 1.0, Plane(float(at))) for at in stripes[0].astype(float) * 2.0 * step
    )
    everywhere = np.ones(SHAPE, dtype=bool)
    pixels = PixelDepth(picture, np.full(SHAPE, 2e-3), everywhere)
    planes = _planes(everywhere, 3, volume, pixels, Regions(len(depths), depths, label, label, label))
    assert len(depths) > 4
    assert len(planes) == 2
    assert np.abs(planes[0].over(SHAPE) - surface.over(SHAPE)).max() < 0.3 * step
    assert not planes[1].tilted
    assert planes[1].vergence_per_m == pytest.approx(3.2, abs=step)
