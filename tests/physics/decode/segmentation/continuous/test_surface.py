"""Surfaces that are neither layers nor gentle planes: ground that leads away steeply, with an object before it."""

from __future__ import annotations

import numpy as np

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.continuous.surface import dimmer_than_around, matched_surface
from metafab.decode.segmentation.regions import find_regions
from tests.steep_ground import errors, matched, photographed


def test_a_steep_ground_and_an_object_before_it_have_their_depths() -> None:
    decoder, frame = photographed()
    prepared, volume, pixels = matched(decoder, frame)
    in_place = decoder.match(prepared).volume_in_place
    assert in_place() is in_place() and in_place().shape == volume.shape  # computed once
    of_windows = errors(decoder, frame, np.where(pixels.claimed, 1.0 / pixels.vergence_per_m, np.nan))
    # One depth for a window leans on a slope: measured 1.3 against 0.65 %, 0.31 % in the median. The disc's rim of
    # 190 px is 2 % of the pixels in a ring of a downsampled pixel, 15 % off on the wrong side: 0.3 % of the mean.
    of_surface = errors(decoder, frame, 1.0 / matched_surface(prepared, volume).vergence_per_m)
    assert of_surface.mean() < min(0.009, 0.6 * of_windows.mean()) and np.median(of_surface) < 0.004
    used: list[CostVolume] = []
    find_regions(prepared, volume, pixels, volume_in_place=lambda: used.append(in_place()) or used[-1])
    assert used  # the surface is that of filters that keep textures in their place
    regions = find_regions(prepared, volume, pixels)
    # Two planes across the surface, with slopes measured along them, are hardly anywhere off it.
    assert len(regions.depths) <= 3 and any(one.plane.tilted for one in regions.depths)
    image = decoder(frame)
    assert image.nmae is not None and image.nmae < 0.009
    assert image.figures.share_decoded is not None and image.figures.share_decoded > 0.9


def test_dimness_is_the_light_over_the_most_nearby() -> None:
    light = np.ones((2, 21, 21), dtype=np.float32)
    assert np.abs(dimmer_than_around(light, 5)).max() < 1e-6
    light[:, :, 11:] = 4.0
    dimness = dimmer_than_around(light, 5)
    # A share of 0.02 of the mean light is added to both.
    added = 0.02 * light.mean()
    assert dimness[10, 7] == np.float32(0.0) and dimness[10, 15] == np.float32(0.0)
    # Means of 3 pixels are 1, 2, 3 and 4 in columns 9 to 12.
    expected = np.log((np.array([1.0, 1.0, 2.0, 3.0]) + added) / (np.array([2.0, 3.0, 4.0, 4.0]) + added))
    np.testing.assert_allclose(dimness[10, 8:12], expected, rtol=1e-5)
