"""Decoder: a raw frame and its PSF calibration -> the 4D image (I_x, I_y, contrast, depth, confidence).

- ``registration/``  both images on one grid: RawFrame -> Twins; the PSF pair on that grid
- ``matching/``      matched filters, cost volume over candidate depths: Twins -> CostVolume -> PixelDepth
- ``segmentation/``  connected segments of one plane, with the depth of each: CostVolume -> Regions
- ``images/``        Wiener deconvolution and contrast; the parts put together: -> Image4D
- ``broken_light``   saturated pixels: errors of segments, and segments without a depth
- ``confidence``     the definition of a depth's confidence
- ``image``          Image4D, its arrays by name, and decoded.h5
- ``decoder``        ``decode`` for one frame, ``Decoder`` for many of one shape
- ``stokes``         depth and Stokes vectors from six images: StokesFrame and StokesPsf -> StokesImage
- ``film/``          change detection and tracking: a decoder of films that decodes only what changed
- ``camera_fit/``    calibration of a camera from photographs of a point
- ``evaluation``     errors against the truth, and the Cramer-Rao bound of depth
"""

from metafab.core.figures import SegmentFigures as SegmentFigures
from metafab.decode.camera_fit.pinhole import NOT_SEPARATED as NOT_SEPARATED
from metafab.decode.camera_fit.pinhole import CameraFit, calibrate
from metafab.decode.camera_fit.pinhole import read_depths as read_depths
from metafab.decode.decoder import FAST, Decoder, DecoderNumerics, decode
from metafab.decode.evaluation import DepthBound, object_errors
from metafab.decode.film.video import VideoDecoder
from metafab.decode.image import Image4D, load, save
from metafab.decode.segmentation.prepared_frame import NO_LIGHT as NO_LIGHT

__all__ = [
    "decode",
    "Decoder",
    "DecoderNumerics",
    "FAST",
    "VideoDecoder",
    "Image4D",
    "calibrate",
    "CameraFit",
    "load",
    "save",
    "object_errors",
    "DepthBound",
]
