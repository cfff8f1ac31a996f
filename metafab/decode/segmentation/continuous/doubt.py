"""Probability that a pixel of a continuous surface has the right depth, within 5 %.

The log odds of a wrong depth are linear in what is left of the twins, in the distance from an outline, whose blur
reaches across it, in what another depth would cost, in how dim the place is beside brighter light, whose blur outweighs
its texture, and in the coherence of the sharp images, of the pixel and of the frame's mean. Where these show noise
alone, the twins' texture is the blur of an outline nearby, and the depth is that outline's. A frame that shows little
of its surfaces hides steps of depth as well: 6 to 16 % of the pixels are wrong in pictures of rooms, hills and bars, 40
to 60 % in photographs whose depth changes where the light does not. No model of layers tells which side of an outline a
pixel lies on, so that these pixels are doubted as a whole.

The weights were fitted by maximum likelihood to the pixels of 25 frames of 17 pictures: the Middlebury motorcycle with
depths from its disparity at 3000 electrons (three draws of noise that share the weight of one frame) and at 500, and
mirrored with another texture; a room, hills, bars, leaves and rectangles of random depths; photographs cut into steps
and surfaces of random depths, four of these pictures at 500 electrons, too; three frames of a small lens with half the
weight. Pictures with the same photograph or the same depths are left out together: 0 to 10 % of the pixels with a
probability above 0.9 are then wrong, 2.4 % in the mean of the frames, and 1.7 to 2.0 % of the motorcycle's at 3000
electrons. Weights fitted without coherence leave 0 to 18 % wrong, 4.8 % in the mean, and only 27 % of the motorcycle's
pixels reach 0.9, in place of 50 %. The odds of a wrong depth are a third higher than fitted.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.decode.confidence import beside_outlines
from metafab.decode.segmentation.continuous.surface import Surface

#: Weights of 1, of the misfit of the window about the pixel and of the best window that holds it, of the nearness of an
#: outline within 8 and within 20 pixels, of the latter times the misfit, of the logarithm of 1 and the margin, of the
#: light's dimness beside more light, of the coherence about the pixel, and of the frame's.
_WEIGHTS = (2.60, 0.55, 0.39, 0.88, 0.79, -0.75, -0.64, -1.54, -1.05, -3.95)
_NEAR_PX, _FAR_PX = 8.0, 20.0
#: Largest probability of a plain pixel, which may be another surface than what is around it: none is sure.
_PLAIN_RIGHT = 0.85


def right_depth(surface: Surface, step: int) -> FloatArray:
    """Probability that the depth of each pixel is right, shape (n_y, n_x), 0 to 1.

    ``step`` is the frame pixels from one downsampled pixel to the next.
    """
    right = expit(-(doubts(surface, step) @ np.array(_WEIGHTS)))
    return np.asarray(np.where(surface.plain, np.minimum(right, _PLAIN_RIGHT), right))


def doubts(surface: Surface, step: int) -> FloatArray:
    """Measures of each pixel's doubt, in which the log odds of a wrong depth are linear: shape (n_y, n_x, 10)."""
    away = np.minimum(distance(beside_outlines(surface.vergence_per_m)) * step, 1e3)
    near, far = (np.exp(-away / px) for px in (_NEAR_PX, _FAR_PX))
    misfit = np.maximum(surface.misfit, 0.0)
    measures = (
        np.ones_like(near),
        misfit,
        surface.best_misfit,
        near,
        far,
        far * misfit,
        np.log1p(np.maximum(surface.margin, 0.0)),
        surface.dimness,
        surface.coherence,
        np.full_like(near, surface.frame_coherence),
    )
    return np.stack(measures, axis=-1).astype(np.float64)
