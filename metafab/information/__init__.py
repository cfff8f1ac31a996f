"""Limits of depth estimation: Fisher information, Cramer-Rao bounds, and estimators that reach them.

- ``texture``      the power spectrum of a 1/f texture, its signal-to-noise ratio and the error of its best restoration;
                   the noise of a point source
- ``twin_images``  Fisher information about depth in two images of one texture, summed over spatial frequencies
- ``psf_stacks``   the same information, and that of a point source, from PSFs sampled over depth
- ``plane_depth``  depth of a textured plane: maximum likelihood, cepstrum, and the bound of both

In: arrays (PSFs, transfer functions) with a texture or a point source. Out: information (1/m^2), bounds and depths (m).
"""

from metafab.information.plane_depth import PlaneEstimator
from metafab.information.psf_stacks import depth_crlb_m, depth_slope, point_information, twin_depth_information
from metafab.information.texture import PointSource, Texture, restored_error
from metafab.information.twin_images import conjugate_information, known_texture_information, twin_information

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
