"""Segments of a part of the window, joined to those of the last frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.film.tracking import ChangedPart, TrackedRegions, planes_around, remeasured, track, without_slivers
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions, SegmentDepth

SHAPE, STEP_PER_M = (40, 60), 0.1
PART, ABOUT = (slice(10, 30), slice(20, 40)), (slice(5, 35), slice(15, 45))
ALL = ChangedPart(PART, ABOUT, np.ones((20, 20), dtype=bool))
ROAD = Plane(2.0, (0.01, 0.0), (20.0, 30.0))
#: Pixels about the part that claim no depth: planes alone tell which segments continue.
UNKNOWN = PixelDepth(np.full((30, 30), np.nan), np.full((30, 30), np.inf), np.zeros((30, 30), dtype=bool))


def regions(label: np.ndarray, *planes: Plane) -> Regions:
    depths = tuple(SegmentDepth(plane.vergence_per_m, 1e-3, 0.9, 1.0, plane, 100.0) for plane in planes)
    label = label.astype(np.int32)
    return Regions(2, depths, label, label.copy(), label.copy())


def street() -> np.ndarray:
    """A road (1), a post that stands on it (2), and a car (3) in the part."""
    label = np.ones(SHAPE, dtype=int)
    label[:, 50:55] = 2
    label[15:25, 25:30] = 3
    return label


def now(car: tuple[slice, slice] | None, *planes: Plane) -> Regions:
    """The part: the road in its own numbers and picture, the car elsewhere, or gone."""
    label = np.full((30, 30), 2)
    if car is not None:
        label[car] = 1
    return regions(label, *planes)


def test_what_goes_on_keeps_its_depth_and_what_moves_has_its_own() -> None:
    last = regions(street(), ROAD, Plane(3.0), Plane(2.5))
    # The road is not as well known from the part: half a step would make it another one.
    poorer = Plane(2.03, (0.01, 0.0), (15.0, 15.0))
    found = now((slice(12, 22), slice(14, 19)), Plane(2.6, (0.0, 0.02), (17.0, 16.5)), poorer)
    tracked = track(last, found, ALL, UNKNOWN, STEP_PER_M)
    both, number = tracked.regions, tracked.number
    assert [depth.vergence_per_m for depth in both.depths] == [2.0, 3.0, 2.6]
    assert both.depths[0] == last.depths[0]
    # In the picture of the whole window.
    assert both.depths[2].plane == Plane(2.6, (0.0, 0.02), (22.0, 31.5))
    want = street()
    want[15:25, 25:30] = 1
    want[17:27, 29:34] = 3
    for label in (both.label, both.interior, both.grown):
        np.testing.assert_array_equal(label, want)
    # The car is a new segment with the number of the one that has gone.
    assert number.tolist() == [0, 1, 2, 0]


def test_pixels_of_a_continuous_surface_keep_their_depth_where_nothing_changed() -> None:
    surface = 2.0 + np.random.default_rng(1).random(SHAPE)
    last = replace(regions(street(), ROAD, Plane(3.0), Plane(2.5)), surface_per_m=surface)
    found = now((slice(12, 22), slice(14, 19)), Plane(2.6), Plane(2.03, (0.01, 0.0), (15.0, 15.0)))
    changed = np.zeros((20, 20), dtype=bool)
    changed[5:] = True
    found.grown[20] = 0  # row 25 of the window: no depth now, but a place at which it is made sharp
    tracked = track(last, found, ChangedPart(PART, ABOUT, changed), UNKNOWN, STEP_PER_M).regions
    new = np.zeros(SHAPE, dtype=bool)
    new[PART] = changed
    new[25] = False
    assert tracked.surface_per_m is not None and np.isnan(tracked.vergence_per_m(tracked.grown)[25, 20:40]).all()
    depth = tracked.surface_per_m
    np.testing.assert_array_equal(depth[~new], surface[~new])
    # What continues keeps the plane of its segment, new segments have their own.
    np.testing.assert_allclose(depth[new], np.where(now_car(), 2.6, ROAD.over(SHAPE))[new])


def now_car() -> np.ndarray:
    """Pixels of the car in its new place, in the whole window."""
    car = np.zeros(SHAPE, dtype=bool)
    car[17:27, 29:34] = True
    return car


def test_another_depth_beside_the_same_pixels_is_another_segment() -> None:
    last = regions(street(), ROAD, Plane(3.0), Plane(2.5))
    found = now(None, Plane(9.0), Plane(2.2))
    tracked = track(last, found, ALL, UNKNOWN, STEP_PER_M)
    both, number = tracked.regions, tracked.number
    # That of which no pixel is left in the part has no number.
    assert [depth.vergence_per_m for depth in both.depths] == [2.0, 3.0, 2.2]
    assert (both.label[PART] == 3).all()
    assert (both.label[:, :20] == 1).all()
    assert number.tolist() == [0, 1, 2, 0]


def measured(vergence_per_m: np.ndarray) -> PixelDepth:
    """Depths of the pixels about the part."""
    error = np.full(vergence_per_m.shape, 1e-3)
    return PixelDepth(vergence_per_m, error, np.ones(vergence_per_m.shape, dtype=bool))


def test_a_segment_whose_pixels_lie_on_a_plane_continues_it_though_its_own_tilt_is_noise() -> None:
    last = regions(street(), ROAD, Plane(3.0), Plane(2.5))
    found = now(None, Plane(9.0), Plane(2.2, (0.05, -0.05), (15.0, 15.0)))
    pixels = measured(ROAD.over(SHAPE)[ABOUT])
    assert len(track(last, found, ALL, UNKNOWN, STEP_PER_M).regions.depths) == 3
    tracked = track(last, found, ALL, pixels, STEP_PER_M).regions
    assert [depth.plane for depth in tracked.depths] == [ROAD, Plane(3.0)]


def test_slivers_in_the_part_join_the_neighbour_that_their_pixels_lie_on() -> None:
    label = street()
    label[15:25, 30:32] = 4  # 20 pixels between car and road: 180 frame pixels
    label[0, :3] = 5  # outside of the part
    last = regions(label, ROAD, Plane(3.0), Plane(2.5), Plane(2.8), Plane(2.4))
    before = TrackedRegions(last, np.arange(6, dtype=np.int32))
    for depth, owner in ((2.5, 3), (2.0, 1)):
        found = without_slivers(before, ALL, measured(np.full((30, 30), depth)), 3)
        assert (found.regions.grown[15:25, 30:32] == owner).all()
        assert not found.regions.interior[15:25, 30:32].any()
        assert (found.regions.label[0, :3] == 4).all()
        assert found.number.tolist() == [0, 1, 2, 3, owner, 4]
        assert [one.vergence_per_m for one in found.regions.depths] == [2.0, 3.0, 2.5, 2.4]
    # On pixels twice as wide it is a segment.
    assert without_slivers(before, ALL, measured(np.full((30, 30), 2.5)), 6) is before


def test_what_has_gone_leaves_no_number_behind() -> None:
    """The car (2) drives away: the post (3) becomes 2 in labels and depths."""
    label = street()
    label = np.where(label == 2, 3, np.where(label == 3, 2, label))
    last = regions(label, ROAD, Plane(2.5), Plane(3.0))
    found = regions(np.ones((30, 30)), Plane(2.0, (0.01, 0.0), (15.0, 15.0)))
    tracked = track(last, found, ALL, UNKNOWN, STEP_PER_M)
    both, number = tracked.regions, tracked.number
    assert [depth.vergence_per_m for depth in both.depths] == [2.0, 3.0]
    assert (both.label[:, 50:55] == 2).all()
    assert set(np.unique(both.label)) == {1, 2}
    assert number.tolist() == [0, 1, 0, 2]


def test_nothing_in_the_part_and_nothing_in_the_last_frame() -> None:
    last = regions(street(), ROAD, Plane(3.0), Plane(2.5))
    tracked = track(last, regions(np.zeros((30, 30))), ALL, UNKNOWN, STEP_PER_M)
    both = tracked.regions
    assert not both.label[PART].any()
    assert len(both.depths) == 2
    nothing = regions(np.zeros(SHAPE))
    tracked = track(nothing, now(None, Plane(9.0), Plane(2.2)), ALL, UNKNOWN, STEP_PER_M)
    both, number = tracked.regions, tracked.number
    assert (both.label[PART] == both.label.max()).all()
    assert both.label[:10].max() == 0
    assert number.tolist() == [0]
    assert planes_around(nothing, ALL, STEP_PER_M) == []


def test_a_part_without_segments_leaves_the_probabilities_of_all_others() -> None:
    """Of a part in the dark no probability is computed: the rest of the frame keeps its own, and so do later frames."""
    last = replace(regions(street(), ROAD, Plane(3.0), Plane(2.5)), right=np.full(SHAPE, 0.7))
    dark = track(last, regions(np.zeros((30, 30))), ALL, UNKNOWN, STEP_PER_M).regions
    want = np.full(SHAPE, 0.7)
    want[PART] = 1.0
    np.testing.assert_array_equal(dark.right, want)
    judged = replace(now(None, Plane(9.0), Plane(2.2)), right=np.full((30, 30), 0.6))
    lit = track(dark, judged, ALL, UNKNOWN, STEP_PER_M)
    want[PART] = 0.6
    np.testing.assert_array_equal(lit.regions.right, want)
    # A film that starts in the dark; and one that is decoded fast, whose segments are not judged.
    started = track(regions(np.zeros(SHAPE)), judged, ALL, UNKNOWN, STEP_PER_M).regions.right
    assert started is not None
    assert (started[PART] == 0.6).all()
    assert track(last, now(None, Plane(9.0), Plane(2.2)), ALL, UNKNOWN, STEP_PER_M).regions.right is None


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), before=st.integers(0, 5), after=st.integers(0, 5))
def test_labels_and_depths_always_belong_together(seed: int, before: int, after: int) -> None:
    rng = np.random.default_rng(seed)
    last = regions(
        rng.integers(0, before + 1, (8, 12)).repeat(5, 0).repeat(5, 1), *(Plane(1.0 + k) for k in range(before))
    )
    found = regions(
        rng.integers(0, after + 1, (6, 6)).repeat(5, 0).repeat(5, 1), *(Plane(1.0 + k) for k in range(after))
    )
    affected = rng.integers(0, 2, (4, 4)).repeat(5, 0).repeat(5, 1).astype(bool)
    tracked = track(last, found, ChangedPart(PART, ABOUT, affected), UNKNOWN, STEP_PER_M)
    both, number = tracked.regions, tracked.number
    outside = np.ones(SHAPE, dtype=bool)
    outside[PART] = ~affected
    one = np.array([np.nan, *(depth.vergence_per_m for depth in both.depths)])
    was = np.array([np.nan, *(depth.vergence_per_m for depth in last.depths)])
    is_now = np.array([np.nan, *(depth.vergence_per_m for depth in found.depths)])
    np.testing.assert_array_equal(one[both.label[outside]], was[last.label[outside]])
    np.testing.assert_array_equal(number[last.label[outside]], both.label[outside])
    # A segment that goes on is at the same depth to within half a step; these differ by more or not at all.
    np.testing.assert_array_equal(one[both.label[~outside]], is_now[found.label[5:25, 5:25][affected]])


def test_known_planes_are_those_around_the_part_in_its_own_picture() -> None:
    last = regions(street(), ROAD, Plane(3.0), Plane(2.5))
    # The car is in the part, the post beyond what lies around it.
    assert planes_around(last, ALL, STEP_PER_M) == [Plane(2.0, (0.01, 0.0), (15.0, 15.0))]


@pytest.mark.parametrize(("pixels", "again"), [(100.0, True), (1900.0, False)])
def test_a_segment_that_has_grown_is_measured_again(pixels: float, again: bool) -> None:
    nodes = np.linspace(1.0, 3.0, 9)
    rho = np.exp(-((nodes - 2.2) ** 2))
    parts = np.stack([0.9 * rho, np.ones(9), np.ones(9)])[:, :, None, None] * np.ones(SHAPE)
    volume = CostVolume(nodes, parts.astype(np.float32), 1.0, 0.1)
    depth = SegmentDepth(2.0, 1e-3, 0.9, 1.0, Plane(2.0), pixels)
    label = np.ones(SHAPE, dtype=np.int32)
    last = Regions(1, (depth,), label, np.where(np.arange(60) < 50, label, 0).astype(np.int32), label)
    got = remeasured(last, volume, 3)
    assert (got is last) == (not again)
    assert got.depths[0].vergence_per_m == pytest.approx(2.2 if again else 2.0, abs=0.01)
    if again:
        assert remeasured(got, volume, 3) is got


@pytest.mark.parametrize(("width", "factor"), [(6, 2.0), (50, 1.0)], ids=["narrow", "wide"])
def test_a_narrow_segment_measured_again_keeps_the_factor_of_a_straight_outline(width: int, factor: float) -> None:
    nodes = np.linspace(1.0, 3.0, 9)
    rho = np.exp(-((nodes - 2.2) ** 2))
    parts = np.stack([0.9 * rho, np.ones(9), np.ones(9)])[:, :, None, None] * np.ones(SHAPE)
    volume = CostVolume(nodes, parts.astype(np.float32), 1.0, 0.1)
    label = np.where((np.arange(60) < width) & (np.arange(40) < 20)[:, None], 1, 0).astype(np.int32)

    def error(of: SegmentDepth) -> float:
        return remeasured(Regions(1, (of,), label, label, label), volume, 3).depths[0].relative_error

    depth = SegmentDepth(2.0, 1e-3, 0.9, 1.0, Plane(2.0), 10.0)
    assert error(replace(depth, error_factor=2.0)) == pytest.approx(factor * error(depth))


def test_a_part_on_a_continuous_surface_takes_its_depths_and_all_else_keeps_its_planes() -> None:
    last = regions(street(), ROAD, Plane(3.0), Plane(2.5))
    planes = last.vergence_per_m(last.grown)
    current = replace(last.within(*ABOUT), surface_per_m=(planes + 0.05)[ABOUT], right=np.full(SHAPE, 0.6)[ABOUT])
    tracked = track(replace(last, right=np.ones(SHAPE)), current, ALL, UNKNOWN, STEP_PER_M).regions
    assert tracked.continuous and tracked.right is not None
    expected = planes.copy()
    expected[PART] += 0.05
    np.testing.assert_allclose(tracked.vergence_per_m(tracked.grown), np.where(tracked.grown > 0, expected, np.nan))
    assert (tracked.right[PART] == 0.6).all()
