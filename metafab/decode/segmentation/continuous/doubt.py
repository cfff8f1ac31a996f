"""Probability that a pixel of a continuous surface has the right depth, within 5 %.

The log odds of a wrong depth are linear in what is left of the twins, in the distance from an outline, whose blur
reaches across it, in what another depth would cost, in how dim the place is beside brighter light, whose blur outweighs
its texture, and in the share of noise. No model of layers tells which side of an outline a pixel lies on, so that these
pixels are doubted as a whole. The weights were fitted by maximum likelihood to the pixels of 13 frames, each with the
same weight: the Middlebury motorcycle with depths from its disparity at 3000 and 500 electrons, and mirrored with
others; ten pictures of hills, rooms, leaves and steps with other textures, two of them with a small lens. When a
picture is left out of the fit, 0.1 to 4 % of its pixels with a probability above 0.9 are wrong, of a photograph on many
steps 13 %, and of the motorcycle with 500 electrons 11 %; 3.5 to 5.6 % are stated. The odds of a wrong depth are a
third higher than fitted.
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
#: light's dimness beside more light, and of the share of noise.
_WEIGHTS = (-2.23, 1.21, 0.37, 1.03, 2.21, -1.41, -0.75, -1.11, 2.44)
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
    """Measures of each pixel's doubt, in which the log odds of a wrong depth are linear: shape (n_y, n_x, 9)."""
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
        surface.faintness,
    )
    return np.stack(measures, axis=-1).astype(np.float64)
