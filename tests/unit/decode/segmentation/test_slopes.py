"""Slopes measured along planes, in a cost volume whose true depths are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import SegmentDepth
from metafab.decode.segmentation.slopes import along_planes

SHAPE, STEP = (90, 120), 2
TRUE = Plane(340.0, (0.2, -0.5), (45.0, 60.0))
#: As cells find it: too steep, and at another place.
FOUND = Plane(341.0, (0.25, -0.6), (45.0, 60.0))


def volume() -> CostVolume:
    """Twins that agree on a plane alone, within 4/m."""
    nodes = np.linspace(280.0, 400.0, 31)
    agree = np.exp(-0.5 * ((nodes[:, None, None] - TRUE.over(SHAPE)) / 4.0) ** 2)
    products = np.stack([agree, np.ones_like(agree), np.ones_like(agree)]).astype(np.float32)
    return CostVolume(nodes, products, samples=0.1, noise_gain=1.0)


def segment(plane: Plane) -> SegmentDepth:
    return SegmentDepth(plane.vergence_per_m, 1e-3, 0.9, 1.0, plane)


def test_a_plane_that_is_too_steep_is_corrected() -> None:
    inside = np.zeros(SHAPE, dtype=np.int32)
    inside[3:88, 7:110] = 1
    (found,) = along_planes([segment(FOUND)], inside, volume(), STEP)
    corners = np.array([[0.0], [SHAPE[0]]]), np.array([[0.0, SHAPE[1]]])
    np.testing.assert_allclose(found.plane.at(*corners), TRUE.at(*corners), rtol=2e-4)
    assert found.vergence_per_m == found.plane.vergence_per_m


@pytest.mark.parametrize("plane", [Plane(341.0), replace(FOUND, curvature_per_m=(1e-4, 0.0, 0.0))])
def test_flat_and_curved_segments_stay(plane: Plane) -> None:
    before = segment(plane)
    assert along_planes([before], np.ones(SHAPE, dtype=np.int32), volume(), STEP) == (before,)


def test_a_segment_without_enough_cells_stays() -> None:
    few, none = np.zeros((2, *SHAPE), dtype=np.int32)
    few[:40, :40] = 1
    assert along_planes([segment(FOUND)], few, volume(), STEP) == (segment(FOUND),)
    assert along_planes([segment(FOUND)], none, volume(), STEP) == (segment(FOUND),)


@pytest.mark.parametrize("end", ["far", "near"])
def test_a_plane_that_reaches_the_end_of_the_calibrated_range_is_not_drawn_to_it(end: str) -> None:
    # The twins agree over more than two candidates: their sums at the end of the range are much like those beyond it.
    true = Plane(340.0, (0.02, -0.05), (45.0, 60.0))
    per_m = true.over(SHAPE)
    nodes = np.arange(31) * 4.0
    nodes = nodes - nodes[0] + per_m.min() - 0.5 if end == "far" else nodes - nodes[-1] + per_m.max() + 0.5
    agree = 0.9 * np.exp(-0.5 * ((nodes[:, None, None] - per_m) / 8.0) ** 2)
    products = np.stack([agree, np.ones_like(agree), np.ones_like(agree)]).astype(np.float32)
    inside = np.ones(SHAPE, dtype=np.int32)
    found = replace(true, vergence_per_m=340.5, slope_per_m=(0.025, -0.06))
    (depth,) = along_planes([segment(found)], inside, CostVolume(nodes, products, samples=0.1, noise_gain=1.0), STEP)
    np.testing.assert_allclose(depth.plane.over(SHAPE), per_m, rtol=8e-4)
