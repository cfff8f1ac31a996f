"""Raw frame and PSF calibration -> 4D image: I_x, I_y, contrast, depth, confidence.

- ``image``        Image4D
- ``twins``        where both images stand in a frame, brought onto one grid
- ``resample``     the map that brings them there
- ``levels``       brightness, noise and texture of a frame
- ``calibration``  the PSF pair on that grid, at any tile and depth
- ``tiles``        a window cut into tiles with margins, and put together again
- ``reduce``       every few pixels of an image, and back
- ``filters``      what makes the twins equal at a candidate depth
- ``drift``        what the pair's change over the field does to that
- ``mixing``       mixtures of a few filtered images, by place and candidate
- ``distance``     how far pixels are from others
- ``pooling``      means over windows of many pictures at once
- ``volume``       agreement of the twins over place and depth
- ``peaks``        the best candidate in a window about each pixel
- ``depth``        depth of each pixel, with its error
- ``planes``       the depth of tilted segments
- ``consensus``    tilted planes across segments
- ``segment``      segments, and the depth of each
- ``outlines``     outlines as short as the twins let them be
- ``restore``      all-in-focus images
- ``seen``         a frame at first sight
- ``regions``      the segments of a frame
- ``contrast``     I_x / I_y and its error
- ``neighbours``   segments that are no more than a part of another
- ``compose``      all that is known put together
- ``decoder``      all of it: ``decode`` and, for many frames, ``Decoder``
- ``changes``      what differs from an earlier frame
- ``carried``      segments that go on from frame to frame
- ``video``        a decoder that remembers what has not changed
- ``point``        one image of a point in a photograph
- ``pinhole``      calibration of a camera from photographs of a point
- ``bound``        the least error that the pair allows at each place
- ``judge``        errors against the truth
- ``store``        decoded.h5

In: a RawFrame and a Psf. Out: an Image4D. No frame raises.
"""

from metafab.decode.camera_fit.pinhole import NOT_SEPARATED, CameraFit, calibrate, read_depths
from metafab.decode.decoder import Decoder, decode
from metafab.decode.evaluation.bound import DepthBound
from metafab.decode.evaluation.metrics import object_errors
from metafab.decode.film.video import VideoDecoder
from metafab.decode.image import Image4D, SegmentFigures
from metafab.decode.segmentation.frame_statistics import NO_LIGHT
from metafab.decode.store import load, save

__all__ = [
    "NOT_SEPARATED",
    "NO_LIGHT",
    "CameraFit",
    "Decoder",
    "DepthBound",
    "Image4D",
    "SegmentFigures",
    "VideoDecoder",
    "calibrate",
    "decode",
    "load",
    "object_errors",
    "read_depths",
    "save",
]
