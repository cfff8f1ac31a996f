"""Limits of depth estimation: Fisher information, Cramer-Rao bounds, and estimators that reach them.

- ``texture``      the power spectrum of a 1/f texture, its signal-to-noise ratio and the error of its best restoration;
                   the noise of a point source
- ``fisher``       Fisher information about depth: two images of one texture, or PSFs sampled over depth
- ``plane_depth``  depth of a textured plane: maximum likelihood, cepstrum, and the bound of both

In: arrays (PSFs, transfer functions) with a texture or a point source. Out: information (1/m^2), bounds and depths (m).
"""

from metafab.information.fisher import (
    conjugate_information,
    depth_crlb_m,
    depth_slope,
    known_texture_information,
    point_information,
    twin_depth_information,
    twin_information,
)
from metafab.information.plane_depth import PlaneEstimator
from metafab.information.texture import PointSource, Texture, restored_error

__all__ = [
    "Texture",
    "PointSource",
    "twin_information",
    "conjugate_information",
    "known_texture_information",
    "point_information",
    "twin_depth_information",
    "depth_crlb_m",
    "depth_slope",
    "restored_error",
    "PlaneEstimator",
]
