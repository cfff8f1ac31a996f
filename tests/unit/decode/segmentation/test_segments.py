"""All segments of a frame: their pixels, bands and depths."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions, SegmentDepth

#: A wall, a strip along its side, and an object that hides some of both.
LABEL = np.ones((60, 80), dtype=np.int32)
LABEL[:, :6] = 2
LABEL[20:50, 30:60] = 3


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
