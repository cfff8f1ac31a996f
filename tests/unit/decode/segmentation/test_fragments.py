"""Strips and specks that belong to a larger neighbour of the same depth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.decode.segmentation.fragments import fragment_targets
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import SegmentDepth

#: A wall, a strip along its side, and an object that hides some of both.
LABEL = np.ones((60, 80), dtype=np.int32)
LABEL[:, :6] = 2
LABEL[20:50, 30:60] = 3
#: Frame pixels of a pixel there by which the strip is too wide to be one of the picture's rim.
COARSE = 8


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
