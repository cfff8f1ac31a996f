"""Surfaces that are neither layers nor gentle planes: ground that leads away steeply, with an object before it."""

from __future__ import annotations

import numpy as np

from metafab.camera import RawFrame
from metafab.core.conventions import FloatArray
from metafab.decode import Decoder
from metafab.decode.evaluation import overlap
from metafab.decode.segmentation.continuous.surface import matched_surface
from metafab.decode.segmentation.regions import find_regions
from tests.physics.decode.segmentation.conftest import Matched


def errors(decoder: Decoder, frame: RawFrame, depth_m: FloatArray) -> FloatArray:
    """Relative errors of a depth map on downsampled pixels, where the truth is known."""
    both, step = overlap(decoder(frame), frame), decoder.filters.downsampling.step
    assert both is not None
    here, truth = both
    true_m = np.full(decoder.calibration.grid.shape, np.nan)
    true_m[here] = truth.depth_m
    error = np.abs(depth_m / true_m[::step, ::step][: depth_m.shape[0], : depth_m.shape[1]] - 1.0)
    return np.asarray(error[np.isfinite(error)])


def test_a_steep_ground_and_an_object_before_it_have_their_depths(
    seen: tuple[Decoder, RawFrame], matched: Matched
) -> None:
    decoder, frame = seen
    prepared, volume, pixels = matched
    of_windows = errors(decoder, frame, np.where(pixels.claimed, 1.0 / pixels.vergence_per_m, np.nan))
    # One depth for a window leans on a slope: measured 2.0 against 1.6 %, with the rim of the disc.
    of_surface = errors(decoder, frame, 1.0 / matched_surface(prepared, volume).vergence_per_m)
    assert of_surface.mean() < min(0.02, 0.9 * of_windows.mean())
    regions = find_regions(prepared, volume, pixels)
    assert regions.continuous
    # Layers across the slope are 2.5 % off; the ground as one plane and the disc 1.1 %, nearly all at the disc's rim.
    of_segments = errors(decoder, frame, 1.0 / regions.vergence_per_m(regions.grown))
    assert of_segments.mean() < 0.015 and np.median(of_segments) < 0.007
    assert len(regions.depths) <= 3
    image = decoder(frame)
    assert image.nmae is not None and image.nmae < 0.02
    assert image.figures.share_decoded > 0.9
