"""Raw frame and PSF calibration -> 4D image: I_x, I_y, contrast, depth, confidence.

- ``image``        Image4D
- ``twins``        where both images stand in a frame, brought onto one grid
- ``levels``       brightness, noise and texture of a frame
- ``calibration``  tiles of the grid and their transfer functions at any depth
- ``align``        agreement of the twins at a candidate depth
- ``depth``        depth of each pixel, with its error
- ``segment``      segments, and the depth of each
- ``restore``      all-in-focus images
- ``decoder``      all of it: ``decode`` and, for many frames, ``Decoder``
- ``judge``        errors against the truth
- ``store``        decoded.h5

In: a RawFrame and a Psf. Out: an Image4D. No frame raises.
"""

from metafab.decode.decoder import Decoder, decode
from metafab.decode.image import Image4D
from metafab.decode.store import load, save

__all__ = ["Decoder", "Image4D", "decode", "load", "save"]
