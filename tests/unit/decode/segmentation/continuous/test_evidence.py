"""Gain of a surface over planes, in twins whose misfits are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.continuous.evidence import needs_surface, surface_gain
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions, SegmentDepth
from tests.unit.decode.segmentation.continuous.test_surface import SHAPE, twins

ALL = np.ones(SHAPE, dtype=np.int32)


def of_depth(vergence_per_m: float, grown: np.ndarray = ALL) -> Regions:
    """One segment of one depth."""
    depth = SegmentDepth(vergence_per_m, 1e-3, 0.9, 1.0, Plane(vergence_per_m), 1.0)
    return Regions(1, (depth,), ALL, ALL, grown)


def scene(true: np.ndarray) -> tuple[Any, Any, PixelDepth]:
    """Frame, cost volume and own depths of twins that are equal at 1/depths."""
    prepared, volume = twins(true, np.full(SHAPE, 40.0), np.zeros((13, *SHAPE)))
    return prepared, volume, PixelDepth(true, np.full(SHAPE, 3e-3), np.ones(SHAPE, dtype=bool))


def test_a_surface_that_follows_chance_is_not_needed_and_one_that_follows_a_bend_is() -> None:
    flat = np.full(SHAPE, 2.5)
    chance = flat * (1.0 + 0.005 * np.sin(np.arange(SHAPE[1])))
    bent = flat + 0.3 * (np.arange(SHAPE[1]) > 34)
    for true, needed in ((chance, False), (bent, True)):
        prepared, volume, pixels = scene(true)
        surface = Regions(1, of_depth(2.5).depths, ALL, ALL, ALL, surface_per_m=true)
        assert surface_gain(surface, of_depth(2.5), prepared, volume, pixels) > 0.0
        assert needs_surface(surface, of_depth(2.5), prepared, volume, pixels) is needed


def test_pixels_without_a_segment_do_not_change_the_misfit_of_their_neighbours() -> None:
    prepared, volume, pixels = scene(np.full(SHAPE, 3.5))
    holes = np.where(np.arange(SHAPE[1]) % 3 == 0, 0, ALL).astype(np.int32)
    whole, with_holes = (
        surface_gain(of_depth(3.5), of_depth(2.9, grown), prepared, volume, pixels) for grown in (ALL, holes)
    )
    assert with_holes == pytest.approx(whole, rel=1e-6)


def test_without_pixels_nothing_is_gained() -> None:
    prepared, volume, pixels = scene(np.full(SHAPE, 2.5))
    nowhere = PixelDepth(pixels.vergence_per_m, pixels.relative_error, np.zeros(SHAPE, dtype=bool))
    assert surface_gain(of_depth(2.5), of_depth(3.5), prepared, volume, nowhere) == 0.0
