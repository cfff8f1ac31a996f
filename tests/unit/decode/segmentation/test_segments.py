"""Connected segments, their interiors, texture and fragments."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import binary_opening
from scipy.special import ndtri

from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import (
    Regions,
    SegmentDepth,
    connected_segments,
    depth_layers,
    fragment_targets,
    grown,
    interior,
    is_textured,
    opened,
    with_error_of_straight,
)

#: A wall, a strip along its side, and an object that hides some of both.
LABEL = np.ones((60, 80), dtype=np.int32)
LABEL[:, :6] = 2
LABEL[20:50, 30:60] = 3
#: Frame pixels of a pixel there by which the strip is too wide to be one of the picture's rim.
COARSE = 8


def test_the_mixture_along_an_outline_is_no_segment_of_its_own() -> None:
    layer = np.ones((60, 90), dtype=np.int32)
    layer[:, 45:] = 2
    layer[10:30, 40:50] = 3  # 200 pixels of every second: 800 of the frame, just a window
    lit = np.ones(layer.shape, dtype=bool)
    assert connected_segments(layer, lit, 32, 2).max() == 2
    assert connected_segments(np.where(layer == 3, 3, 0), lit, 32, 2).max() == 1  # by itself it is one


def test_growth_stops_at_its_reach() -> None:
    segment = np.zeros((9, 9), dtype=np.int32)
    segment[4, 4] = 7
    assert (grown(segment, 2.0) > 0).sum() == 13
    assert not grown(np.zeros((9, 9), dtype=np.int32), 2.0).any()


def test_texture_at_the_outline_alone_is_none() -> None:
    region = np.zeros((60, 60), dtype=bool)
    region[5:55, 5:55] = True
    outline = region.copy()
    outline[15:45, 15:45] = False
    assert not is_textured(region, outline, 10)
    assert is_textured(region, region, 10)
    assert is_textured(region, outline, 30)  # too small to have an inside


def test_the_inside_of_a_segment_keeps_away_from_other_depths_alone() -> None:
    segment = np.zeros((120, 120), dtype=np.int32)
    segment[10:110, 10:60], segment[10:110, 60:110] = 1, 2
    inner = interior(segment, 1, 1)
    assert inner[10, 10]  # beside darkness
    assert not inner[:, 36:].any()  # 24 pixels from the other depth
    assert inner[10:110, 10:36].all()
    segment[:, :57] = 0  # too narrow for a distance of 24, or of anything
    np.testing.assert_array_equal(interior(segment, 1, 1), segment == 1)


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_opened_masks_are_those_of_scipy(steps: int) -> None:
    mask = np.random.default_rng(steps).random((31, 47)) < 0.93
    given = mask.copy()
    assert (opened(mask, steps) == binary_opening(mask, iterations=steps)).all()
    assert (mask == given).all()


def depth(vergence_per_m: float, relative_error: float, slope: tuple[float, float] = (0.0, 0.0)) -> SegmentDepth:
    return SegmentDepth(vergence_per_m, relative_error, 0.95, 1.0, Plane(vergence_per_m, slope, (30.0, 40.0)), 100.0)


@pytest.mark.parametrize(("away", "joins"), [(0.0, True), (2.0, True), (-2.0, True), (3.0, False), (-3.0, False)])
def test_a_strip_joins_what_it_does_not_differ_from(away: float, joins: bool) -> None:
    """By its own standard errors: 1 % here."""
    depths = [depth(3.0, 1e-3), depth(3.0 / (1.0 + 0.01 * away), 0.01), depth(3.8, 1e-3)]
    np.testing.assert_array_equal(fragment_targets(depths, LABEL, COARSE), [0, 1, 1 if joins else 2, 3])


@pytest.mark.parametrize(("vergence", "width", "target"), [(3.1, 6, 1), (2.9, 6, 1), (3.3, 6, 2), (3.1, 18, 2)])
def test_a_strip_along_the_rim_joins_what_is_within_4_per_cent(vergence: float, width: int, target: int) -> None:
    """30 frame pixels wide at most, here 15 downsampled ones; its stated error and its tilt do not count."""
    label = np.ones((80, 120), dtype=np.int32)
    label[:, -width:] = 2
    label[40, -width - 5 :] = 2  # a spur
    strip = depth(vergence, 1e-4, (0.0, 1e-3))
    strip = dataclasses.replace(strip, plane=dataclasses.replace(strip.plane, centre=(40.0, 118.0)))
    assert fragment_targets([depth(3.0, 1e-4), strip], label, 2).tolist() == [0, 1, target]


@pytest.mark.parametrize("rows", [slice(30, 42), slice(0, 12)])
def test_an_object_at_the_rim_is_no_strip(rows: slice) -> None:
    """24 x 24 frame pixels, 3.3 % before the wall."""
    label = np.ones((80, 120), dtype=np.int32)
    label[rows, -12:] = 2
    assert fragment_targets([depth(3.0, 1e-4), depth(3.1, 1e-4)], label, 2).tolist() == [0, 1, 2]


def test_a_small_picture_has_no_strips() -> None:
    label = np.ones((20, 40), dtype=np.int32)
    label[:, -6:] = 2
    assert fragment_targets([depth(3.0, 1e-4), depth(3.1, 1e-4)], label, 2).tolist() == [0, 1, 2]


def test_what_is_not_beside_it_is_no_neighbour() -> None:
    depths = [depth(3.0, 1e-3), depth(3.8, 0.01), depth(3.8, 1e-3)]
    np.testing.assert_array_equal(fragment_targets(depths, LABEL, COARSE), [0, 1, 2, 3])


def test_halves_stay_apart() -> None:
    label = np.ones((40, 40), dtype=np.int32)
    label[:, 20:] = 2
    np.testing.assert_array_equal(fragment_targets([depth(3.0, 0.01), depth(3.0, 0.01)], label, COARSE), [0, 1, 2])


def test_a_tilted_neighbour_is_met_where_the_strip_is() -> None:
    """The strip's middle is 37.5 columns left of the plane's."""
    wall = depth(3.0, 1e-3, (0.0, 0.01))
    there = float(wall.plane.at(np.array(29.5), np.array(2.5)))
    for vergence, joins in ((there, True), (3.0, False)):
        depths = [wall, depth(vergence, 0.01), depth(3.8, 1e-3)]
        np.testing.assert_array_equal(fragment_targets(depths, LABEL, COARSE), [0, 1, 1 if joins else 2, 3])


def test_a_strip_of_a_strip_joins_what_that_has_fragment_targets() -> None:
    label = LABEL.copy()
    label[:4, :4] = 4
    label[:4, 4:6] = 2
    label[4:5, :2] = 2
    depths = [depth(3.0, 1e-3), depth(3.0, 0.01), depth(3.8, 1e-3), depth(3.0, 0.02)]
    assert fragment_targets(depths, label, COARSE).tolist() == [0, 1, 1, 3, 1]


def test_nothing_joins_nothing() -> None:
    assert fragment_targets([], np.zeros((5, 5), dtype=np.int32), COARSE).tolist() == [0]


def test_pixels_along_a_straight_line_are_no_independent_samples() -> None:
    rng, mask = np.random.default_rng(1), np.zeros((40, 60), dtype=bool)
    mask[10:22, 5:55] = True
    row, column = np.mgrid[:40, :60]
    depth = SegmentDepth(300.0, 1e-3, 0.99, 1.0, Plane(300.0), float(mask.sum()))

    def error(light: np.ndarray) -> float:
        return with_error_of_straight(depth, light.astype(np.float32), mask, 0.8).relative_error

    texture = 1000.0 + 100.0 * rng.normal(size=mask.shape)
    assert error(texture) == depth.relative_error
    level = 1000.0 + 900.0 * np.tanh((row - 15.5) / 1.5)
    turned = 1000.0 + 900.0 * np.tanh((0.8 * (row - 15.5) + 0.6 * (column - 30.0)) / 1.5)
    # 600 pixels of 0.8 samples; the gradient of a tanh of 1.5 px falls on 4.5 rows: (600 x 0.8 / 4.5)^0.5 = 10.3.
    assert 8e-3 < error(level) < 13e-3
    assert error(turned) > 5e-3
    # Many lines beside each other are many samples.
    stripes = 1000.0 + 900.0 * np.sin(row * 1.1)
    assert error(stripes) < 0.75 * error(level)


def test_the_pixels_of_a_segment_left_out_go_to_its_neighbours() -> None:
    depths = tuple(SegmentDepth(1.0 / z, 0.01, 0.9, 1.0, Plane(1.0 / z)) for z in (0.6, 0.3, 0.4))
    inside = np.where(LABEL == 2, 0, LABEL).astype(np.int32)
    regions = Regions(3, depths, LABEL, inside, LABEL)
    others = regions.without([1])
    assert [1.0 / depth.vergence_per_m for depth in others.depths] == pytest.approx([0.3, 0.4])
    for picture in (others.label, others.grown):
        assert (picture[:, :6] == 1).all() and (picture[20:50, 30:60] == 2).all()
        assert (picture[LABEL == 1] > 0).all() and picture[0, 10] == 1 and picture[35, 65] == 2
    assert np.array_equal(others.interior > 0, LABEL == 3)
    assert regions.without([]) is regions


@pytest.mark.parametrize("nearest", [2.9, 2.93, 2.96])
def test_layers_lie_between_the_bins_of_the_histogram(nearest: float) -> None:
    """The bins follow the extreme depths: at their middles, a layer moved by up to half a bin of 0.025 / m."""
    vergence = 2.0 + 0.03 * ndtri((np.arange(3600) + 0.5) / 3600).reshape(60, 60)
    vergence[0, 0] = nearest
    pixels = PixelDepth(vergence, np.full(vergence.shape, 0.003), np.ones(vergence.shape, dtype=bool))
    assert depth_layers(pixels, 0.1)[0] == pytest.approx(2.0, abs=0.003)


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


def test_pixels_of_a_continuous_surface_have_their_own_depth_and_take_the_plane_of_a_new_segment() -> None:
    surface = 2.0 + np.random.default_rng(1).random(LABEL.shape)
    planes = [Plane(2.0), Plane(2.5, (0.0, 0.01), (30.0, 3.0)), Plane(3.0)]
    depths = tuple(SegmentDepth(plane.vergence_per_m, 1e-3, 0.9, 1.0, plane) for plane in planes)
    regions = Regions(3, depths, LABEL, LABEL, LABEL, surface_per_m=surface)
    assert regions.continuous and not Regions(3, depths, LABEL, LABEL, LABEL).continuous
    np.testing.assert_array_equal(regions.vergence_per_m(LABEL), surface)
    owner = np.where(LABEL == 3, 2, LABEL).astype(np.int32)
    owner[0] = 0
    moved = regions.with_owners(owner).vergence_per_m(owner)
    assert np.isnan(moved[0]).all()
    np.testing.assert_allclose(moved[LABEL == 3], planes[1].over(LABEL.shape)[LABEL == 3])
    np.testing.assert_array_equal(moved[1:][LABEL[1:] != 3], surface[1:][LABEL[1:] != 3])
    part = slice(10, 30), slice(20, 50)
    np.testing.assert_array_equal(regions.within(*part).vergence_per_m(LABEL[part]), surface[part])


def test_bands_of_a_continuous_surface_hold_its_pixels() -> None:
    surface = 2.0 + np.random.default_rng(1).random(LABEL.shape)
    flat = tuple(SegmentDepth(v, 1e-3, 0.9, 1.0, Plane(v)) for v in (1.0, 2.0, 3.0))
    label = np.where(LABEL == 2, 0, LABEL).astype(np.int32)
    bands, vergences = Regions(3, flat, LABEL, LABEL, LABEL, surface_per_m=surface).bands(label, 0.1)
    np.testing.assert_array_equal(bands == 0, label == 0)
    lit = label > 0
    assert np.abs(vergences[bands[lit] - 1] - surface[lit]).max() <= 0.05 * (1.0 + 1e-9)
    assert vergences.size <= 12


def test_bands_of_a_surface_without_depths_in_places_are_those_of_the_planes_there() -> None:
    """A surface that comes up in a part of a film has none where no segment is; images are made sharp there, too."""
    surface = np.full(LABEL.shape, 2.0)
    surface[:, 40:] = np.nan
    flat = tuple(SegmentDepth(v, 1e-3, 0.9, 1.0, Plane(v)) for v in (1.0, 2.0, 3.0))
    bands, vergences = Regions(3, flat, LABEL, LABEL, LABEL, surface_per_m=surface).bands(LABEL, 0.1)
    expected = np.where(np.arange(LABEL.shape[1]) < 40, 2.0, np.array([0.0, 1.0, 2.0, 3.0])[LABEL])
    np.testing.assert_allclose(vergences[bands - 1], expected)
