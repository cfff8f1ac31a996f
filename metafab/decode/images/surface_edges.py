"""Continuous surfaces matched once more, with jumps of depth at edges of the sharp images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.decode.images.contrast_outlines import block_sums
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.continuous.doubt import right_depth
from metafab.decode.segmentation.continuous.surface import matched_surface
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions


def surface_at_edges(regions: Regions, prepared: PreparedFrame, volume: CostVolume, sharp: SharpImages) -> Regions:
    """Segments whose surface jumps at edges of the light; ``regions`` itself if its surfaces are not continuous.

    Args:
        regions: segments.
        prepared: the frame.
        volume: its cost volume, by filters that keep textures in their place.
        sharp: sharp images at the depths of ``regions``.
    """
    before, step = regions.surface_per_m, prepared.downsampling.step
    if before is None:
        return regions
    light = block_sums(np.ascontiguousarray(sharp.images), step, before.shape)
    surface = matched_surface(prepared, volume, before, light)
    return replace(regions, surface_per_m=surface.vergence_per_m, right=right_depth(surface, step))
