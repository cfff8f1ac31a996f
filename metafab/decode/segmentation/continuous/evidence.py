"""Whether a frame's twins need a continuous surface, or few planes leave no more of them.

A surface follows the twins everywhere, and noise as well: it fits better than planes even where those are right. By
Akaike's information criterion, what it gains by that chance must be exceeded twofold. The gain is in the logarithm of
the twins' misfit, whose mean is that of the likelihood per sample, so that neither light nor size of the frame counts.
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.fit import log_misfit
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Fall of the mean logarithm of the misfit that the freedom of a surface brings by chance. In 20 frames of flat,
#: tilted and bent objects (100 to 3000 electrons, most of 480 x 960 px) it is 0.02 in the mean, -0.02 to 0.045. Where
#: planes are wrong, surfaces gain more: 0.08 to 0.14 in the Middlebury motorcycle (150 to 3000 electrons, three ranges
#: of depth), 0.09 to 0.25 in hills, rooms, steps and slopes.
_BY_CHANCE = 0.03


def surface_gain(
    surface: Regions, planes: Regions, prepared: PreparedFrame, volume: CostVolume, pixels: PixelDepth
) -> float:
    """Mean logarithm of the twins' misfit at the depths of planes, less that at a surface's; 0 without pixels.

    Args:
        surface: segments with the depth of a surface.
        planes: segments with the depths of planes.
        prepared: the frame.
        volume: its cost volume.
        pixels: depth of each pixel by itself; those without are not judged.
    """
    judged = pixels.claimed & (surface.grown > 0) & (planes.grown > 0)
    if not judged.any():
        return 0.0
    of_planes, of_surface = (
        log_misfit(prepared, volume.at(_everywhere_per_m(one)[None])[:, 0], volume.noise_gain)[judged].mean()
        for one in (planes, surface)
    )
    return float(of_planes - of_surface)


def needs_surface(
    surface: Regions, planes: Regions, prepared: PreparedFrame, volume: CostVolume, pixels: PixelDepth
) -> bool:
    """Whether a surface gains more over planes than its freedom explains; see :func:`surface_gain`."""
    return surface_gain(surface, planes, prepared, volume, pixels) > 2.0 * _BY_CHANCE


def _everywhere_per_m(regions: Regions) -> FloatArray:
    """1/depth of each pixel, shape (n_y, n_x); that of the nearest one with a segment where a pixel has none.

    Windows about judged pixels hold others, too, whose misfit at any other depth would hide theirs.
    """
    vergence = regions.vergence_per_m(regions.grown)
    _, row, column = nearest(regions.grown > 0)
    return np.asarray(vergence[row, column])
